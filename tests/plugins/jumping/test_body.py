"""The body as segments, and what lines come to over an obstacle."""

from __future__ import annotations

import numpy as np
import torch
from arena_worlds import arena_context, fields_at
from hypothesis import given, settings
from hypothesis import strategies as st

from understudy_characters.scene import CharacterScene
from understudy_jumping.body import body_of, lowest_between

numbers = st.integers(-2000, 2000).map(lambda millimetres: millimetres / 1000)


def between(a: tuple[float, float], b: tuple[float, float], low: float, high: float) -> float:
    return float(
        lowest_between(torch.tensor([a]), torch.tensor([b]), low, torch.tensor([high])).item()
    )


def test_lines_over_an_interval() -> None:
    assert between((-1, 0), (1, 2), 0.0, 0.5) == 1.0
    assert between((1, 2), (-1, 0), 0.0, 0.5) == 1.0
    assert between((-1, 0), (-0.5, 2), 0.0, 0.5) == np.inf
    assert between((0.2, 0.7), (0.3, 0.4), 0.0, 0.5) == np.float32(0.4)
    assert between((0.2, 0.7), (0.2, 0.3), 0.0, 0.5) == np.float32(0.3), "straight down"
    assert between((0.6, 0.7), (0.6, 0.3), 0.0, 0.5) == np.inf


@settings(max_examples=60, deadline=None)
@given(numbers, numbers, numbers, numbers, st.floats(0.02, 1.0))
def test_no_point_of_the_line_is_lower(
    x0: float, z0: float, x1: float, z1: float, w: float
) -> None:
    t = np.linspace(0, 1, 400)
    x, z = x0 + t * (x1 - x0), z0 + t * (z1 - z0)
    inside = z[(x >= 0) & (x <= w)]
    found = between((x0, z0), (x1, z1), 0.0, w)
    if len(inside):
        assert found <= inside.min() + 1e-4
        assert found >= inside.min() - 4.5 / 399
    elif np.isfinite(found):  # the interval lies between two of the samples
        assert min(abs(x0), abs(x0 - w), *np.abs(x), *np.abs(x - w)) < 4.1 / 399


def test_lowest_points_are_the_characters() -> None:
    """Against the clearance that the character computes pose by pose."""
    context = arena_context()
    scene = context.scene
    assert isinstance(scene, CharacterScene)
    generator = torch.Generator().manual_seed(0)
    qpos = torch.tensor(scene.model.qpos0).repeat(8, 1)
    for at in (3, *scene.layout.ball_qpos[:, 0].tolist()):
        qpos[:, at : at + 4] += 0.4 * torch.randn(8, 4, generator=generator)
        qpos[:, at : at + 4] /= qpos[:, at : at + 4].norm(dim=1, keepdim=True)
    fields = fields_at(context, qpos)
    body = body_of(context, "a test")
    found = body.lowest(fields["geom_xpos"], fields["geom_xmat"]).amin(dim=1)
    clearance = scene.character.clearance(qpos)
    np.testing.assert_allclose(found, clearance.amin(dim=1), atol=1e-5)


def test_segments_span_the_body() -> None:
    """In the zero pose the highest is the head's top, and shins reach from knee to ankle."""
    context = arena_context()
    scene = context.scene
    assert isinstance(scene, CharacterScene)
    fields = fields_at(context, torch.tensor(scene.model.qpos0)[None])
    body = body_of(context, "a test")
    ends = body.ends(fields["geom_xpos"], fields["geom_xmat"])[0]
    assert len(ends) == len(body.widths) == len(body.names) + 2
    top = (ends[..., 2].amax(dim=1) + body.widths).max()
    head = scene.model.body("neck").id
    crown = scene.character.zero_pose.xpos[head, 2] + 0.175 + 0.1025
    np.testing.assert_allclose(top, crown, rtol=1e-6)
    shin = ends[body.names.index("right_knee")]
    np.testing.assert_allclose((shin[0] - shin[1]).norm(), 0.31, rtol=1e-6)
    spine = ends[len(body.names) :]
    assert float(spine[0, 0, 2]) < float(spine[0, 1, 2]) == float(spine[1, 0, 2])
