"""Whether a robot's angles are in radians, where nothing says so."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mujoco
import numpy as np
import torch
from torch import Tensor

from understudy.errors import FileError
from understudy_motion.clip import Clip
from understudy_tensors import rotations

__all__ = ["check_radians"]

#: Angles are asked about where, as radians, they leave a hinge's range by so many rad, or turn faster than so many rad/s for
#: a tenth of the clip; or where the lowest point of a figure that stands on the floor as degrees, so many m from it, rises
#: and sinks by so many m, and so many times as much as that. So many frames are looked at.
_OUT, _FAST, _STANDS, _SWAYS, _STEADIER, _LOOKED_AT = 0.5, 50.0, 0.1, 0.06, 5.0, 200
#: They are radians where it rises and sinks by more m in degrees, and by less than half of that in radians; where it is so
#: many m from the floor as radians, and so many as degrees; or where the root goes so many m or turns by so many rad, for
#: which a few degrees of the hinges are not enough. Else both may be, which matters from so many rad on.
_SHOWN, _ON_FLOOR, _OFF_FLOOR, _GOES, _MATTERS = 0.005, 0.01, 0.03, 0.3, 0.01


def check_radians(
    name: str,
    model: mujoco.MjModel,
    clearance: Callable[[Tensor], Tensor],
    clip: Clip,
    qpos: Tensor,
    addresses: Sequence[int],
    angles: np.ndarray,
) -> None:
    """A FileError unless `angles` (F, H) of `clip`, which are taken for radians and which nothing says to be, can only be
    that: by the ranges of the `model`'s hinges, by how fast they turn, by how high its lowest point is (`clearance` of poses
    like `qpos`), or by how far its root goes. `name` is the robot's."""
    own, others = angles, np.radians(angles)
    if np.abs(own - others).max(initial=0.0) < _MATTERS:
        return
    joint_of = {int(model.jnt_qposadr[j]): j for j in range(model.njnt)}
    ids = [joint_of[address] for address in addresses]
    least, most = model.jnt_range[ids].T
    limited = model.jnt_limited[ids] != 0

    def beyond(given: np.ndarray) -> np.ndarray:
        """(H,) rad by which each hinge leaves its range."""
        return np.where(limited, np.maximum(least - given, given - most).max(axis=0), 0.0)

    wrong = f"Clip {clip.source} does not say the unit of its angles, and "
    cure = "give motion.angles=degrees (--angles degrees), or motion.angles=radians if they are."
    far, fits = beyond(own), beyond(others).max() <= _OUT
    if (worst := int(far.argmax())) >= 0 and far[worst] > _OUT and fits:
        at = own[np.abs(own[:, worst]).argmax(), worst]
        raise FileError(
            f"{wrong}as radians they turn {name}'s '{model.joint(ids[worst]).name}' to {at:.3g}, which may go from "
            f"{least[worst]:.3g} to {most[worst]:.3g}, and as degrees all stay in their ranges: {cure}"
        )
    steps = np.diff(clip.times.numpy())[:, None]
    speeds = np.abs(np.diff(own, axis=0)) / np.maximum(steps, 1e-9)
    if fits and len(speeds) and (fast := float(np.percentile(speeds.max(axis=1), 90))) > _FAST:
        raise FileError(
            f"{wrong}as radians {name}'s hinges turn by {fast:.0f} rad/s, as degrees by {np.radians(fast):.2g} rad/s: {cure}"
        )
    every = max(1, len(qpos) // _LOOKED_AT)
    lowest = []
    for given in (own, others):
        few = qpos[::every].clone()
        few[:, addresses] = torch.from_numpy(given[::every])
        lowest.append(clearance(few).amin(dim=1).numpy())
    sways = [float(np.percentile(low, 90) - np.percentile(low, 10)) for low in lowest]
    heights = [abs(float(np.median(low))) for low in lowest]
    if heights[1] < _STANDS and sways[0] > max(_SWAYS, _STEADIER * sways[1]):
        raise FileError(
            f"{wrong}as radians {name}'s lowest point rises and sinks by {sways[0]:.2g} m, as degrees by "
            f"{sways[1]:.2g} m: {cure}"
        )
    place, turn = clip.root_position, clip.rotations[:, 0]
    away = float((place.amax(dim=0) - place.amin(dim=0)).norm())
    around = float(rotations.angle_between(turn, turn[:1].expand_as(turn)).max())
    steady = sways[1] > _SHOWN and sways[0] < sways[1] / 2.0
    stands = heights[0] < _ON_FLOOR and heights[1] > _OFF_FLOOR
    if fits and not (steady or stands) and max(away, around) < _GOES:
        raise FileError(
            f"{wrong}they may be radians or degrees: {name} hardly moves from its place, and both keep to its ranges: {cure}"
        )
