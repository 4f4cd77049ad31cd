"""Generated sitting down on a chair and standing up from it.

The feet stay flat where they are, and the centre of mass stays over them until the seat bears: the
trunk leans forward as the hips go back, as far as that takes (Schenkman et al., "Whole-body movements
during rising to standing from sitting", 1990, whose phases these are). On the seat the trunk rights
itself. Both begin or end standing at ease over the origin, facing x, with the chair behind.

The chair is a box. Its seat reaches forward to :data:`OVERLAP` m ahead of where the hips end up, so
that the thighs lie on it, or on its front edge where it is so high that they slope down.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.optimize import root_scalar
from scipy.spatial.transform import Rotation

from understudy_humanoid.clips import figure, standing
from understudy_humanoid.clips.curves import between, carried
from understudy_humanoid.clips.limbs import HAND, arm, arm_keys, arm_to, leg, leg_to, planted
from understudy_motion.clip import Clip

OVERLAP = 0.08  #: m, of the seat's front edge ahead of the seated hips
SEAT_HEIGHTS = (0.35, 0.55)  #: m, lowest and highest

#: m along x, of the centre of mass at seat contact: over the heels.
_REARMOST = -0.072
_LEAN = 54.0  #: degrees, of the trunk at seat contact, on a seat of 0.45 m
_LEAN_LOWER = 30.0  #: degrees more per m that the seat is lower
_PELVIS = 0.7  #: the pelvis' part in leaning; the spine bends for the rest
_ALONG = 0.16  #: m from the hip, where on the thigh the hand ends up


@dataclass(frozen=True)
class _Timing:
    """When things happen, as parts of the time from standing to sitting still."""

    lowering: tuple[float, float]  #: the hips go down; the end is the seat's contact
    leaning: tuple[float, float]
    righting: tuple[float, float]
    reaching: tuple[float, float]  #: the arms go forward
    resting: tuple[float, float]  #: the hands go to the thighs
    #: The arms' farthest, degrees: the shoulders' flexion and abduction, the elbows' flexion.
    reach: tuple[float, float, float]


_SITTING = _Timing(
    lowering=(0.06, 0.66),
    leaning=(0.02, 0.64),
    righting=(0.66, 0.96),
    reaching=(0.02, 0.6),
    resting=(0.67, 0.97),
    reach=(62.0, 8.0, 24.0),
)
#: Rising, backwards in time: the trunk swings forward faster than it rights itself in sitting.
_RISING = _Timing(
    lowering=(0.08, 0.68),
    leaning=(0.06, 0.66),
    righting=(0.68, 0.97),
    reaching=(0.04, 0.56),
    resting=(0.69, 0.97),
    reach=(44.0, 8.0, 26.0),
)


def generated_sit(
    *,
    #: m above the floor, from 0.35 to 0.55
    seat_height: float = 0.45,
    #: s, from standing to sitting still, from 1.2 to 6
    seconds: float = 2.2,
    #: frames/s of the clip, from 10 to 1000
    frame_rate: float = 60.0,
) -> Clip:
    """Sitting down on a chair behind the figure. It does not loop.

    Raises
    ------
    ConfigError
        a parameter is outside its range.
    """
    return _clip("sit", seat_height, seconds, frame_rate, _SITTING)


def generated_stand(
    *,
    #: m above the floor, from 0.35 to 0.55
    seat_height: float = 0.45,
    #: s, from sitting to standing still
    seconds: float = 2.0,
    #: frames/s of the clip, from 10 to 1000
    frame_rate: float = 60.0,
) -> Clip:
    """Standing up from a chair; as :func:`generated_sit`."""
    return _clip("stand", seat_height, seconds, frame_rate, _RISING, backwards=True)


@lru_cache(maxsize=32)  # takes long, and each part of a run asks for it anew
def _clip(
    name: str,
    seat_height: float,
    seconds: float,
    frame_rate: float,
    timing: _Timing,
    *,
    backwards: bool = False,
) -> Clip:
    """The motion from standing to sitting, or `backwards`."""
    figure.check(name, *SEAT_HEIGHTS, seat_height=seat_height)
    figure.check(name, 1.2, 6.0, seconds=seconds)
    motion = figure.grid(name, seconds, frame_rate)
    sitting = _SittingDown(motion.times / seconds, timing, seat_height)
    hands: dict[figure.Side, figure.Array] = {
        side: arm_keys(side, [(0.0, 26.0, 0.0, 36.0)])[0, 1:] for side in figure.SIDES
    }
    for _ in range(2):
        root, pose = sitting.motion(hands)
        hands = {side: _hand_on_thigh(side, root, pose) for side in figure.SIDES}
    root, pose = sitting.motion(hands)
    order = -1 if backwards else 1
    return figure.make_clip(
        name, motion, root[::order], {joint: turned[::order] for joint, turned in pose.items()}
    )


class _SittingDown:
    """The motion from standing to sitting still, at `part` (F,) of its time."""

    def __init__(self, part: figure.Array, timing: _Timing, seat_height: float) -> None:
        self.part, self.seat_height = part, seat_height
        most = _LEAN + _LEAN_LOWER * (0.45 - seat_height) - standing.PITCH
        lean = most * (between(part, *timing.leaning) - between(part, *timing.righting))
        self.trunk = figure.trunk(
            figure.turns(0.0, standing.PITCH + _PELVIS * lean, 0.0),
            figure.turns(0.0, standing.PITCH + lean, 0.0),
            figure.turns(0.0, standing.PITCH + 0.4 * lean, 0.0),
        )
        #: Where the feet stand all the time: ankle (1, 3) m and rotation (1,).
        self.feet: dict[figure.Side, tuple[figure.Array, Rotation]] = {
            side: planted(standing.place(side), figure.SIGN[side] * standing.TOE_OUT, 0.0)
            for side in figure.SIDES
        }
        self.reach = timing.reach
        self.reaching = between(part, *timing.reaching)[:, None]
        self.resting = between(part, *timing.resting)[:, None]
        self.down = between(part, *timing.lowering)
        #: How many of the times are up to the seat's contact.
        self.contact = int(np.argmax(self.down >= 1.0)) + 1

    def motion(self, hands: Mapping[figure.Side, figure.Array]) -> tuple[figure.Array, figure.Pose]:
        """The root's path and the pose, of arms that end at these coordinates (4,)."""
        still = len(self.part) - self.contact
        root = np.pad(self.lowered, [(0, still), (0, 0)], mode="edge")
        return root, self.on_feet(root, {**self.trunk, **self.arms(hands)})

    def arms(self, hands: Mapping[figure.Side, figure.Array]) -> figure.Pose:
        pose: figure.Pose = {}
        for side in figure.SIDES:
            hanging, ahead = arm_keys(side, [(0.0, *standing.ARM), (0.0, *self.reach)])[:, 1:]
            reached = hanging + (ahead - hanging) * self.reaching
            pose |= arm(side, reached + (hands.get(side, ahead) - ahead) * self.resting)
        return pose

    def on_feet(self, root: figure.Array, upper: figure.Pose) -> figure.Pose:
        pose = dict(upper)
        for side, (ankle, foot) in self.feet.items():
            pose |= leg(side, leg_to(side, root, pose["root"], ankle, foot))
        return pose

    @cached_property
    def lowered(self) -> figure.Array:
        """(contact, 3) m: the root's path until the seat bears. It is the same wherever the hands end up: they go
        there later."""
        upper = {**self.trunk, **self.arms({})}

        def with_hips(hips: float, rows: slice) -> tuple[figure.Array, figure.Pose]:
            """With the hips `hips` m high at seat contact."""
            down = self.down[rows]
            height = standing.HEIGHT + (hips - standing.HEIGHT) * down
            goal = np.stack([_REARMOST * down, np.zeros_like(down), height], axis=1)
            above = {joint: turned[rows] for joint, turned in upper.items()}
            return carried(goal, lambda root: self.on_feet(root, above), axes=(0,))

        touching = slice(self.contact - 1, self.contact)
        hips = root_scalar(
            lambda hips: _clearance(*with_hips(hips, touching), self.seat_height),
            bracket=(self.seat_height, self.seat_height + 0.2),
            xtol=1e-5,
        ).root
        return with_hips(hips, slice(self.contact))[0]


