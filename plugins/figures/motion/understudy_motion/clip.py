"""A motion clip: poses of a jointed figure over time, and how to sample it.

A clip is kinematic and belongs to no physics model: a root position, a root rotation, and one local
rotation per joint. Everything is float64 on the CPU, SI, z up, x forward, quaternions wxyz.

In a looping clip the last frame is the first pose of the next cycle, so the cycle lasts
``times[-1]``. What the root gains over a cycle in the plane (a turn about the vertical and a
displacement) accumulates from cycle to cycle; height does not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from understudy.errors import FileError
from understudy_tensors import rotations

__all__ = [
    "Clip",
    "CycleTransform",
    "Skeleton",
    "align_signs",
    "angle_names",
    "cycle_transform",
    "resample",
    "sample",
    "velocities",
]

UNIT_TOLERANCE = 0.5
"""How far from 1 the norm of a given quaternion may be before it is an error.

Clips edited by hand stray far: of DeepMimic's released ones nine are off by more than 0.01, the kick
by 0.42. Within the tolerance a quaternion is normalised, beyond it its direction means nothing.
"""

ANGLE = "angle "
"""How the names of joints begin that are a robot's angles (:mod:`understudy_motion.readers.angles`)."""

MAX_DISTANCE = 1e5
"""Metres from the origin beyond which a root position is taken for damage."""


@dataclass(frozen=True)
class Skeleton:
    """The joint tree that a clip was recorded on; joint 0 is the root."""

    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    """Index of each joint's parent, -1 for the root, always smaller than the joint's own."""
    offsets: np.ndarray
    """(J, 3) m, each joint's origin in its parent's frame; the root's is zero."""
    tips: Mapping[str, np.ndarray] = field(default_factory=dict)
    """By joint name: (3,) m, the end of what hangs on the joint (toe, fingertip, crown), in its frame."""


@dataclass(frozen=True)
class Clip:
    """A checked motion clip. Construction normalises the quaternions and aligns their signs.

    Raises
    ------
    FileError
        naming ``source``, the frame and the field, when the content is not a motion.
    """

    name: str
    times: Tensor
    """(F,) s, from 0, strictly increasing, F >= 2."""
    root_position: Tensor
    """(F, 3) m, world."""
    rotations: Tensor
    """(F, J, 4): joint 0 in the world, every other joint relative to its parent."""
    joint_names: tuple[str, ...]
    loop: bool
    skeleton: Skeleton | None = None
    source: str = "generated"
    licence: str = "unknown"
    sha256: str = ""
    url: str = ""
    """Where the file was fetched from, if that is recorded."""
    attribution: str = ""
    """The acknowledgement that the licence asks for."""
    assumed: bool = False
    """Whether its angles were taken for radians though nothing says so: of a robot's, whose model tells more."""

    def __post_init__(self) -> None:
        times = self.times.to(torch.float64)
        position = self.root_position.to(torch.float64)
        rotation = self.rotations.to(torch.float64)
        frames, joints = times.shape[0], len(self.joint_names)
        if position.shape != (frames, 3) or rotation.shape != (frames, joints, 4):
            raise self._error(
                f"times {tuple(times.shape)}, root_position {tuple(position.shape)} and rotations "
                f"{tuple(rotation.shape)} do not describe {joints} joints over the same frames"
            )
        if frames < 2:
            raise self._error(f"a clip needs at least 2 frames and this one has {frames}")
        if len(set(self.joint_names)) != joints:
            twice = next(name for name in self.joint_names if self.joint_names.count(name) > 1)
            raise self._error(f"joint '{twice}' is named twice")
        self._require(times.isfinite(), "time is not a finite number")
        self._require(position.isfinite().all(-1), "root position is not finite")
        self._require(
            position.abs().amax(-1) <= MAX_DISTANCE,
            f"root position is more than {MAX_DISTANCE:g} m from the origin",
        )
        self._require(rotation.isfinite().all(-1).all(-1), "a rotation is not finite")
        if times[0] != 0.0:
            raise self._error(f"time of frame 0 is {times[0].item():g} s instead of 0")
        self._require(
            torch.cat((torch.ones(1, dtype=torch.bool), times.diff() > 0.0)),
            "time does not increase",
        )
        off_unit = (torch.linalg.vector_norm(rotation, dim=-1) - 1.0).abs()
        for joint, name in enumerate(self.joint_names):
            self._require(off_unit[:, joint] <= UNIT_TOLERANCE, f"{name} quaternion is not unit")
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "root_position", position)
        object.__setattr__(self, "rotations", align_signs(rotations.normalize(rotation)))

    @property
    def num_frames(self) -> int:
        """Stored frames, the closing frame of a loop included."""
        return self.times.shape[0]

    @property
    def duration(self) -> float:
        """Seconds from the first frame to the last: one cycle of a looping clip."""
        return self.times[-1].item()

    @property
    def frame_rate(self) -> float:
        """Mean frames per second."""
        return (self.num_frames - 1) / self.duration

    def _error(self, problem: str) -> FileError:
        return FileError(f"Clip {self.source}: {problem}.")

    def _require(self, good: Tensor, problem: str) -> None:
        """`good` (F,) bool; the first frame that is not good makes the error."""
        if not good.all():
            raise self._error(f"frame {int((~good).nonzero()[0, 0])}: {problem}")


