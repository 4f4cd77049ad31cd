"""A camera, and the endless floor and the sky that it sees.

H × W pixels, of which the last R rows see the floor; world frame, m.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

__all__ = ["Camera", "Scenery"]

#: Colours, 0 to 255: the floor's squares, the horizon and the top of the sky.
_LIGHT, _DARK = np.array([222.0, 227, 233]), np.array([206.0, 213, 221])
_HORIZON, _ZENITH = np.array([238.0, 242, 246]), np.array([176.0, 198, 222])
#: m: a square's side; where the floor has faded into the horizon by 1 - 1/e.
_SQUARE, _HAZE = 1.0, 9.0


@dataclass(frozen=True)
class Camera:
    """A camera that follows what it looks at, at a constant height and in a constant direction."""

    aims: np.ndarray  #: (T, 2) m
    height: float  #: m, of what it looks at
    distance: float  #: m
    azimuth: float = 120.0  #: degrees, MuJoCo's
    elevation: float = -9.0  #: degrees


class Scenery:
    """Floor and sky behind the figures. Only the places of the floor's squares differ between frames."""

    def __init__(self, camera: Camera, fovy: float, width: int, height: int) -> None:
        self.camera, self.width, self.height = camera, width, height
        azimuth, elevation = np.radians([camera.azimuth, camera.elevation])
        flat = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        self.forward = np.cos(elevation) * flat + [0.0, 0.0, np.sin(elevation)]
        self.right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
        self.up = np.cross(self.right, self.forward)
        self.focal = 0.5 * height / np.tan(np.radians(0.5 * fovy))  # pixels
        #: The eye, from the aim on the floor.
        self.eye = np.array([0.0, 0.0, camera.height]) - camera.distance * self.forward

    def pixels(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(P, 2) column and row at which `points` (P, 3), from the aim on the floor, are seen, and
        (P,) pixels a metre there."""
        away = points - self.eye
        scale = self.focal / np.maximum(away @ self.forward, 0.1)
        column = 0.5 * self.width + scale * (away @ self.right)
        row = 0.5 * self.height - scale * (away @ self.up)
        return np.stack([column, row], axis=1), scale

    @cached_property
    def _rays(self) -> np.ndarray:
        """(H, W, 3): where each pixel looks."""
        rows = (0.5 * self.height - np.arange(self.height) - 0.5) / self.focal
        columns = (np.arange(self.width) + 0.5 - 0.5 * self.width) / self.focal
        up, right = rows[:, None, None] * self.up, columns[None, :, None] * self.right
        return self.forward + up + right

    @cached_property
    def horizon(self) -> int:
        """The first row that sees the floor; the camera is not rolled."""
        return int((self._rays[:, 0, 2] >= -1e-3).sum())

    @cached_property
    def floor(self) -> np.ndarray:
        """(2, R, W) float32 m: the place on the floor, from the aim, that each pixel below the horizon sees."""
        rays = self._rays[self.horizon :]
        reach = -self.eye[2] / rays[..., 2]
        return np.moveaxis(self.eye[:2] + reach[..., None] * rays[..., :2], 2, 0).astype(np.float32)

    @cached_property
    def _haze(self) -> np.ndarray:
        """(R, W, 1): the share of the floor's colour that haze leaves."""
        distance = np.linalg.norm(self.floor - self.eye[:2, None, None], axis=0)
        return np.exp(-((distance / _HAZE) ** 2))[..., None].astype(np.float32)

    @cached_property
    def _widths(self) -> np.ndarray:
        """(2, R, W): how much of the floor a pixel sees, along x and y, in squares."""
        down = np.abs(np.gradient(self.floor, axis=1)) if self.floor.shape[1] > 1 else 1.0
        return np.asarray(down + np.abs(np.gradient(self.floor, axis=2))) / _SQUARE + 1e-3

    @cached_property
    def _sky(self) -> np.ndarray:
        """(horizon, W, 3)"""
        upward = np.clip(self._rays[: self.horizon, :, 2:], 0.0, 1.0)
        share = 1.0 - np.exp(-2.2 * upward)
        return (_HORIZON + share * (_ZENITH - _HORIZON)).astype(np.float32)

    @cached_property
    def _empty(self) -> np.ndarray:
        """(H, W, 3): sky and an even floor."""
        floor = _HORIZON + self._haze * (0.5 * (_LIGHT + _DARK) - _HORIZON)
        return np.concatenate([self._sky, floor]).astype(np.float32)

    @cached_property
    def _contrast(self) -> np.ndarray:
        """(R, W): half the difference in brightness of light and dark squares, the same for all hues; 0
        where squares are smaller than pixels."""
        left = np.clip(1.5 - self._widths, 0.0, 1.0).prod(axis=0)
        half = 0.5 * float((_LIGHT - _DARK).mean())
        return (half * left * self._haze[..., 0]).astype(np.float32)

    @cached_property
    def _edges(self) -> np.ndarray:
        """(2, R, W): how steep the squares' edges are, a pixel wide."""
        return (4.0 / self._widths).astype(np.float32)

    def prepare(self) -> None:
        """Compute what all frames share, before threads ask for it."""
        _ = self._empty, self._contrast, self._edges

    def background(self, aim: np.ndarray) -> np.ndarray:
        """(H, W, 3) float32, 0 to 255, as seen when the camera looks at `aim` (2,) m."""
        shown = self._empty.copy()
        squares = self._contrast
        for place, edge, at in zip(self.floor, self._edges, aim, strict=True):
            # In pairs of squares; then how far inside a light one, dark ones being below 0.
            inside = place * np.float32(0.5 / _SQUARE) + np.float32(
                (0.5 * at / _SQUARE + 0.25) % 1.0
            )
            inside -= np.floor(inside)
            inside -= np.float32(0.5)
            np.abs(inside, out=inside)
            np.subtract(np.float32(0.25), inside, out=inside)
            inside *= edge
            np.clip(inside, -1.0, 1.0, out=inside)
            squares = squares * inside
        shown[self.horizon :] += squares[..., None]
        return shown