def _hand_on_thigh(side: figure.Side, root: figure.Array, pose: figure.Pose) -> figure.Array:
    """The coordinates (4,) of the arm whose hand lies on the thigh in the last frame."""
    thigh = figure.ROWS[f"{side}_hip"]
    root, pelvis, chest, hip = root[-1:], *(pose[k][-1:] for k in ("root", "chest", f"{side}_hip"))
    wrist = root + pelvis.apply(thigh.offset + hip.apply([thigh.size[0] + HAND, 0.0, -_ALONG]))
    return arm_to(side, root, pelvis, chest, wrist)[0]


def _clearance(root: figure.Array, pose: figure.Pose, seat_height: float) -> float:
    """Height in m of the thigh above the seat, where it is least, in the first frame."""
    thigh = figure.ROWS["left_hip"]
    radius, half = thigh.size
    axis = np.outer(np.linspace(-half, half, 61), [0.0, 0.0, 1.0]) + thigh.centre
    x, _, z = (root[0] + pose["root"][0].apply(thigh.offset + pose["left_hip"][0].apply(axis))).T
    # Ahead of the seat's front edge the thigh's round underside may pass below its top.
    ahead = np.maximum(x - root[0, 0] - OVERLAP, 0.0) / radius
    under = z - radius * np.sqrt(np.maximum(1.0 - ahead**2, 0.0))
    return float(under[ahead < 1.0].min() - seat_height)
