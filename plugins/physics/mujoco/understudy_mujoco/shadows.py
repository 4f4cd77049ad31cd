"""Soft shadows on horizontal planes, worked out with NumPy: of moving figures, and of what stands around.

A plane is the floor, or the top of a box that stands on it. What is below a plane casts nothing on it.
World frame, m.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import ConvexHull, QhullError

#: Where sunlight goes.
SUN = np.array([0.4, 0.6, -1.3])
#: m: half a side of the patch in which a figure's shadow is worked out, and of its cells.
_REACH, _CELL = 1.6, 0.04
#: m: of the cells of shadows that are worked out once; how many cells these have at most along an axis.
_FINE, _MOST = 0.02, 1500
#: m: how blurred a shadow is at what casts it, and how much more for each metre above the plane.
_BLUR, _BLUR_PER_METRE = 0.03, 0.35
#: Darkness that is not seen, and the m of height by which what is seen on a plane may be off it.
_UNSEEN, _SAME = 0.004, 0.001
#: m: a box whose top is narrower is too small for shadows to be seen on it.
_NARROW = 0.15
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)


@dataclass(frozen=True)
class Patch:
    """How much sunlight is kept from a rectangle of a plane."""

    dark: np.ndarray  #: (X, Y) float32 in [0, 1]
    origin: np.ndarray  #: (2,) where the first cell is
    cell: float  #: side of a cell

    def corners(self) -> np.ndarray:
        """(4, 2)"""
        long, wide = self.cell * np.array(self.dark.shape)
        return self.origin + np.array([[x, y] for x in (0.0, long) for y in (0.0, wide)])

    def at(self, places: np.ndarray) -> np.ndarray:
        """Darkness (…) at `places` (2, …); 0 beside the patch."""
        shape = (2,) + (1,) * (places.ndim - 1)
        cells = (places - self.origin.astype(np.float32).reshape(shape)) / np.float32(self.cell)
        return map_coordinates(self.dark, cells, order=1, output=np.float32)


@dataclass(frozen=True)
class Top:
    """The top of a box that stands upright, on which shadows fall."""

    centre: np.ndarray  #: (3,)
    axes: np.ndarray  #: (2, 2) unit vectors of its sides in the plane
    half: np.ndarray  #: (2,) half the sides' lengths

    def corners(self) -> np.ndarray:
        """(4, 2)"""
        signs = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
        return self.centre[:2] + (signs * self.half) @ self.axes

    def seen(self, places: np.ndarray) -> np.ndarray:
        """(…) bool: which of `places` (3, …) are on it."""
        shape = (3,) + (1,) * (places.ndim - 1)
        away = places - self.centre.astype(np.float32).reshape(shape)
        found = np.abs(away[2]) < _SAME
        for axis, half in zip(self.axes.astype(np.float32), self.half, strict=True):
            found &= np.abs(axis[0] * away[0] + axis[1] * away[1]) <= half
        return found


def _along_the_sun(points: np.ndarray, heights: np.ndarray) -> np.ndarray:
    """(…, 2) where the shadows of `points` (…, 3) fall that are `heights` (…) above the plane."""
    return points[..., :2] - heights[..., None] / SUN[2] * SUN[:2]


def _smooth(share: np.ndarray) -> np.ndarray:
    share = np.clip(share, 0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)


class FigureShadow:
    """The shadow of a figure, as of capsules about as large as its geoms.

    It is the sharper and darker, the nearer what casts it is to the plane.
    """

    def __init__(self, model: mujoco.MjModel, geoms: np.ndarray) -> None:
        half = np.sort(model.geom_aabb[geoms, 3:], axis=1)
        longest = model.geom_aabb[geoms, 3:].argmax(axis=1)
        self._geoms = geoms
        self._radius = np.sqrt(half[:, 0] * half[:, 1]).astype(np.float32)
        self._centre = model.geom_aabb[geoms, :3]
        self._along = np.eye(3)[longest] * np.maximum(half[:, 2] - self._radius, 0.0)[:, None]
        count = round(2 * _REACH / _CELL) + 1
        #: (C,) m from the patch's middle, along either axis.
        self._line = np.linspace(-_REACH, _REACH, count, dtype=np.float32)

    def cast(self, data: mujoco.MjData, plane: float = 0.0) -> Patch | None:
        """On the plane at this height; None if there is none."""
        axes = data.geom_xmat[self._geoms].reshape(-1, 3, 3)
        middle = data.geom_xpos[self._geoms] + (axes @ self._centre[..., None])[..., 0]
        along = (axes @ self._along[..., None])[..., 0]
        ends = np.stack([middle - along, middle + along])  # (2, G, 3)
        above = ends[..., 2].max(axis=0) + self._radius > plane
        if not above.any():
            return None
        ends, radii = ends[:, above], self._radius[above]
        heights = np.maximum(ends[..., 2] - plane, 0.0)
        feet = _along_the_sun(ends, heights)
        origin = 0.5 * (feet.min(axis=(0, 1)) + feet.max(axis=(0, 1)))
        line = self._line
        light = np.ones((len(line), len(line)), np.float32)
        for k, radius in enumerate(radii):
            (ax, ay), (bx, by) = foot = (feet[:, k] - origin).astype(np.float32)
            high, higher = heights[:, k].astype(np.float32)
            reach = radius + 0.5 * (_BLUR + _BLUR_PER_METRE * max(high, higher))
            first = np.searchsorted(line, foot.min(axis=0) - reach)
            beyond = np.searchsorted(line, foot.max(axis=0) + reach)
            rows, columns = map(slice, first, beyond)  # nothing is darker elsewhere
            x, y = line[rows, None], line[None, columns]
            dx, dy = bx - ax, by - ay
            share = ((x - ax) * dx + (y - ay) * dy) / max(dx * dx + dy * dy, 1e-6)
            share = np.clip(share, 0.0, 1.0)
            distance = np.hypot(x - ax - share * dx, y - ay - share * dy)
            blur = _BLUR + _BLUR_PER_METRE * (high + share * (higher - high))
            dark = _smooth(0.5 + (radius - distance) / blur)
            light[rows, columns] *= 1.0 - dark * np.minimum(1.0, 1.6 * radius / blur + 0.1)
        dark = 1.0 - light
        rows, columns = (np.flatnonzero((dark > _UNSEEN).any(axis=1 - axis)) for axis in range(2))
        if not len(rows) or not len(columns):
            return None
        first, beyond = np.array([rows[0], columns[0]]), (rows[-1] + 1, columns[-1] + 1)
        part = dark[first[0] : beyond[0], first[1] : beyond[1]]
        return Patch(part, origin - _REACH + _CELL * first, _CELL)


class StillShadow:
    """The shadow of what stands around a figure: of boxes and hulls, each blurred by its mean height.

    It is worked out anew only where something has moved, or has another size.
    """

    def __init__(self, model: mujoco.MjModel, geoms: np.ndarray) -> None:
        self._model, self._geoms = model, geoms
        self._known: bytes = b""
        self._patches: dict[float, Patch | None] = {}

    def cast(self, data: mujoco.MjData, plane: float = 0.0) -> Patch | None:
        """On the plane at this height; None if there is none."""
        geoms, model = self._geoms, self._model
        now = b"".join(
            part[geoms].tobytes() for part in (data.geom_xpos, data.geom_xmat, model.geom_size)
        )
        if now != self._known:
            self._known, self._patches = now, {}
        if plane not in self._patches:
            self._patches[plane] = self._cast(data, plane)
        return self._patches[plane]

    def points(self, data: mujoco.MjData) -> np.ndarray:
        """(P, 3) corners of all of it."""
        return np.concatenate([self._points(data, int(geom)) for geom in self._geoms])

    def tops(self, data: mujoco.MjData) -> list[Top]:
        """Of the boxes that stand upright and hide what is behind them, the highest first."""
        found = []
        for geom in self._geoms:
            turn, size = data.geom_xmat[geom].reshape(3, 3), self._model.geom_size[geom]
            box = self._model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX
            upright = abs(turn[2, 2]) > 1.0 - 1e-9
            opaque = self._model.geom_rgba[geom, 3] >= 1.0
            if box and upright and opaque and 2.0 * size[:2].min() >= _NARROW:
                centre = data.geom_xpos[geom] + [0.0, 0.0, size[2]]
                if centre[2] > _SAME:
                    found.append(Top(centre, turn[:2, :2].T, size[:2]))
        return sorted(found, key=lambda top: -top.centre[2])

    def _cast(self, data: mujoco.MjData, plane: float) -> Patch | None:
        hulls = []
        for geom in self._geoms:
            points = self._points(data, int(geom))
            heights = np.maximum(points[:, 2] - plane, 0.0)
            if heights.max() <= _SAME:
                continue
            try:
                hull = ConvexHull(_along_the_sun(points, heights))
            except QhullError:  # nothing but an edge of it is above the plane
                continue
            blur = _BLUR + 0.5 * _BLUR_PER_METRE * float(heights.min() + heights.max())
            hulls.append((hull, blur, float(self._model.geom_rgba[geom, 3])))
        if not hulls:
            return None
        low = np.min([hull.min_bound - blur for hull, blur, _ in hulls], axis=0)
        high = np.max([hull.max_bound + blur for hull, blur, _ in hulls], axis=0)
        cell = max(_FINE, float((high - low).max()) / _MOST)
        lines = [
            np.arange(a, b + cell, cell, dtype=np.float64) for a, b in zip(low, high, strict=True)
        ]
        light = np.ones((len(lines[0]), len(lines[1])), np.float32)
        for hull, blur, opacity in hulls:
            begin = [
                np.searchsorted(c, b - blur) for c, b in zip(lines, hull.min_bound, strict=True)
            ]
            end = [np.searchsorted(c, b + blur) for c, b in zip(lines, hull.max_bound, strict=True)]
            x, y = (line[a:b] for line, a, b in zip(lines, begin, end, strict=True))
            outside = np.full((len(x), len(y)), -np.inf)
            for nx, ny, offset in hull.equations:
                np.maximum(outside, nx * x[:, None] + ny * y + offset, out=outside)
            light[begin[0] : end[0], begin[1] : end[1]] *= 1.0 - opacity * _smooth(
                0.5 - outside / blur
            )
        return Patch((1.0 - light).astype(np.float32), low, cell)

    def _points(self, data: mujoco.MjData, geom: int) -> np.ndarray:
        """(P, 3) corners of a geom, or of the box around it."""
        model = self._model
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.geom_dataid[geom]
            first = model.mesh_vertadr[mesh]
            own = model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(float)
        elif model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
            own = _CORNERS * model.geom_size[geom]  # also where the size has changed
        else:
            own = model.geom_aabb[geom, :3] + _CORNERS * model.geom_aabb[geom, 3:]
        return data.geom_xpos[geom] + own @ data.geom_xmat[geom].reshape(3, 3).T
