"""Open-and-close motions as plans: where arm, hand and sticks shall be, now and ahead.

The sticks are a gripper of seven degrees of freedom in the palm's frame: the lower one stays, the upper one
turns by an angle φ(t) = A/2 (1 - cos 2πft). The hand's pose follows from φ by the grip's poses, and the arm
stands still (thesis, sections 5.5.1 and 5.5.4). N worlds, U hinges of arm and hand; rad, m, s.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, Fields, InitialStates, Shape
from understudy_gripping.grip import Grip
from understudy_gripping.hold import hold, placed
from understudy_hand.scene import HandScene
from understudy_hand.table import ARM_POSE
from understudy_hand.tools import upper_pose
from understudy_tensors import rotations

#: How far ahead a policy sees the plan, s: six frames every 0.05 s (section 5.4.2).
AHEAD = tuple(0.05 * k for k in range(1, 7))
#: Numbers of the gripper's pose and velocity: the lower stick's, and the angle's.
GRIPPER = 15
#: s that a grip is held before it is where episodes begin and what plans refer to.
_SETTLE = 0.5


class Gripping:
    """The task's grip in its scene: what plans, starts and targets share. Built once a task."""

    def __init__(self, grip: Grip, scene: HandScene, device: torch.device) -> None:
        grip.need(scene)
        self.grip, self.scene = grip, scene
        # Pressed against the sticks a hand is not quite where it just touches them.
        settled = [self._settled(ARM_POSE, row) for row in range(len(grip.angles))]
        poses = np.array([qpos[len(ARM_POSE) : scene.hinges] for qpos, _ in settled])
        self.angles = torch.tensor(grip.angles, dtype=torch.float32, device=device)
        #: (K, H) rad: the hand's poses, and targets of its servos, at the angles.
        self.poses = torch.tensor(poses, dtype=torch.float32, device=device)
        self.targets = torch.tensor(grip.targets, dtype=torch.float32, device=device)
        #: (7,) the lower stick in the palm's frame.
        self.lower = torch.tensor(settled[0][1], dtype=torch.float32, device=device)

    def begin(self, arm: np.ndarray) -> np.ndarray:
        """(nq,) with the arm at `arm` (7,) rad and the sticks at the first of the angles."""
        return self._settled(arm, 0)[0]

    def _settled(
        self, arm: np.ndarray | tuple[float, ...], row: int
    ) -> tuple[np.ndarray, np.ndarray]:
        grip, scene = self.grip, self.scene
        data = placed(scene, np.asarray(arm), grip.poses[row], grip.upper[row], grip.lower)
        held = hold(scene, data, np.array([*arm, *grip.targets[row]]), _SETTLE, 0.5 * _SETTLE)
        if held.fell is not None:
            raise ConfigError(
                f"The grip does not hold the sticks with the arm at {np.round(arm, 3).tolist()} rad at an "
                f"angle of {grip.angles[row]:g} rad: one falls after {held.fell:.2f} s. Choose another "
                "grip (grip.file), arm (initial_states.arms) or contact (scene.contact)."
            )
        palm, stick = data.body("palm"), data.body(scene.tool_bodies[1])
        turn = torch.tensor(palm.xmat.reshape(3, 3))
        place = turn.T @ torch.tensor(stick.xpos - palm.xpos)
        rotation = rotations.multiply(
            rotations.conjugate(torch.tensor(palm.xquat)), torch.tensor(stick.xquat)
        )
        return held.qpos, torch.cat([place, rotation]).numpy()

    def at(self, table: Tensor, angle: Tensor) -> tuple[Tensor, Tensor]:
        """Of `table` (K, H) by angle: the values at `angle` (…), (…, H), and their slopes there."""
        row = torch.bucketize(angle, self.angles[1:-1])
        low, high = self.angles[row], self.angles[row + 1]
        first, second = table[row], table[row + 1]
        slope = (second - first) / (high - low)[..., None]
        return first + slope * (angle - low)[..., None], slope


def gripping(context: Context, who: str) -> Gripping:
    """The task's, from the config section ``grip``."""
    scene = context.need_scene(HandScene, who)
    grip = context.need_section("grip", Grip, who)
    return context.once("gripping", lambda: Gripping(grip, scene, context.device))


