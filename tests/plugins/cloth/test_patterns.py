"""Garments from patterns: as large as they say, sound, and they can be worn."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from sheets import along, control, simulator

from understudy.errors import FileError
from understudy_cloth.checking import check_mesh, pieces_of
from understudy_cloth.garments import Garment, holes_of
from understudy_cloth.mesh import edges_of, face_areas
from understudy_cloth.patterns import JACKET, Shirt, jacket, t_shirt
from understudy_cloth.scene import Capsule, ClothModel, Tool

SHIRT_LOOPS = {"hem", "collar"}
SLEEVE_LOOPS = {f"{s}_{p}" for s in ("left", "right") for p in ("entrance", "middle", "end")}


def cut(garment: Garment, loop: str) -> float:
    """m round, of the cut pieces."""
    assert garment.rest is not None
    length = {}
    sides = np.linalg.norm(np.roll(garment.rest, -1, axis=1) - garment.rest, axis=2)
    for face, of in zip(garment.faces, sides, strict=True):
        for k in range(3):
            length[frozenset((int(face[k]), int(face[(k + 1) % 3])))] = float(of[k])
    loop_ = garment.loops[loop].tolist()
    return sum(length[frozenset(pair)] for pair in itertools.pairwise([*loop_, loop_[0]]))


def test_the_shirt_has_the_sizes_of_the_one_that_was_measured() -> None:
    shirt = t_shirt()
    assert shirt.rest is not None
    assert face_areas(shirt.rest).sum() == pytest.approx(1.07, rel=0.03)
    assert len(shirt.positions) == pytest.approx(2671, rel=0.05)
    found = {name: cut(shirt, name) for name in shirt.loops}
    assert set(found) == SHIRT_LOOPS | SLEEVE_LOOPS
    expected = {"hem": 1.28, "collar": 0.60, "left_entrance": 0.53, "left_end": 0.49}
    for name, size in expected.items():
        assert found[name] == pytest.approx(size, rel=0.02), name
    assert found["left_end"] < found["left_middle"] < found["left_entrance"]
    z = shirt.positions[:, 2]
    back = shirt.positions[shirt.loops["collar"]][:, 0] < 0
    assert z[shirt.loops["collar"]][back].min() - z[shirt.loops["hem"]].max() == pytest.approx(0.73)


def test_the_jacket_is_open_in_front() -> None:
    found = jacket()
    assert set(found.loops) == {"border"} | SLEEVE_LOOPS
    assert found.rest is not None
    assert face_areas(found.rest).sum() == pytest.approx(0.71, rel=0.15)
    assert cut(found, "left_entrance") == pytest.approx(0.68, rel=0.02)
    border = found.positions[found.loops["border"]]
    front = border[(border[:, 0] > 0) & (abs(border[:, 1]) < 0.001)]
    assert len(front) > 30
    assert np.ptp(front[:, 2]) > 0.4


ODD = [
    Shirt(width=0.4, height=0.6, slope=0.0),
    Shirt(sleeve=0.6, middle=0.3, end=0.16),
    Shirt(edge=0.032),
    Shirt(edge=0.0125, open_front=True),
    replace(JACKET, sleeve=0.55, entrance=0.3, end=0.2),
]


@pytest.mark.parametrize("shirt", [Shirt(), JACKET, *ODD], ids=str)
def test_it_is_sound(shirt: Shirt) -> None:
    """One piece, facing out, its loops closed along edges, as long on the left as on the right."""
    found = t_shirt(shirt)
    check_mesh(found.positions, found.faces, "it", FileError)
    assert pieces_of(found.faces, len(found.positions)) == 1
    assert len(holes_of(found.faces)) == (3 if shirt.open_front else 4)
    edges = set(map(tuple, edges_of(found.faces)[0].tolist()))
    for name, loop in found.loops.items():
        assert len(set(loop.tolist())) == len(loop), name
        for pair in itertools.pairwise([*loop.tolist(), int(loop[0])]):
            assert tuple(sorted(pair)) in edges, name
    for part in ("entrance", "middle", "end"):
        left, right = (cut(found, f"{side}_{part}") for side in ("left", "right"))
        assert left == pytest.approx(right, rel=1e-6)
        assert found.positions[found.loops[f"left_{part}"]][:, 1].min() > 0, "left is y"
    n = np.cross(*(found.positions[found.faces[:, k]] - found.positions[found.faces[:, 0]] for k in (1, 2)))  # fmt: skip
    middle = found.positions[found.faces].mean(axis=1)
    deep = abs(middle[:, 0]) > 0.01
    assert (np.sign(n[deep, 0]) == np.sign(middle[deep, 0])).all()
    for patch in found.patches.values():
        assert len(patch) >= 3
        assert (found.positions[patch, 0] >= 0).all()
    # the cut pieces are no more than a little strained where they lie
    assert found.rest is not None
    sides = [np.linalg.norm(np.roll(t, -1, 1) - t, axis=2) for t in (found.positions[found.faces], found.rest)]  # fmt: skip
    assert (sides[0] / sides[1]).max() < 1.1
    assert np.median(sides[1]) == pytest.approx(shirt.edge, rel=0.1)


@pytest.mark.parametrize(
    ("option", "value"),
    [("width", 0.0), ("edge", 0.1), ("neck", 0.64), ("middle", 0.14), ("height", 0.3), ("slope", -0.1), ("grips", 0.01)],
)  # fmt: skip
def test_what_cannot_be_cut_is_refused(option: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{option}="):
        Shirt(**{option: value})


def test_a_shirt_hangs_on_shoulders() -> None:
    """It falls on a bar in its shoulders, is touched from inside there, and hangs; layers stay apart."""
    shirt = t_shirt()
    bar = Tool((Capsule(0.03, **along(((0, -0.25, 0), (0, 0.25, 0)))),), (0, 0, 0.58), friction=0.5)
    model = ClothModel(shirt.positions, shirt.faces, rest=shirt.rest, tools=(bar,))
    found = simulator(model)
    for _ in range(80):
        found.step(control(found, 0, 0, 0.58))
    assert not found.failed().any()
    x = found.read("cloth_position")[0].double().numpy()
    force, side = found.read("contact_force")[0], found.read("contact_side")[0]
    assert x[:, 2].min() > -0.25, "it fell off"
    touched = force.norm(dim=1) > 1e-6
    assert (side[touched] > 0).float().mean() > 0.95
    assert float(force[:, 2].sum()) == pytest.approx(0.2 * 1.07 * 9.81, rel=0.25)
    torso = (abs(shirt.positions[:, 1]) < 0.2) & (shirt.positions[:, 2] < 0.5)
    front, back = torso & (shirt.positions[:, 0] > 0.02), torso & (shirt.positions[:, 0] < -0.02)
    apart = np.linalg.norm(x[front][:, None] - x[back][None], axis=2)
    assert apart.min() > 0.008
