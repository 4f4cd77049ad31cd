"""Pictures of points on a plane, drawn with NumPy alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np

_PAPER, _LINE = (244, 245, 247), (150, 158, 170)
_TARGET, _POINT, _OTHER = (213, 94, 0), (0, 114, 178), (86, 180, 233)
_RADIUS = 0.09  #: m, of a point
_BAR = 0.02  #: m, half of a bar's width

#: m from the edge of what is drawn, positive within, (H, W) at columns (W,) and rows (H, 1) of the plane.
Inside = Callable[[np.ndarray, np.ndarray], np.ndarray]
Part = tuple[slice, slice]


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

    def paint(frame: np.ndarray, part: Part, inside: Inside, colour: tuple[int, int, int]) -> None:
        """Paint what is `inside` within this part of the frame: edges are a pixel soft."""
        depth = inside(x[part[1]], y[part[0]])
        cover = np.clip(depth * metre + 0.5, 0.0, 1.0)[..., None]
        frame[part] += cover * (np.array(colour, np.float32) - frame[part])

    def around(at_x: float, at_y: float, half_x: float, half_y: float) -> Part:
        """The part of the frame with this box of the plane, in m, and what its soft edge needs."""
        parts = []
        centre_x, centre_y = 0.5 * width + at_x * metre, floor - at_y * metre
        for centre, half, size in ((centre_y, half_y, height), (centre_x, half_x, width)):
            ends = np.array((centre - half * metre - 2.0, centre + half * metre + 3.0))
            parts.append(slice(*np.nan_to_num(ends).clip(0, size).astype(int)))
        return parts[0], parts[1]

    empty = np.empty((height, width, 3), np.float32)
    empty[:] = _PAPER
    if upright:
        paint(empty, np.s_[:, :], lambda x, y: -np.abs(y) + 0.01 + 0.0 * x, _LINE)
    ground = empty.round().astype(np.uint8)
    frame = empty.copy()

    for step, points in enumerate(positions):
        shapes: list[tuple[Part, Inside, tuple[int, int, int]]] = []
        if "bar_height" in tracks:
            top = float(tracks["bar_height"][step])
            shapes.append((around(0.0, 0.5 * top, _BAR, 0.5 * top), _bar(top), _TARGET))
        if "target" in tracks:
            to_x, to_y = tracks["target"][step]
            reaches = 2.0 * _RADIUS
            shapes.append((around(to_x, to_y, reaches, reaches), _ring(to_x, to_y), _TARGET))
        for number, (at_x, at_y) in reversed(list(enumerate(points.tolist()))):
            lifted = at_y + (_RADIUS if upright else 0.0)
            part = around(at_x, lifted, _RADIUS, _RADIUS)
            shapes.append((part, _disc(at_x, lifted), _OTHER if number else _POINT))
        for shape in shapes:
            paint(frame, *shape)
        shown = ground.copy()
        for part, _, _ in shapes:
            shown[part] = frame[part].round()
        for part, _, _ in shapes:
            frame[part] = empty[part]
        yield shown


def _bar(top: float) -> Inside:
    return lambda x, y: np.minimum(_BAR - np.abs(x), np.minimum(y, top - y))


def _ring(at_x: float, at_y: float) -> Inside:
    return lambda x, y: 0.025 - np.abs(np.hypot(x - at_x, y - at_y) - 1.6 * _RADIUS)


def _disc(at_x: float, at_y: float) -> Inside:
    return lambda x, y: _RADIUS - np.hypot(x - at_x, y - at_y)
