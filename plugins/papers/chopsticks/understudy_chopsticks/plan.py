"""Open-and-close motions as plans: where arm, hand and sticks shall be, now and ahead.

Two sticks, or tongs, are a gripper of seven degrees of freedom in the palm's frame: the lower one stays, the upper one
turns by an angle φ(t) = φ₀ + A/2 (1 - cos 2πft), where φ₀ is the least of the grip's. The hand's pose follows from φ by the grip's poses, and the arm
stands still (thesis, sections 5.5.1 and 5.5.4). N worlds, U hinges of arm and hand; rad, m, s.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, Fields, InitialStates, Shape
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

#: How far ahead a policy sees the plan, s: six frames every 0.05 s (section 5.4.2).
AHEAD = tuple(0.05 * k for k in range(1, 7))
#: Numbers of the gripper's pose and velocity: the lower stick's, and the angle's.
GRIPPER = 15
#: s that a grip is held before it is where episodes begin and what plans refer to.
_SETTLE = 0.5
#: What held grips are like, by scene, pose and targets: training and evaluation ask for the same ones.
_found: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}
_MOST = 256  #: of them are kept


class Gripping:
    """The task's grips in their scene: what plans, starts and targets share. Built once a task.

    C candidates; world i has the grip of number i mod C. One that holds no stick here, with the arm at its own pose or at any
    of `arms`, has no world: it was found in another scene, and at one pose.

    Parameters
    ----------
    arms
        (A, 7) rad: where episodes begin besides.

    Raises
    ------
    ConfigError
        no grip holds the sticks; a job that has begun is left with fewer; one is of another hand than the scene's.
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
        #: How the tool's parts hang together; None of a tool of one part.
        self._gripper = GRIPPERS.get(scene.options.tool)
        # Pressed against the sticks a hand is not quite where it just touches them.
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
        #: Whether the job is one of candidates, so that a world has to say whose it is; one may be left of them.
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
        """P, of the tool: two sticks, two bars, or a handle."""
        return len(self.scene.tool_bodies)

    @property
    def least(self) -> float:
        """rad: the angle at which motions begin."""
        return float(self.grips[0].angles[0])

    def upper(self, lower: Tensor, angle: Tensor) -> Tensor:
        """(…, 7) of the upper part where the lower one is at `lower` (…, 7) and closed by `angle` (…); of a tool of
        one part that one's."""
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
        """(nq,) the same of the first grip, held `along` m further along the lower part."""
        return _settled(self.grips[0], self.scene, arm, 0, along)[0]

    def at(self, table: Tensor, angle: Tensor) -> tuple[Tensor, Tensor]:
        """Of `table` (C, K, H): the values at `angle` (N, …) of each world's own, (N, …, H), and their slopes
        there."""
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
    """(nq,) after some holding at the angle number `row`; (7,) the lower stick in the palm's frame, held `along` m further
    along."""
    if along:
        axis = rotations.rotate(torch.tensor(grip.lower[3:]), torch.eye(3, dtype=torch.float64)[0])
        grip = replace(grip, lower=grip.lower + along * np.array([*axis.tolist(), 0, 0, 0, 0]))
    data = placed(scene, np.asarray(arm), grip.poses[row], grip.upper[row], grip.lower)
    if not grip.holds:  # as it is given, then
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
    """Of the scene as it is simulated, and of these."""
    found = hashlib.sha256(model_digest(scene.model))
    found.update(repr(scene.tool_bodies).encode())
    for array in arrays:
        found.update(array.tobytes())
    return found.digest()


