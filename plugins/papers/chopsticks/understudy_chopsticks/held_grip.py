"""Grips of a task as they hold the tool: poses and targets of the hand at each angle, settled by simulation.

N worlds; rad, m, s.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.task import Context
from understudy_gripping.grip import Grip
from understudy_gripping.hold import hold, placed
from understudy_gripping.section import Grips
from understudy_gripping.styles import written
from understudy_hand.scene import HandScene
from understudy_hand.table import ARM_POSE
from understudy_hand.tools import GRIPPERS, upper_pose
from understudy_mujoco.scene import model_digest
from understudy_tensors import rotations
from understudy_tensors.groups import Groups

#: s that a grip is held in simulation before it is taken for starts and plans.
_SETTLE = 0.5
#: Results of holding, by scene, pose and targets: training and evaluation ask for the same ones.
_found: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}
_MOST = 256  #: how many are kept


class Gripping:
    """The task's grips in their scene, which plans, starts and targets share. Built once per task.

    C candidates; world i has grip number i mod C. A candidate that does not hold the sticks here, with the arm at its own pose
    or at any of `arms`, gets no world: it was found in another scene, at one pose.

    Parameters
    ----------
    arms
        (A, 7) rad: other poses at which episodes begin.

    Raises
    ------
    ConfigError
        no grip holds the sticks; fewer do than when the job began; or one is of another hand than the scene's.
    """

    def __init__(
        self, grips: Grips, scene: HandScene, context: Context, arms: Sequence[np.ndarray] = ()
    ) -> None:
        first, device = next(iter(grips.by_name.values())), context.device
        for name, grip in grips.by_name.items():
            grip.need(scene)
            if not np.array_equal(grip.angles, first.angles):
                raise ConfigError(
                    f"grip.candidates.{name} is solved at other angles than the first one. Find both by style."
                )
        #: How the tool's parts are joined; None for a tool of one part.
        self._gripper = GRIPPERS.get(scene.options.tool)
        # A hand that presses against the sticks is not quite where it only touches them.
        settled, against = list[list[tuple[np.ndarray, np.ndarray]]](), dict[str, str]()
        for name, grip in grips.by_name.items():
            try:
                rows = [_settled(grip, scene, ARM_POSE, row) for row in range(len(grip.angles))]
                for arm in arms:
                    _settled(grip, scene, arm, 0)
            except ConfigError as error:
                against[name] = str(error)
            else:
                settled.append(rows)
        grips.leave_out(against)
        grips.begun = True
        self.names, self.scene = tuple(grips.by_name), scene
        self.grips = list(grips.by_name.values())
        self.groups = Groups(self.names, context, tuple(grips.against))
        #: Whether the job compares candidates, so that each world has its own; possibly only one of them is left.
        self.several = grips.are_candidates
        poses = np.array([[q[len(ARM_POSE) : scene.hinges] for q, _ in rows] for rows in settled])
        self.angles = torch.tensor(first.angles, dtype=torch.float32, device=device)
        #: (C, K, H) rad: the hand's poses, and targets of its servos, at the angles.
        self.poses = torch.tensor(poses, dtype=torch.float32, device=device)
        targets = np.array([grip.targets for grip in self.grips])
        self.targets = torch.tensor(targets, dtype=torch.float32, device=device)
        #: (N, 7) the lower stick in the palm's frame, and (N, H) the targets that hold the sticks in parallel.
        self.lower = self.of_worlds(np.array([rows[0][1] for rows in settled]))
        self.parallel = self.of_worlds(targets[:, 0])

    def of_worlds(self, rows: Any) -> Tensor:
        """(N, …) float32 of `rows` (C, …); of one grip (1, …), which is that of all worlds."""
        if len(self.grips) > 1:
            return self.groups.of_worlds(rows)
        return torch.as_tensor(rows, dtype=torch.float32).to(self.angles.device)

    @property
    def parts(self) -> int:
        """P, the number of the tool's parts: two sticks, two bars, or a handle."""
        return len(self.scene.tool_bodies)

    @property
    def least(self) -> float:
        """rad: the angle at which motions begin."""
        return float(self.grips[0].angles[0])

    def upper(self, lower: Tensor, angle: Tensor) -> Tensor:
        """(…, 7) the upper part's pose, when the lower one is at `lower` (…, 7) and they are closed by `angle` (…); for
        a tool of one part, that one's."""
        if self._gripper is None:
            return lower
        return torch.cat(upper_pose(lower[..., :3], lower[..., 3:], angle, self._gripper), dim=-1)

    @property
    def touching(self) -> tuple[str, ...]:
        """The fingers that touch the tool in any of the grips."""
        names = self.scene.measures.names
        return tuple(n for n in names if any(n in grip.touching for grip in self.grips))

    def begin(self, arm: np.ndarray) -> np.ndarray:
        """(C, nq) with the arm at `arm` (7,) rad and the sticks at the first of the angles."""
        return np.array([_settled(grip, self.scene, arm, 0)[0] for grip in self.grips])

    def further(self, arm: np.ndarray, along: float) -> np.ndarray:
        """(nq,) the same for the first grip, with the tool held `along` m further along its lower part."""
        return _settled(self.grips[0], self.scene, arm, 0, along)[0]

    def at(self, table: Tensor, angle: Tensor) -> tuple[Tensor, Tensor]:
        """For each world, the values (N, …, H) of its own row of `table` (C, K, H) at `angle` (N, …), and their
        slopes there."""
        row = torch.bucketize(angle.contiguous(), self.angles[1:-1])
        low, high = self.angles[row], self.angles[row + 1]
        if len(self.grips) == 1:
            first, second = table[0, row], table[0, row + 1]
        else:
            own = self.groups.number.view(-1, *[1] * (angle.dim() - 1)).expand_as(angle)
            first, second = table[own, row], table[own, row + 1]
        slope = (second - first) / (high - low)[..., None]
        return first + slope * (angle - low)[..., None], slope


