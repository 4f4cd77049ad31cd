"""The body as segments, and what lines come to over an obstacle."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from arena_worlds import arena_context, fields_at
from hypothesis import given, settings
from hypothesis import strategies as st

from understudy_characters.scene import CharacterScene
from understudy_jumping.body import body_of, lowest_surface

numbers = st.integers(-2000, 2000).map(lambda millimetres: millimetres / 1000)


def lowest(
    a: tuple[float, float], b: tuple[float, float], radius: float, low: float, high: float
) -> float:
    ends = (torch.tensor([end], dtype=torch.float64) for end in (a, b))
    return float(
        lowest_surface(*ends, torch.tensor(radius), torch.tensor(low), torch.tensor([high]))
    )


def test_rounded_lines_over_an_interval() -> None:
    half = math.sqrt(0.5)
    assert lowest((-1, 1), (1, 1), 0.1, 0.0, 0.5) == pytest.approx(0.9)
    assert lowest((-1, 0), (1, 2), 0.1, 0.0, 0.5) == pytest.approx(1 - 0.1 / half), (
        "its side, at 45°"
    )
    assert lowest((1, 2), (-1, 0), 0.1, 0.0, 0.5) == pytest.approx(1 - 0.1 / half)
    assert lowest((-1, 0), (-0.5, 2), 0.1, 0.0, 0.5) == np.inf
    assert lowest((0.2, 0.7), (0.3, 0.4), 0.1, 0.0, 0.5) == pytest.approx(0.3), "its lower end"
    assert lowest((0.2, 0.7), (0.2, 0.4), 0.1, 0.0, 0.5) == pytest.approx(0.3), "straight down"
    assert lowest((0.2, 0.4), (0.2, 0.4), 0.1, 0.0, 0.5) == pytest.approx(0.3), "a ball"
    assert lowest((-0.06, 0.4), (-0.06, 0.7), 0.1, 0.0, 0.5) == pytest.approx(0.32), "beside it"
    assert lowest((0.7, 0.7), (0.7, 0.4), 0.1, 0.0, 0.5) == np.inf


@settings(max_examples=60, deadline=None)
@given(numbers, numbers, numbers, numbers, st.floats(0.02, 1.0), st.floats(0.01, 0.2))
def test_an_obstacle_of_that_height_is_just_touched(
    x0: float, z0: float, x1: float, z1: float, w: float, radius: float
) -> None:
    """The line is `radius` away from a box so high, or from one without an end."""
    t = np.linspace(0, 1, 4000)
    x, z = x0 + t * (x1 - x0), z0 + t * (z1 - z0)
    beside = np.maximum(np.maximum(-x, x - w), 0.0)
    found = lowest((x0, z0), (x1, z1), radius, 0.0, w)
    if np.isfinite(found):
        away = np.hypot(beside, np.maximum(z - found, 0.0)).min()
        assert away == pytest.approx(radius, abs=1e-3)
    else:
        assert beside.min() > radius - 1e-3


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