def angle_at(amplitude: Tensor, rate: Tensor, time: Tensor) -> tuple[Tensor, Tensor]:
    """φ rad and its derivative rad/s at `time`; all (…)."""
    turn = 2.0 * math.pi * rate
    return (
        0.5 * amplitude * (1.0 - torch.cos(turn * time)),
        0.5 * amplitude * turn * torch.sin(turn * time),
    )


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
    provides: Mapping[str, Shape] = {
        "planned_angle": (),
        "planned_targets": (0,),
        "planned_pose": (0,),
        "planned_velocity": (0,),
        "planned_upper": (7,),
        "planned_lower": (7,),
        "plan_ahead": (len(AHEAD), 0),
    }

    def __init__(self, options: None, context: Context) -> None:
        self._gripping = gripping(context, "fields 'chopsticks/plan'")
        hinges = self._gripping.scene.hinges
        self.provides = {
            **self.provides,
            **{f"planned_{name}": (hinges,) for name in ("targets", "pose", "velocity")},
            "plan_ahead": (len(AHEAD), 2 * hinges + GRIPPER),
        }
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
        pose, velocity, _ = self._moving(motion_amplitude, motion_rate, planned_arm, episode_time)
        targets, _ = made.at(made.targets, angle)
        lower = made.lower.expand(len(angle), 7)
        upper = torch.cat(upper_pose(lower[:, :3], lower[:, 3:], angle), dim=1)
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
        hand, slope = made.at(made.poses, angle)
        lower = made.lower.expand(*angle.shape, 7)
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
    `arms`.
    """

    varies = ()

    @dataclass(frozen=True)
    class Options:
        #: rad: how far the sticks close. The thesis gives none; the release's plans go to 0.12.
        amplitude: tuple[float, float] = (0.12, 0.12)
        rate: tuple[float, float] = (2.0, 2.0)  #: Hz; "several times" within a second
        #: rad, added to the standard arm's pose: directions to point to. The thesis has three, without numbers.
        arms: tuple[tuple[float, float, float, float, float, float, float], ...] = (
            (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            (0.0, 0.0, 0.0, 0.0, 0.4, 0.0, 0.0),
            (0.0, 0.0, 0.0, 0.0, 0.0, 0.4, 0.0),
        )

        def __post_init__(self) -> None:
            for name in ("amplitude", "rate"):
                low, high = getattr(self, name)
                if not 0 <= low <= high:
                    raise ValueError(
                        f"{name}={[low, high]} is not possible: the first is the lower one, and at least 0."
                    )
            if not self.arms:
                raise ValueError("arms=[] is not possible: give at least one.")
            check_range(self)

    def __init__(self, options: Options, context: Context) -> None:
        made = gripping(context, "initial_states 'chopsticks/open_and_close'")
        self._options, model = options, made.scene.model
        most = float(made.grip.angles[-1])
        if options.amplitude[1] > most:
            raise ConfigError(
                f"initial_states.amplitude={list(options.amplitude)} is not possible: the grip closes to "
                f"{most:g} rad. Give less, or another grip."
            )
        arms = np.array(ARM_POSE) + np.array(options.arms)
        low, high = model.jnt_range[: len(ARM_POSE)].T
        if ((arms < low) | (arms > high)).any():
            raise ConfigError(
                "initial_states.arms is not possible: an angle is beyond the arm's range. Give less."
            )
        device = context.device
        self._arms = torch.tensor(arms, dtype=torch.float32, device=device)
        starts = np.array([made.begin(arm) for arm in arms])
        self._starts = torch.tensor(starts, dtype=torch.float32, device=device)
        self._velocity = torch.zeros(model.nv, device=device)
        self.episode_fields = {
            "motion_amplitude": (),
            "motion_rate": (),
            "planned_arm": (len(ARM_POSE),),
        }

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        drawn = streams.uniform(3)
        row = (drawn[:, 0] * len(self._arms)).long()
        (a, b), (c, d) = self._options.amplitude, self._options.rate
        return {
            "qpos": self._starts[row],
            "qvel": self._velocity.expand(len(drawn), -1),
            "motion_amplitude": a + (b - a) * drawn[:, 1],
            "motion_rate": c + (d - c) * drawn[:, 2],
            "planned_arm": self._arms[row],
        }