def _settled(
    grip: Grip,
    scene: HandScene,
    arm: np.ndarray | tuple[float, ...],
    row: int,
    along: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """After holding for a while at the angle number `row`: ``qpos`` (nq,), and the lower stick's pose (7,) in the palm's frame,
    held `along` m further along."""
    if along:
        axis = rotations.rotate(torch.tensor(grip.lower[3:]), torch.eye(3, dtype=torch.float64)[0])
        grip = replace(grip, lower=grip.lower + along * np.array([*axis.tolist(), 0, 0, 0, 0]))
    data = placed(scene, np.asarray(arm), grip.poses[row], grip.upper[row], grip.lower)
    if not grip.holds:  # taken as it is given
        return data.qpos.copy(), grip.lower
    targets = np.array([*arm, *grip.targets[row]])
    key = _digest(scene, data.qpos, targets)
    if key not in _found:
        if len(_found) >= _MOST:
            _found.clear()
        _found[key] = _hold(scene, data, grip, row, along, arm, targets)
    qpos, lower = _found[key]
    return qpos.copy(), lower.copy()


def _digest(scene: HandScene, *arrays: np.ndarray) -> bytes:
    """A digest of the scene, as it is simulated, and of these arrays."""
    found = hashlib.sha256(model_digest(scene.model))
    found.update(repr(scene.tool_bodies).encode())
    for array in arrays:
        found.update(array.tobytes())
    return found.digest()


def _hold(
    scene: HandScene, data: mujoco.MjData, grip: Grip, row: int, along: float,
    arm: np.ndarray | tuple[float, ...], targets: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """:func:`_settled`, by simulating from the state in `data`."""
    held = hold(scene, data, targets, _SETTLE, 0.5 * _SETTLE)
    if held.fell is not None:
        further = f" {1e3 * along:g} mm further along" if along else ""
        raise ConfigError(
            f"The grip {written(grip.style)} does not hold the {scene.options.tool}{further} with the arm at {np.round(arm, 3).tolist()} rad at an "
            f"angle of {grip.angles[row]:g} rad: a part falls after {held.fell:.2f} s. Choose another "
            "grip (grip.file), arm (initial_states.arms) or contact (scene.contact)."
        )
    palm, stick = data.body("palm"), data.body(scene.tool_bodies[-1])
    turn = torch.tensor(palm.xmat.reshape(3, 3))
    place = turn.T @ torch.tensor(stick.xpos - palm.xpos)
    rotation = rotations.multiply(
        rotations.conjugate(torch.tensor(palm.xquat)), torch.tensor(stick.xquat)
    )
    return held.qpos, torch.cat([place, rotation]).numpy()
