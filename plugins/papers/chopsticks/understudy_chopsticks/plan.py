"""Open-and-close motions as plans: where arm, hand and sticks should be, now and ahead.

Two sticks, or tongs, are a gripper of seven degrees of freedom in the palm's frame: the lower one stays, the upper one
turns by an angle φ(t) = φ₀ + A/2 (1 - cos 2πft), where φ₀ is the least of the grip's. The hand's pose follows from φ by the grip's poses, and the arm
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
from understudy_chopsticks.held_grip import Gripping
from understudy_gripping.section import Grips
from understudy_hand.scene import HandScene
from understudy_hand.table import ARM_POSE
from understudy_tensors.limits import check_angle
from understudy_tool_planner.planner import DT

#: How far ahead a policy sees the plan, s: six frames every 0.05 s (section 5.4.2).
AHEAD = tuple(0.05 * k for k in range(1, 7))
#: Of a frame: so near to its time is at its time.
_ON_A_FRAME = 0.01
#: Numbers of the gripper's pose and velocity: the lower stick's, and the angle's.
GRIPPER = 15


def gripping(context: Context, who: str) -> Gripping:
    """The task's, from the config section ``grip``."""
    scene = context.need_scene(HandScene, who)
    grips = context.need_section("grip", Grips, who)
    starts = [one.options for one in context.chosen.get("initial_states", ())]
    arms = [arm for o in starts if isinstance(o, OpenAndClose.Options) for arm in o.arms_in(scene)]
    return context.once("gripping", lambda: Gripping(grips.in_hand(scene), scene, context, arms))


def frame_at(time: Tensor) -> tuple[Tensor, Tensor]:
    """Of plans in frames of 10 ms: the frame (N,) before `time` (N,) s, and which share of the way to the next one has gone; none at
    a frame's own time, whatever that is in float32."""
    at = time / DT
    nearest = at.round()
    on = (at - nearest).abs() < _ON_A_FRAME
    whole = torch.where(on, nearest, at.floor())
    return whole, torch.where(on, 0.0, at - whole).nan_to_num(0.0)


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
        #: rad, (least, greatest) angle by which the sticks close. The thesis gives none; the
        #: release's plans go to 0.12.
        amplitude: tuple[float, float] = (0.12, 0.12)
        #: Hz, (least, greatest) rate of opening and closing, at most 10. The thesis: "several
        #: times" within a second.
        rate: tuple[float, float] = (2.0, 2.0)
        #: rad, added to the standard arm's pose: directions to point to. The thesis has three, without numbers.
        arms: tuple[tuple[float, float, float, float, float, float, float], ...] = (
            (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            (0.0, 0.0, 0.0, 0.0, 0.4, 0.0, 0.0),
            (0.0, 0.0, 0.0, 0.0, 0.0, 0.4, 0.0),
        )

        def __post_init__(self) -> None:
            check_angle(self, "amplitude")
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