@dataclass(frozen=True)
class CycleTransform:
    """The rigid planar motion of one cycle: p -> turn(heading) p + displacement, z kept."""

    displacement: Tensor
    """(2,) m, world."""
    heading: float
    """rad about world z, in (-pi, pi]."""

    @cached_property
    def _offset(self) -> tuple[float, float]:
        """The displacement as numbers: it is used in each step, where nothing may be fetched."""
        x, y = self.displacement.tolist()
        return x, y

    @property
    def straight(self) -> bool:
        """Whether it does not turn."""
        return abs(self.heading) < 1e-9

    def power(self, cycles: Tensor) -> tuple[Tensor, Tensor]:
        """The motion of ``cycles`` whole cycles, negative ones undoing.

        Parameters
        ----------
        cycles
            (N,) whole numbers, any floating dtype and device.

        Returns
        -------
        tuple[Tensor, Tensor]
            The displacement (N, 2) and the heading change (N,), from the closed form of
            ``sum_k turn(k heading) displacement``; no loop, no branch on tensor values.
        """
        x, y = self._offset
        if self.straight:
            return torch.stack((cycles * x, cycles * y), dim=-1), torch.zeros_like(cycles)
        angle = cycles * self.heading
        length = torch.sin(0.5 * angle) / math.sin(0.5 * self.heading)
        direction = 0.5 * (angle - self.heading)
        cos, sin = length * direction.cos(), length * direction.sin()
        return torch.stack((cos * x - sin * y, sin * x + cos * y), dim=-1), angle


def angle_names(clip: Clip) -> tuple[str, ...] | None:
    """What the angles are called that `clip` has in place of joints: names, or numbers from 1; None if
    it has joints."""
    names = clip.joint_names[1:]
    if not names or not all(name.startswith(ANGLE) for name in names):
        return None
    return tuple(name.removeprefix(ANGLE) for name in names)


def cycle_transform(clip: Clip) -> CycleTransform:
    """What one cycle adds, from the first frame's root to the last frame's.

    The heading change is the twist about world z of the root's rotation over the cycle, which
    stays well defined for clips that begin lying or crawling.
    """
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    first, last = clip.rotations[0, 0], clip.rotations[-1, 0]
    change = rotations.multiply(last, rotations.conjugate(first))
    turn = rotations.twist_angle(change, up)
    start = rotations.rotate(rotations.from_heading(turn), clip.root_position[0])
    return CycleTransform((clip.root_position[-1] - start)[:2], turn.item())


