"""What can be measured of a clip on a character: heights, contacts, sliding, what it asks of physics.

F frames, J joints, P points on the character's surface. World frame, SI.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np
import torch
from torch import Tensor

from understudy_characters.character import Character
from understudy_characters.contacts import feet
from understudy_characters.shapes import surface_points
from understudy_doctor.dynamics import Effort, Support, effort, support
from understudy_doctor.findings import intervals
from understudy_motion.clip import Clip, velocities
from understudy_motion.editing import evenly_spaced
from understudy_motion.kinematics import forward_kinematics
from understudy_tensors import rotations

GRAVITY = 9.81
"""m/s²."""
GROUND = 0.01
"""m: what motion capture is good for, in height."""
CONTACT_HEIGHT = 0.03
"""m above the ground below which a joint's lowest point may be in contact: what motion capture leaves
of a foot's height in stance, and less than a foot's rise in swing."""
CONTACT_SPEED = 0.5
"""m/s along the ground below which such a point counts as standing: feet in swing pass the ground at
over 2 m/s, and even badly sliding ones in stance at under this."""
BALLISTIC = 0.5
"""Share of the character's weight: a body whose centre of mass needs less support than this from the
ground can be in flight. In flight it needs none; standing, all; the estimate is good to about 0.2."""
OFF_CENTRE = 0.1
"""m by which a centre of mass may be off where the body's proportions are not quite the clip's. Turning
at ω, what is off by r seems to be pushed at ω² r, which is no support."""
SHORTEST_FLIGHT = 0.1
"""s."""
SHORTEST_CONTACT = 0.05
"""s. Gaps and touches shorter than this are noise: the shortest contacts, a sprinter's, take 0.08."""

_LOW = 0.015  # m above its joint's lowest point: points that share its contact


@dataclass(frozen=True)
class Contact:
    """A stretch of frames in which a joint touches the ground."""

    joint: int
    first: int
    last: int


