"""Films of points: each frame shows what it shows alone, whatever the frames before it left."""

from __future__ import annotations

import numpy as np
import pytest

from understudy_miniature.drawing import draw_points

PAPER, FLOOR, TARGET, POINT = (244, 245, 247), (150, 158, 170), (213, 94, 0), (0, 114, 178)


@pytest.mark.parametrize("upright", [True, False])
def test_a_frame_of_a_film_is_the_frame_alone(upright: bool) -> None:
    """At the edges, outside, and where shapes cover each other."""
    rng = np.random.default_rng(1)
    tracks = {
        "positions": rng.normal(0.0, 1.0, (8, 3, 2)),
        "target": rng.normal(0.0, 1.0, (8, 2)),
        "bar_height": rng.uniform(-0.5, 1.0, 8),
    }
    tracks["positions"][:, 0, 0] = 2.0  # as wide a picture for each
    tracks["positions"][3] = 0.1 * tracks["positions"][3]
    film = list(draw_points(tracks, 160, 90, upright))
    assert len({frame.tobytes() for frame in film}) == 8
    for step, frame in enumerate(film):
        alone = {name: track[step : step + 1] for name, track in tracks.items()}
        assert (next(draw_points(alone, 160, 90, upright)) == frame).all()


def test_colours_are_where_things_are() -> None:
    """50 pixels a metre; the floor is at 0.82 of the height, and a disc stands on it."""
    tracks = {
        "positions": np.array([[[-1.0, 0.0], [5.0, 0.0]]]),
        "target": np.array([[1.0, 0.5]]),
        "bar_height": np.array([0.4]),
    }
    metre = 0.5 * 550 / 5.5
    frame = next(draw_points(tracks, 550, 200, upright=True))

    def at(x: float, y: float) -> tuple[int, ...]:
        return tuple(frame[round(164 - y * metre), round(275 + x * metre)].tolist())

    assert at(-1.0, 0.09) == POINT
    assert at(1.0, 0.5) == PAPER  # inside the ring
    assert at(1.0, 0.5 + 1.6 * 0.09) == TARGET
    assert at(0.0, 0.2) == TARGET
    assert at(0.0, 0.5) == PAPER
    assert at(-3.0, 0.0) == FLOOR
    assert at(-3.0, 1.0) == PAPER
