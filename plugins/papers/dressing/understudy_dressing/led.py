"""A person's arms, led without forces in cloth that is simulated on the CPU."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import torch
from scipy.optimize import least_squares

from understudy_cloth.mesh import face_areas
from understudy_dressing.body import Side
from understudy_dressing.moves import APART, TRUNK, Moves
from understudy_dressing.shirt import HOLDERS, ShirtScene
from understudy_dressing.shirt_state import grip_target
from understudy_dressing.state import centre_and_normal, progress
from understudy_dressing.waypoints import DRESSED

#: What the elbow weighs beside the fingertip; m beyond the entrance, where that goes.
_WEIGHT, _BEYOND = 0.7, 0.12


@dataclass(frozen=True)
class Place:
    """Where an arm was on its way."""

    phase: int  #: 0 while the hem comes down, 1 while the hand goes in, 2 while the arm goes out; −1 before, under the hem
    pose: np.ndarray  #: (22,) rad
    cloth: np.ndarray  #: (V, 3) m
    progress: float  #: equation 11
    ratio: float  #: equation 12, the largest of any triangle
    through: bool  #: whether the arm goes through the cloth


class Led(Moves):
    """A shirt on a person whose arm of `side` is led, while the other hand `holds` the hem, or neither does."""

    def __init__(
        self, shirt: ShirtScene, side: Side, pose: np.ndarray, cloth: np.ndarray, holds: bool = True
    ) -> None:
        super().__init__(shirt, pose, cloth)
        self._shirt = shirt
        self._side: Side = side
        self._closed = tuple(holds and holder != side for holder in HOLDERS)
        self._entrance = torch.tensor(shirt.sleeve(side)["entrance"].copy())
        self._patch, self._around = (torch.tensor(one) for one in shirt.hem(side))
        self.mirrored = np.array([1.0, 1.0 if side == "left" else -1.0, 1.0])
        self._mine = self._arm(side)
        self._free = [*range(TRUNK), *self._mine]
        limited = self._body.jnt_limited[self._free].astype(bool)
        ranges = self._body.jnt_range[self._free]
        self._low, self._high = (np.where(limited, ranges[:, k], s * 2.2) for k, s in enumerate((-1, 1)))  # fmt: skip

    def place(self, phase: int) -> Place:
        pose, x = self.found()
        through = self.through(self._side)
        bones, cloth = torch.tensor(self.bones(self._side))[None], torch.tensor(x)[None]
        ratio = (face_areas(x[self._shirt.faces]) / face_areas(self._shirt.corners)).max()
        inside = progress(bones, cloth[:, self._entrance])[1]
        return Place(phase, pose.copy(), x, float(inside), float(ratio), through)

    def lower(self, share: float, begin: np.ndarray, end: np.ndarray) -> None:
        """Trunk and the arm that holds go by a `share` of the way from those of the pose `begin` to those of `end`, (22,) rad."""
        others = [i for i in range(len(begin)) if i not in self._mine]
        self._mix(others, share, begin, end)

    def go(self, end: np.ndarray, share: float, begin: np.ndarray) -> None:
        """By a `share` of the way from the pose `begin` to `end`, (22,) rad."""
        self._mix(list(range(len(begin))), share, begin, end)

    def rest(self, share: float, begin: np.ndarray) -> None:
        """By a `share` of the way from the pose `begin` (22,) rad to the neutral one."""
        self.go(self._neutral, share, begin)

    def spread(self, share: float, begin: np.ndarray) -> None:
        """The arm that goes in goes by a `share` of the way from that of the pose `begin` (22,) rad out to its side."""
        self._mix(self._mine, share, begin, self.bent({self._side: DRESSED}))

    def approach(self, speed: float, to: np.ndarray) -> None:
        """Fingertip and elbow go on by a step of `speed`, m, the elbow of the left arm, or its mirror image, to the place `to`, m."""
        pose, x = self.found()
        self._place(pose)
        bones = self.bones(self._side)
        cloth = torch.tensor(x[self._entrance])[None]
        centre, normal = (one[0].numpy() for one in centre_and_normal(cloth))
        inside = float(progress(torch.tensor(bones)[None], cloth)[1]) > 0
        tip = bones[0] + normal if inside else centre + _BEYOND * normal
        self._draw(
            _towards(bones[0], tip, speed), _towards(bones[3], self.mirrored * to, speed), _WEIGHT
        )

    def grip(self, speed: float) -> float:
        """The fingertip goes on by a step of `speed`, m, to where that hand grips the hem; m, how far away it was."""
        pose, x = self.found()
        self._place(pose)
        bones = self.bones(self._side)
        target = grip_target(torch.from_numpy(x)[None], self._patch, self._around)[0].numpy()
        self._draw(_towards(bones[0], target, speed), bones[3], 0.0)
        return float(np.linalg.norm(target - bones[0]))

    def _draw(self, tip: np.ndarray, elbow: np.ndarray, weight: float) -> None:
        """Trunk and arm go where the fingertip is nearest to `tip` and, by `weight`, the elbow to `elbow`, (3,) m."""
        pose = self._pose.copy()
        begin = pose[self._free].copy()

        def off(hinges: np.ndarray) -> np.ndarray:
            pose[self._free] = hinges
            self._place(pose)
            at = self.bones(self._side)
            mujoco.mj_collision(self._body, self._data)
            near = sum(np.maximum(0.0, APART - self._data.contact.dist).tolist())
            return np.concatenate([at[0] - tip, weight * (at[3] - elbow), 0.03 * (hinges - begin), [3.0 * near]])  # fmt: skip

        inner = np.clip(begin, self._low + 1e-3, self._high - 1e-3)
        pose[self._free] = least_squares(
            off, inner, bounds=(self._low, self._high), diff_step=1e-4, max_nfev=6
        ).x
        self._go(pose)

    def _mix(self, which: list[int], share: float, begin: np.ndarray, end: np.ndarray) -> None:
        pose = self._pose.copy()
        pose[which] = begin[which] + share * share * (3 - 2 * share) * (end - begin)[which]
        self._go(pose)

    def _go(self, pose: np.ndarray) -> None:
        self._pose = pose
        self._step(pose, self._closed)


def _towards(begin: np.ndarray, end: np.ndarray, speed: float) -> np.ndarray:
    way = end - begin
    return begin + way * min(1.0, speed / float(np.linalg.norm(way)))
