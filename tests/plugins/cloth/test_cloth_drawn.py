"""Pictures of cloth and of bodies."""

from __future__ import annotations

import numpy as np
import pytest
from sheets import sheet

from understudy.errors import UnderstudyError
from understudy_cloth.drawing import draw
from understudy_cloth.scene import Capsule, ClothModel, Tool


@pytest.mark.parametrize("moves", [False, True])
def test_a_body_that_reaches_far_from_its_origin_is_seen_whole(moves: bool) -> None:
    """A post of 1.2 m stands upon the place that its tool says, beside a sheet of 18 cm, which goes away or stays."""
    points, faces = sheet(9, 9)
    post = Tool((Capsule(0.08, 0.5, (0.0, 0.0, 0.58)),))
    frames = np.linspace(0.0, 9.0 if moves else 0.0, 60)
    cloth = np.stack([points + np.array([x, 0.0, 0.0]) for x in frames])
    at = np.stack([(x, -0.3, 0.0) for x in frames])
    tracks = {
        "cloth_position": cloth,
        "tool_position": at[:, None],
        "tool_orientation": np.tile([1.0, 0.0, 0.0, 0.0], (60, 1, 1)),
    }
    try:
        *_, shown = draw(ClothModel(points, faces, tools=(post,)), tracks, 160, 120)
    except UnderstudyError as error:
        pytest.skip(str(error))
    red, blue = shown[..., 0].astype(float), shown[..., 2].astype(float)
    skin = red > 1.2 * blue
    assert skin.sum() > 200
    rows, columns = skin.nonzero()
    assert 2 <= rows.min() < rows.max() <= 117
    assert 2 <= columns.min() < columns.max() <= 157