class Measurements:
    """Everything is computed when first asked for.

    Parameters
    ----------
    clip
        has the character's joints; looping if it closes.
    character
        moves as the clip says, as far as its joints can.
    slower
        how many times as long as the motion asked about the clip takes.
    level
        m above z = 0 of the floor, where that is known, as of what physics played; else it is estimated.
    """

    def __init__(
        self, clip: Clip, character: Character, slower: float = 1.0, level: float | None = None
    ) -> None:
        self.character, self._level = character, level
        self.clip = evenly_spaced(clip)
        self.times = self.clip.times.numpy() / slower  #: of the motion asked about
        self.dt = self.clip.duration / (self.clip.num_frames - 1)

    @cached_property
    def qpos(self) -> Tensor:
        """(F, nq)."""
        return self.character.qpos(self.clip)

    @cached_property
    def figure(self) -> Clip:
        """The clip as the character makes it: its joints, in its order, with its skeleton."""
        clip = self.clip
        made = self.character.clip(self.qpos, clip.times, name=clip.name, loop=clip.loop)
        return replace(clip, rotations=made.rotations, joint_names=made.joint_names,
                       skeleton=made.skeleton)  # fmt: skip

    @cached_property
    def kinematics(self) -> tuple[Tensor, Tensor]:
        """World positions (F, J, 3) and rotations (F, J, 4) of the joints."""
        return forward_kinematics(self.figure)

    @cached_property
    def heights(self) -> np.ndarray:
        """(F, J) m: the lowest point of each joint above z = 0; infinite where it carries nothing."""
        return self.character.clearance(self.qpos).numpy()

    @cached_property
    def feet(self) -> tuple[int, ...]:
        """Rows of the joints that meet the ground first in the zero pose."""
        return tuple(self.character.joint_names.index(name) for name in feet(self.character))

    @cached_property
    def effort(self) -> Effort:
        """What the motion asks of the whole body, before the ground's share."""
        return effort(self.character, self.figure)

    @cached_property
    def supported(self) -> np.ndarray:
        """(F,) bool: frames in which the centre of mass falls too slowly to be in flight, the more so
        the faster the trunk turns over."""
        spin = velocities(self.figure)[1][:, 0, :2].square().sum(-1).numpy()
        return self.effort.lift > BALLISTIC + OFF_CENTRE * spin / GRAVITY

    @cached_property
    def flights(self) -> list[tuple[int, int]]:
        """(first, last) frames of the stretches in which nothing touches the ground and the body falls."""
        least = max(3, round(SHORTEST_FLIGHT / self.dt))
        return intervals(~self.supported & ~self.touching.any(1), least=least)

    @cached_property
    def centre(self) -> np.ndarray:
        """(F, 3) m: the centre of mass."""
        model, data = self.character.model, mujoco.MjData(self.character.model)
        result = np.zeros((len(self.qpos), 3))
        pose, centre = data.qpos, data.subtree_com[self.character.root]
        for row, qpos in zip(result, self.qpos.numpy(), strict=True):
            pose[:] = qpos
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            row[:] = centre
        return result

    @cached_property
    def ground(self) -> float:
        """m: the height above z = 0 of the floor that the clip stands on; 0 if it is nearly that."""
        if self._level is not None:
            return self._level
        lowest = self.heights.min(1)
        standing = lowest[self.supported]
        level = float(np.median(standing)) if len(standing) else float(lowest.min())
        return level if abs(level) > GROUND else 0.0

    # ------------------------------------------------------------------ contacts

    @cached_property
    def low(self) -> np.ndarray:
        """(J,) bool: the feet, and what else ever comes near enough to the ground to touch it."""
        low = np.any(self.heights - self.ground < CONTACT_HEIGHT, axis=0)
        return low | np.isin(np.arange(low.size), self.feet)

    @cached_property
    def surface(self) -> tuple[np.ndarray, Tensor]:
        """Points spread over the geoms of each :attr:`low` joint: whose they are (P,), in order, and where,
        (F, P, 3)."""
        owners, points = surface_points(self.character)
        low = self.low[owners]
        owners, points = owners[low], points[torch.from_numpy(low)]
        positions, world = self.kinematics
        where = positions[:, owners] + rotations.rotate(world[:, owners], points)
        return owners, where

    @cached_property
    def slides(self) -> np.ndarray:
        """(F - 1, J, 2) m: how far each :attr:`low` joint's lowest points move along the ground from frame
        to frame: of those low in both frames the one that moves least, or the middle of them all, so that
        a foot which rolls or pivots does not slide."""
        owners, points = self.surface
        height = points[..., 2].numpy()
        moves = points[..., :2].diff(dim=0).numpy()
        result = np.zeros((len(moves), len(self.character.joints), 2))
        edges = np.searchsorted(owners, np.arange(len(self.character.joints) + 1))
        for joint in np.unique(owners):
            own = slice(edges[joint], edges[joint + 1])
            low = height[:, own] <= height[:, own].min(1, keepdims=True) + _LOW
            both = low[:-1] & low[1:]
            # A rolling body has no point that is lowest in both frames.
            both = np.where(both.any(1, keepdims=True), both, low[1:])
            step = moves[:, own]
            middle = (step * both[..., None]).sum(1) / both.sum(1)[:, None]
            length = np.where(both, np.linalg.norm(step, axis=-1), np.inf)
            least = step[np.arange(len(step)), length.argmin(1)]
            pick = np.linalg.norm(middle, axis=-1) < np.linalg.norm(least, axis=-1)
            result[:, joint] = np.where(pick[:, None], middle, least)
        return result

    @cached_property
    def touching(self) -> np.ndarray:
        """(F, J) bool: which joints are on the ground.

        Near it and slow; or near it, and the slowest there, while nothing slow
        carries the body: that slides.
        """
        near = self.heights - self.ground < CONTACT_HEIGHT
        step = np.linalg.norm(self.slides, axis=-1) / self.dt
        first, last = step[:1], step[-1:]
        speed = np.minimum(np.concatenate([first, step]), np.concatenate([step, last]))
        touching = near & (speed < CONTACT_SPEED)
        carried = self.supported & ~touching.any(1)
        slowest = np.where(near, speed, np.inf).argmin(1)
        rows = np.flatnonzero(carried & near.any(1))
        touching[rows, slowest[rows]] = True
        least = int(np.clip(round(SHORTEST_CONTACT / self.dt), 1, len(self.times)))
        result = np.zeros_like(touching)
        for joint in range(touching.shape[1]):
            for first, last in intervals(touching[:, joint], close=least - 1, least=least):
                result[first : last + 1, joint] = True
        return result

    @cached_property
    def contacts(self) -> list[Contact]:
        """All stretches of contact, joint by joint."""
        return [
            Contact(joint, first, last)
            for joint in range(self.touching.shape[1])
            for first, last in intervals(self.touching[:, joint])
        ]

    # ------------------------------------------------------------------ dynamics

    @cached_property
    def support(self) -> Support:
        """How the ground carries the motion: through the low points of the joints in contact."""
        owners, points = self.surface
        height = points[..., 2].numpy()
        lowest = np.where(np.isfinite(self.heights), self.heights, 0.0)[:, owners]
        bearing = self.touching[:, owners] & (height <= lowest + _LOW)
        return support(self.character, self.effort, owners, points.numpy(), bearing)
