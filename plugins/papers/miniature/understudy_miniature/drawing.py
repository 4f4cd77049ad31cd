"""Pictures of points on a plane, drawn with NumPy alone."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

_PAPER, _LINE = (244, 245, 247), (150, 158, 170)
_TARGET, _POINT, _OTHER = (213, 94, 0), (0, 114, 178), (86, 180, 233)
_RADIUS = 0.09  #: m, of a point


def draw_points(
    tracks: Mapping[str, np.ndarray], width: int, height: int, upright: bool
) -> Iterator[np.ndarray]:
    """Frames (height, width, 3) uint8 of ``positions`` (T, B, 2) in m and, where they are recorded,
    of a ``target`` (T, 2) and of a bar at 0 of height ``bar_height`` (T,).

    An `upright` plane is seen from the side, with its floor; another one from above.
    """
    positions = tracks["positions"]
    reach = 1.1 * max(2.0, float(np.abs(positions[..., 0]).max()))
    metre = 0.5 * width / reach  # in pixels
    floor = 0.82 * height if upright else 0.5 * height
    x = (np.arange(width) - 0.5 * width) / metre
    y = (floor - np.arange(height)[:, None]) / metre

    for step, points in enumerate(positions):
        frame = np.empty((height, width, 3), np.float32)
        frame[:] = _PAPER

        def paint(
            inside: np.ndarray, colour: tuple[int, int, int], frame: np.ndarray = frame
        ) -> None:
            """`inside` (H, W) m from the edge, positive within: edges are a pixel soft."""
            cover = np.clip(inside * metre + 0.5, 0.0, 1.0)[..., None]
            frame += cover * (np.array(colour, np.float32) - frame)

        if upright:
            paint(-np.abs(y) + 0.01 + 0.0 * x, _LINE)
        if "bar_height" in tracks:
            post = np.minimum(
                0.02 - np.abs(x), np.minimum(y, float(tracks["bar_height"][step]) - y)
            )
            paint(post, _TARGET)
        if "target" in tracks:
            away = np.hypot(x - tracks["target"][step, 0], y - tracks["target"][step, 1])
            paint(0.025 - np.abs(away - 1.6 * _RADIUS), _TARGET)
        for number, (at_x, at_y) in reversed(list(enumerate(points.tolist()))):
            lifted = at_y + (_RADIUS if upright else 0.0)
            paint(_RADIUS - np.hypot(x - at_x, y - lifted), _OTHER if number else _POINT)
        yield frame.round().astype(np.uint8)
