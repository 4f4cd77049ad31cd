"""The sleeve, distances along it, and what goes through its opening."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from understudy_cloth.checking import check_mesh
from understudy_cloth.scene import Fabric
from understudy_dressing.sleeve import SleeveScene, geodesic
from understudy_dressing.state import centre_and_normal, passes

pytest.importorskip("potpourri3d", reason="potpourri3d is not installed")
COARSE = SleeveScene.Options(
    around=0.56, length=0.44, edge=0.0257, held=75.0, fabric=Fabric(bending=0.0)
)


def ring(points: int = 24, radius: float = 0.1) -> Tensor:
    """(1, L, 3): in the plane x = 0, with the normal x."""
    a = 2 * math.pi * torch.arange(points) / points
    return torch.stack([0 * a, radius * a.cos(), radius * a.sin()], dim=1)[None]


def test_a_sleeve_is_a_sound_mesh_of_the_size_asked_for() -> None:
    scene = SleeveScene(COARSE)
    points, faces, _ = scene.mesh
    check_mesh(points, faces, "the sleeve")
    assert len(points) == 396
    assert np.ptp(points[:, 0]) == pytest.approx(0.44)
    edge = points[scene.loops["entrance"]]
    around = np.linalg.norm(np.roll(edge, -1, axis=0) - edge, axis=1).sum()
    assert around == pytest.approx(0.56, rel=0.01)
    for name, x in (("entrance", 0.0), ("middle", 0.06), ("end", 0.44)):
        loop = torch.tensor(points[scene.loops[name]])[None]
        centre, normal = centre_and_normal(loop)
        assert float(centre[0, 0]) == pytest.approx(x, abs=0.0257 / 2)
        assert normal[0, 0] == pytest.approx(1.0), "into the sleeve"


def test_distances_go_around_the_edge_to_the_inside() -> None:
    scene = SleeveScene(COARSE)
    points, faces, _ = scene.mesh
    found = geodesic(points, faces, scene.loops["middle"])
    x = points[:, 0]
    middle = x[scene.loops["middle"][0]]
    inside, outside = found.distance[1], found.distance[0]
    assert inside[scene.loops["middle"]].max() < 1e-6
    near = np.abs(x - 0.2) < 0.02
    scale = outside[near].mean() / (x[near].mean() + middle)  # by the entrance
    assert inside[near].mean() == pytest.approx(scale * (x[near].mean() - middle), rel=0.05)
    assert outside[x < 0.3].min() == pytest.approx(scale * middle, rel=0.05)
    # outside the way is to the entrance, inside to the loop from both of its ends
    on_the_way = x[found.towards] - x
    assert (on_the_way[0][(x > 0.01) & (x < 0.3)] < 0).all()
    assert (on_the_way[1][x > middle + 0.01] < 0).all()
    assert (on_the_way[1][x < middle - 0.01] > 0).all()


@pytest.mark.parametrize(
    ("tip", "base", "inside", "beyond"),
    [
        ((0.3, 0.0, 0.0), (-0.7, 0.0, 0.0), True, 0.3),
        ((0.3, 0.0, 0.0), (-0.1, 0.04, 0.0), True, 0.3 * math.hypot(0.4, 0.04) / 0.4),
        ((-0.3, 0.0, 0.0), (0.7, 0.0, 0.0), False, 0.0),  # from behind
        ((-0.3, 0.0, 0.0), (-0.7, 0.0, 0.0), False, 0.0),  # before it
        ((0.3, 0.0, 0.0), (0.1, 0.0, 0.0), False, 0.0),  # beyond it
        ((0.3, 0.12, 0.0), (-0.7, 0.12, 0.0), False, 0.0),  # beside it
    ],
)
def test_a_bone_goes_through_a_loop(
    tip: tuple[float, ...], base: tuple[float, ...], inside: bool, beyond: float
) -> None:
    through, depth = passes(torch.tensor([[tip, base]]), ring())
    assert through.tolist() == [[inside]]
    if inside:
        assert float(depth[0, 0]) == pytest.approx(beyond, abs=1e-5)


def test_the_depth_is_all_that_is_beyond() -> None:
    """Of a limb of three bones the middle one goes through."""
    bones = torch.tensor([[[0.3, 0, 0], [0.2, 0, 0], [-0.1, 0, 0], [-0.5, 0, 0]]])
    through, depth = passes(bones, ring())
    assert through.tolist() == [[False, True, False]]
    assert float(depth[0, 1]) == pytest.approx(0.1 + 0.2, abs=1e-6)


def test_a_loop_that_is_crushed_flat_holds_what_goes_through_its_slit() -> None:
    slit = ring()
    slit[..., 2] *= 0.1
    limb = torch.tensor([[[0.2, 0.05, z], [-0.2, 0.05, z]] for z in (0.0, 0.05)])
    through, _ = passes(limb, slit.expand(2, -1, -1))
    assert through.squeeze(1).tolist() == [True, False]
    tilted = ring() @ torch.tensor([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    assert passes(limb[:1], tilted)[0].all(), "whatever its plane"


def test_it_hangs_from_the_gripper_with_its_opening_open() -> None:
    scene = SleeveScene(COARSE)
    rest, settled = scene.mesh[0], scene.settled()
    held = np.asarray(scene.model().grips[0].vertices)
    assert np.abs(settled[held] - rest[held]).max() < 1e-4
    assert settled[:, 2].min() < rest[:, 2].min() - 0.005, "what is not held sags"
    loop = torch.tensor(settled[scene.loops["entrance"]])
    area = torch.linalg.cross(loop - loop.mean(0), loop.roll(-1, 0) - loop.mean(0)).sum(0) / 2
    assert float(area.norm()) > 0.75 * math.pi * (0.56 / (2 * math.pi)) ** 2


@pytest.mark.parametrize(
    "wrong", [{"edge": 0.2}, {"edge": 0.001}, {"middle": 0.5}, {"length": math.nan}, {"held": 200.0}]
)  # fmt: skip
def test_sizes_that_make_no_sleeve_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=f"{next(iter(wrong))}="):
        SleeveScene.Options(**wrong)
