"""What a motion file leaves open and its figure shows: the unit of lengths, and that of angles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from understudy_motion.clip import Clip
from understudy_motion.kinematics import forward_kinematics, tip_positions
from understudy_motion.reading import METRES

ADULT = (1.2, 2.3)
"""m, heights between a figure's lowest and highest point that leave no doubt about the unit."""
PLAUSIBLE = (0.4, 3.0)
"""m, heights that decide between units a power of ten apart."""
CMU = 0.0254 / 0.45
"""m in a unit of the CMU database's skeletons, which its conversions to BVH keep."""
LEAST_RADIANS, MOST_RADIANS = 0.3, 6.3
"""Largest angle of a file between which it may be of radians: less turns nothing much, and more is more than a turn."""
TYPED = 0.25
"""What angles are multiples of that somebody typed, in degrees."""
TRAVELS = 0.05
"""Of its size what a figure moves by, at least, that is no statue."""
CRUMPLED = 0.2
"""Of its size what its lowest point rises and sinks by more, where small angles in degrees are taken for radians."""
SHOWN, STEADIER = 0.005, 0.5
"""m by which the floor under a figure must seem to rise and sink to say anything; and what of it may be left where
its angles are read rightly."""
_SAMPLES = 200
"""Frames that are looked at."""


def unit_of_height(height: float) -> float | None:
    """Metres in the unit that makes a figure of this height an adult, or else plausible."""
    candidates = (
        *((METRES[unit], ADULT) for unit in ("m", "cm", "mm", "inch", "foot")),
        *((METRES[unit], PLAUSIBLE) for unit in ("m", "cm", "mm")),
        (CMU, ADULT),
    )
    for metres, (least, most) in candidates:
        if least <= height * metres <= most:
            return metres
    return None


def may_be_radians(angles: np.ndarray) -> bool:
    """Whether `angles`, said to be degrees, are so small that they may be radians."""
    largest = float(np.abs(angles).max(initial=0.0))
    return LEAST_RADIANS <= largest <= MOST_RADIANS and bool((angles % TYPED > 1e-9).any())


def are_radians(radians: Clip, degrees: Clip) -> bool:
    """Whether `radians` reads the angles of a file rightly, and not `degrees`, in which all of them are small.

    Either the root carries a figure through the room that hardly moves in `degrees`, and does not crumple in
    `radians`; or the figure's lowest point keeps its height in `radians`, as feet on a floor do, and not in `degrees`.
    """
    own, others, size = _sway(radians), _sway(degrees), _size(degrees)
    path = degrees.root_position
    travels = float((path.amax(dim=0) - path.amin(dim=0)).norm()) > TRAVELS * size
    return (travels and own < others + CRUMPLED * size) or (
        others > SHOWN and own < STEADIER * others
    )


def _size(clip: Clip) -> float:
    """m between the figure's ends, along an axis, in its first frame."""
    first = replace(
        clip,
        times=clip.times[:2],
        root_position=clip.root_position[:2],
        rotations=clip.rotations[:2],
    )
    positions, _ = forward_kinematics(first)
    return float((positions[0].amax(dim=0) - positions[0].amin(dim=0)).max())


def _sway(clip: Clip) -> float:
    """m between the heights of the lowest point in most frames."""
    every = max(1, clip.num_frames // _SAMPLES)
    few = replace(
        clip,
        times=clip.times[::every],
        root_position=clip.root_position[::every],
        rotations=clip.rotations[::every],
    )
    positions, world = forward_kinematics(few)
    lowest = positions[..., 2].amin(dim=1)
    tips = tip_positions(few, positions, world)[..., 2]
    if tips.shape[1]:
        lowest = lowest.minimum(tips.amin(dim=1))
    low, high = np.percentile(lowest.numpy(), (10, 90))
    return float(high - low)