def sample(clip: Clip, times: Tensor) -> tuple[Tensor, Tensor]:
    """Poses at any times: positions linear, rotations slerp.

    Parameters
    ----------
    clip
        the clip; a looping one continues forever both ways, another is held at its ends.
    times
        (N,) s.

    Returns
    -------
    tuple[Tensor, Tensor]
        root_position (N, 3) and rotations (N, J, 4), float64.
    """
    times = times.to(torch.float64)
    if not clip.loop:
        return _interpolate(clip, times.clamp(0.0, clip.duration))
    cycles = torch.floor(times / clip.duration)
    position, rotation = _interpolate(clip, times - cycles * clip.duration)
    return _carry(cycle_transform(clip), cycles, position, rotation)


def resample(clip: Clip, rate: float) -> Clip:
    """The same motion at evenly spaced frames, as near to ``rate`` frames/s as fits the duration.

    The first and last poses are kept exactly, so a loop still closes.
    """
    steps = max(1, round(clip.duration * rate))
    times = torch.linspace(0.0, clip.duration, steps + 1, dtype=torch.float64)
    position, rotation = _interpolate(clip, times)
    return replace(clip, times=times, root_position=position, rotations=rotation)


def velocities(clip: Clip) -> tuple[Tensor, Tensor]:
    """Velocities at the frames by central differences, across the seam for a looping clip.

    Returns
    -------
    tuple[Tensor, Tensor]
        The root's linear velocity (F, 3) m/s, world, and each joint's angular velocity (F, J, 3)
        rad/s in its parent's frame (the world for the root). At the ends of a clip that does not
        loop the differences are one-sided.
    """
    times, position, rotation = clip.times, clip.root_position, clip.rotations
    if clip.loop:
        transform = cycle_transform(clip)
        back = _carry(transform, -torch.ones(1), position[-2:-1], rotation[-2:-1])
        ahead = _carry(transform, torch.ones(1), position[1:2], rotation[1:2])
        times = torch.cat((times[-2:-1] - times[-1], times, times[-1] + times[1:2]))
    else:
        back, ahead = (position[:1], rotation[:1]), (position[-1:], rotation[-1:])
        times = torch.cat((times[:1], times, times[-1:]))
    position = torch.cat((back[0], position, ahead[0]))
    rotation = torch.cat((back[1], rotation, ahead[1]))
    dt = (times[2:] - times[:-2])[:, None]
    linear = (position[2:] - position[:-2]) / dt
    angular = rotations.angular_velocity(rotation[:-2], rotation[2:], dt[:, None])
    return linear, angular


def _interpolate(clip: Clip, times: Tensor) -> tuple[Tensor, Tensor]:
    """Poses at times (N,) within [0, duration], the last stored frame at the very end."""
    after = torch.searchsorted(clip.times, times, right=True).clamp(1, clip.num_frames - 1)
    before = after - 1
    start, stop = clip.times[before], clip.times[after]
    t = (times - start) / (stop - start)
    position = torch.lerp(clip.root_position[before], clip.root_position[after], t[:, None])
    rotation = rotations.slerp(clip.rotations[before], clip.rotations[after], t[:, None])
    return position, rotation


def _carry(
    transform: CycleTransform, cycles: Tensor, position: Tensor, rotation: Tensor
) -> tuple[Tensor, Tensor]:
    """Move poses (N, 3), (N, J, 4) by ``cycles`` (N,) cycles."""
    displacement, angle = transform.power(cycles.to(torch.float64))
    turn = rotations.from_heading(angle)
    moved = rotations.rotate(turn, position)
    moved = torch.cat((moved[:, :2] + displacement, moved[:, 2:]), dim=-1)
    root = rotations.multiply(turn[:, None], rotation[:, :1])
    return moved, torch.cat((root, rotation[:, 1:]), dim=1)


def align_signs(q: Tensor) -> Tensor:
    """Of q and -q, per frame, the one nearer to the frame before; the first with w >= 0.

    (F, ..., 4) -> (F, ..., 4). Only then may frames be interpolated component by component.
    """
    q = torch.cat((rotations.canonical(q[:1]), q[1:]))
    against = (q[1:] * q[:-1]).sum(dim=-1) < 0.0
    flips = torch.cat((torch.zeros_like(against[:1]), against)).cumsum(dim=0) % 2
    return torch.where(flips[..., None] == 1, -q, q)
