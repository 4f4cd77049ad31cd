"""Pictures of particles and tools."""

from __future__ import annotations

import numpy as np
import pytest

from understudy.errors import UnderstudyError
from understudy_pbd.drawing import draw
from understudy_pbd.scene import ParticleModel, Tool, pan

HEIGHT, WIDTH = 120, 160


def picture(x: float) -> np.ndarray:
    """(120, 160, 3) float: a pan at `x` (m), 1 m above the table, and a grain half a metre above x = 0."""
    grain = np.array([[0.0, 0.0, 1.5]])
    model = ParticleModel(grain, 0.01, 0.01, tools=(Tool(pan(0.9, 0.3, thickness=0.1)),))
    tracks = {
        "particle_position": grain[None],
        "tool_position": np.array([[x, 0.0, 1.0]]),
        "tool_orientation": np.array([[1.0, 0.0, 0.0, 0.0]]),
    }
    try:
        return next(iter(draw(model, tracks, WIDTH, HEIGHT))).astype(float)
    except UnderstudyError as error:
        pytest.skip(str(error))


def test_boxes_that_share_a_side_do_not_flicker() -> None:
    middle = picture(0.0)[-24:-8, WIDTH // 2 - 16 : WIDTH // 2 + 16]
    assert middle.std(axis=(0, 1)).max() < 4.0, "two sides in one place, pixel by pixel"


def test_the_camera_sees_a_tool_that_is_beside_the_particles() -> None:
    shown = picture(3.0)
    steel = (shown[..., 2] > shown[..., 0]) & (shown[..., 0] < 180.0)  # the sky is lighter
    assert steel.mean() > 0.02