def _hold(
    scene: HandScene, data: mujoco.MjData, grip: Grip, row: int, along: float,
    arm: np.ndarray | tuple[float, ...], targets: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """:func:`_settled` by simulating what is in `data`."""
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


def gripping(context: Context, who: str) -> Gripping:
    """The task's, from the config section ``grip``."""
    scene = context.need_scene(HandScene, who)
    grips = context.need_section("grip", Grips, who)
    starts = [one.options for one in context.chosen.get("initial_states", ())]
    arms = [arm for o in starts if isinstance(o, OpenAndClose.Options) for arm in o.arms_in(scene)]
    return context.once("gripping", lambda: Gripping(grips.in_hand(scene), scene, context, arms))


def angle_at(amplitude: Tensor, rate: Tensor, time: Tensor) -> tuple[Tensor, Tensor]:
    """φ rad and its derivative rad/s at `time`; all (…)."""
    turn = 2.0 * math.pi * rate
    return (
        0.5 * amplitude * (1.0 - torch.cos(turn * time)),
        0.5 * amplitude * turn * torch.sin(turn * time),
    )


#: What plans give; how many hinges there are is not known before there is a hand.
PLANNED: Mapping[str, Shape] = {
    "planned_angle": (),
    "planned_targets": (0,),
    "planned_pose": (0,),
    "planned_velocity": (0,),
    "planned_upper": (7,),
    "planned_lower": (7,),
    "plan_ahead": (len(AHEAD), 0),
}


def planned(hinges: int) -> dict[str, Shape]:
    """:data:`PLANNED`, of a hand on an arm of so many hinges."""
    of_hinges = {f"planned_{name}": (hinges,) for name in ("targets", "pose", "velocity")}
    return {**PLANNED, **of_hinges, "plan_ahead": (len(AHEAD), 2 * hinges + GRIPPER)}


class Plan(Fields):
    """The plan at each world's time.

    - ``planned_angle`` () rad, between the sticks; ``planned_targets`` (U,) rad, of the servos that hold them
      there
    - ``planned_pose``, ``planned_velocity`` (U,): of arm and hand
    - ``planned_upper``, ``planned_lower`` (7,): positions and rotations in the palm's frame
    - ``plan_ahead`` (6, 2 U + 15): of the next 0.3 s every 0.05 s: pose and velocity of arm and hand, then of
      the gripper (lower stick's pose, angle; velocities)
    """

    reads = ("motion_amplitude", "motion_rate", "planned_arm", "episode_time")
    provides: Mapping[str, Shape] = PLANNED

    def __init__(self, options: None, context: Context) -> None:
        self._gripping = gripping(context, "fields 'chopsticks/plan'")
        self.provides = planned(self._gripping.scene.hinges)
        self._ahead = torch.tensor(AHEAD, device=context.device)

    def compute(
        self,
        motion_amplitude: Tensor,
        motion_rate: Tensor,
        planned_arm: Tensor,
        episode_time: Tensor,
    ) -> dict[str, Tensor]:
        made = self._gripping
        angle, _ = angle_at(motion_amplitude, motion_rate, episode_time)
        angle = angle + made.least
        pose, velocity, _ = self._moving(motion_amplitude, motion_rate, planned_arm, episode_time)
        targets, _ = made.at(made.targets, angle)
        lower = made.lower.expand(len(angle), 7)
        upper = made.upper(lower, angle)
        times = episode_time[:, None] + self._ahead
        later = self._moving(
            motion_amplitude[:, None].expand_as(times),
            motion_rate[:, None].expand_as(times),
            planned_arm[:, None].expand(-1, len(AHEAD), -1),
            times,
        )
        return {
            "planned_angle": angle,
            "planned_targets": torch.cat([planned_arm, targets], dim=1),
            "planned_pose": pose,
            "planned_velocity": velocity,
            "planned_upper": upper,
            "planned_lower": lower,
            "plan_ahead": torch.cat(later, dim=-1),
        }

    def _moving(
        self, amplitude: Tensor, rate: Tensor, arm: Tensor, time: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Pose and velocity (…, U) of arm and hand, and the gripper (…, 15)."""
        made = self._gripping
        angle, turning = angle_at(amplitude, rate, time)
        angle = angle + made.least
        hand, slope = made.at(made.poses, angle)
        lower = made.lower.view(-1, *[1] * (angle.dim() - 1), 7).expand(*angle.shape, 7)
        still = torch.zeros_like(lower[..., :6])
        gripper = torch.cat([lower, angle[..., None], still, turning[..., None]], dim=-1)
        return (
            torch.cat([arm, hand], dim=-1),
            torch.cat([torch.zeros_like(arm), slope * turning[..., None]], dim=-1),
            gripper,
        )


class OpenAndClose(InitialStates):
    """Holding the sticks in parallel; each episode has a motion, and a direction in which they point.

    ``motion_amplitude`` () rad and ``motion_rate`` () Hz are drawn uniformly, ``planned_arm`` (7,) rad is one of
    `arms`. Where several grips share the job, ``from_NAME`` () is 1 in the worlds of that one.
    """

    varies = ()

    @dataclass(frozen=True)
    class Options:
        #: rad: how far the sticks close. The thesis gives none; the release's plans go to 0.12.
        amplitude: tuple[float, float] = (0.12, 0.12)
        #: Hz, at most 10, of opening and closing. The thesis: "several times" within a second.
        rate: tuple[float, float] = (2.0, 2.0)
        #: rad, added to the standard arm's pose: directions to point to. The thesis has three, without numbers.
        arms: tuple[tuple[float, float, float, float, float, float, float], ...] = (
            (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            (0.0, 0.0, 0.0, 0.0, 0.4, 0.0, 0.0),
            (0.0, 0.0, 0.0, 0.0, 0.0, 0.4, 0.0),
        )

        def __post_init__(self) -> None:
            check_range(self, "amplitude", most=100)
            for name in ("amplitude", "rate"):
                low, high = getattr(self, name)
                if not 0 <= low <= high:
                    raise ValueError(
                        f"{name}={[low, high]} is not possible: the first is the lower one, and at least 0."
                    )
            if not self.arms:
                raise ValueError("arms=[] is not possible: give at least one.")
            check_range(self, "rate", most=10)

        def arms_in(self, scene: HandScene) -> np.ndarray:
            """(A, 7) rad: the arm's poses. Raises ConfigError where one is beyond its range."""
            arms = np.array(ARM_POSE) + np.array(self.arms)
            low, high = scene.model.jnt_range[: len(ARM_POSE)].T
            if ((arms < low) | (arms > high)).any():
                raise ConfigError(
                    "initial_states.arms is not possible: an angle is beyond the arm's range. Give less."
                )
            return arms

    def __init__(self, options: Options, context: Context) -> None:
        made = gripping(context, "initial_states 'chopsticks/open_and_close'")
        self._options, model = options, made.scene.model
        if made.parts < 2:
            raise ConfigError(
                "initial_states 'chopsticks/open_and_close' needs a tool that opens. Set scene.tool=sticks or tongs."
            )
        most = round(float(made.angles[-1]) - made.least, 6)
        if options.amplitude[1] > most:
            raise ConfigError(
                f"initial_states.amplitude={list(options.amplitude)} is not possible: the grip closes by "
                f"{most:g} rad. Give less, or another grip."
            )
        device, arms = context.device, options.arms_in(made.scene)
        self._arms = torch.tensor(arms, dtype=torch.float32, device=device)
        starts = np.array([made.begin(arm) for arm in arms])
        #: (A, C, nq)
        self._starts = torch.tensor(starts, dtype=torch.float32, device=device)
        self._velocity = torch.zeros(model.nv, device=device)
        self._groups = made.groups
        self.episode_fields = {
            "motion_amplitude": (),
            "motion_rate": (),
            "planned_arm": (len(ARM_POSE),),
            **(made.groups.fields if made.several else {}),
        }
        self._flags = made.groups.flags() if made.several else {}

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        drawn = streams.uniform(3)
        row = (drawn[:, 0] * len(self._arms)).long()
        (a, b), (c, d) = self._options.amplitude, self._options.rate
        return {
            "qpos": self._starts[row, self._groups.number],
            "qvel": self._velocity.expand(len(drawn), -1),
            "motion_amplitude": a + (b - a) * drawn[:, 1],
            "motion_rate": c + (d - c) * drawn[:, 2],
            "planned_arm": self._arms[row],
            **self._flags,
        }
