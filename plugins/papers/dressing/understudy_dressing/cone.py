"""The cone within which an upper arm stays, fitted to published ranges of motion.

The paper bounds shoulder and elbow by a classifier that was not published. Here the sum of the elbow's distances to two fixed
points beside the shoulder is bounded, which on a sphere around it is an ellipse; MuJoCo has that as a tendon with a limit.
Directions are the left arm's from its shoulder: x forward, y out to its side, z up.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.optimize import least_squares

#: degrees, of adult men: Boone and Azen 1979, "Normal range of motion of joints in male subjects"; horizontally from the side.
RANGES = {
    "flexion": 166.7,
    "extension": 62.3,
    "abduction": 184.0,
    "horizontal_flexion": 140.7,
    "horizontal_extension": 45.4,
}
#: degrees, between the two points as the shoulder sees them, at most: beyond, the ellipse is a band.
_APART = 120.0


@dataclass(frozen=True)
class Cone:
    """A direction (3,) is inside where its distances to both foci, unit directions, add up to no more than `most`."""

    foci: tuple[np.ndarray, np.ndarray]  #: (3,) each
    most: float  #: of the sphere's radius

    def excess(self, direction: np.ndarray) -> np.ndarray:
        """(…) how far unit directions (…, 3) are outside, of the sphere's radius; negative inside."""
        a, b = (np.linalg.norm(direction - one, axis=-1) for one in self.foci)
        return a + b - self.most

    @property
    def axis(self) -> np.ndarray:
        """(3,) unit: its middle."""
        middle = self.foci[0] + self.foci[1]
        return middle / np.linalg.norm(middle)

    def reaches(self, direction: np.ndarray) -> float:
        """rad, from the middle to the border on the side of a direction (3,)."""
        across = direction - (direction @ self.axis) * self.axis
        across = across / np.linalg.norm(across)
        angle = np.linspace(0.0, np.pi, 10_000)
        arc = np.cos(angle)[:, None] * self.axis + np.sin(angle)[:, None] * across
        outside = self.excess(arc) > 0
        return float(angle[outside.argmax()]) if outside.any() else np.pi


def limits() -> dict[str, np.ndarray]:
    """(3,) unit directions of an arm at the end of each of :data:`RANGES`."""

    def towards(name: str, hanging: bool, forwards: float, out: float) -> np.ndarray:
        angle = np.radians(RANGES[name])
        s, c = np.sin(angle), np.cos(angle)
        # from where it hangs; or, level, from the side on
        return np.array([forwards * s, out * s, -c] if hanging else [forwards * s, c, 0.0])

    return {
        "flexion": towards("flexion", True, 1.0, 0.0),
        "extension": towards("extension", True, -1.0, 0.0),
        "abduction": towards("abduction", True, 0.0, 1.0),
        "horizontal_flexion": towards("horizontal_flexion", False, 1.0, 0.0),
        "horizontal_extension": towards("horizontal_extension", False, -1.0, 0.0),
    }


@cache
def fitted() -> Cone:
    """Least squares over :func:`limits` of how far they are outside, the foci at most :data:`_APART` from each other."""
    ends = np.stack(list(limits().values()))

    def cone(p: np.ndarray) -> Cone:
        turn, rise, roll, apart, most = p
        axis = np.array([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)])
        level = np.array([-np.sin(turn), np.cos(turn), 0.0])
        to = np.cos(roll) * level + np.sin(roll) * np.cross(axis, level)
        a, b = (np.cos(apart) * axis + sign * np.sin(apart) * to for sign in (1.0, -1.0))
        return Cone((a, b), float(most))

    half = np.radians(_APART) / 2
    bounds = ([-np.pi, -1.5, -np.pi, 0.0, 2.0], [np.pi, 1.5, np.pi, half, 4.0])
    begin = [np.pi / 4, -0.4, np.pi / 2, half / 2, 3.0]
    return cone(least_squares(lambda p: cone(p).excess(ends), begin, bounds=bounds).x)
