"""Where arm, hand, sticks and the object should be, by the plan that each of N worlds follows (thesis, sections 5.4.2 and 5.6).

U hinges; m, rad, s.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from understudy.options import check_range
from understudy.task import Context, Fields, Shape
from understudy_chopsticks.plan import AHEAD, PLANNED, frame_at, planned
from understudy_chopsticks.plan_bank import HELD, LAST, LEG, OBJECT, SLOWING, bank_of
from understudy_hand.table import ARM_POSE
from understudy_tensors import rotations
from understudy_tool_planner import objects
from understudy_tool_planner.planner import DT

#: s: what is nearer in time is at once.
_SOON = 1e-4


class Follow(Fields):
    """The plan that each world follows, at its time: what ``chopsticks/plan`` gives, and the object.

    - ``plan_time`` () s, since the plan began, and ``plan_lasts`` () s, how long it is
    - ``planned_object`` (7,): where the object should be, in the world; ``planned_held`` () 1 while the sticks hold it
    - ``planned_goal`` (3,) m, of the relocation that is on; ``planned_leg`` () its number, from 0; ``leg_over`` () 1
      in its last frame
    - ``object_shape`` (6,): 1 for its kind of sphere, capsule and box, and half of its extent along each of its axes, m
    - ``object_ahead`` (6, 7): where it should be every 0.05 s of the next 0.3 s, in the frame of the palm as it is
    """

    reads = (
        "followed", "plan_since", "plan_stopped", "stopped_since", "leg_begun", "episode_time", "xpos", "xquat",
    )  # fmt: skip
    provides: Mapping[str, Shape] = {
        **PLANNED,
        "plan_time": (),
        "plan_lasts": (),
        "planned_object": (7,),
        "planned_held": (),
        "planned_goal": (3,),
        "planned_leg": (),
        "leg_over": (),
        "object_shape": (2 * len(objects.KINDS),),
        "object_ahead": (len(AHEAD), 7),
    }

    @dataclass(frozen=True)
    class Options:
        #: rad that the sticks' targets close further while they hold the object, so that they press on it: by
        #: friction sticks close a good half of what their targets do
        squeeze: float = 0.12
        #: s by which the arm's targets go ahead of the plan at its speed; null is the servos' own lag, kd / kp
        lead: float | None = None
        #: Whether arm, hand and sticks have a plan; without one they stay as they begin, and only where the object should
        #: be in the end is known (figure 5.22)
        planner: bool = True

        def __post_init__(self) -> None:
            check_range(self, "squeeze", least=0, most=0.2)
            check_range(self, "lead", least=0, most=1.0)

    def __init__(self, options: Options, context: Context) -> None:
        self._gripping, self._bank = bank_of(context, "fields 'chopsticks/follow'")
        hinges = self._gripping.scene.hinges
        self.provides = {**self.provides, **planned(hinges)}
        self._plans = options.planner
        axis = torch.tensor([1.0, 0.0, 0.0], device=context.device)
        self._axis = rotations.rotate(
            self._gripping.lower[:, 3:], axis.expand(len(self._gripping.lower), 3)
        )
        self._squeeze = options.squeeze
        model, arm = self._gripping.scene.model, len(ARM_POSE)
        # A servo whose velocity target is 0 lags by kd / kp: 25 mm at 0.25 m/s. The release's have the plan's.
        lag = -model.actuator_biasprm[:arm, 2] / model.actuator_gainprm[:arm, 0]
        lead = lag if options.lead is None else np.full(arm, options.lead)
        self._lead = torch.tensor(lead, dtype=torch.float32, device=context.device)
        steps = [round(t / DT) for t in AHEAD]
        self._steps = torch.tensor([0, *steps], device=context.device)
        self._palm = self._gripping.scene.model.body("palm").id
        self._period = context.control_dt
        #: Frames before the one that a control period ends in, as many as it may have come to.
        self._passed = torch.arange(
            max(1, math.ceil(context.control_dt / DT - _SOON)), device=context.device
        )

    def compute(
        self,
        followed: Tensor,
        plan_since: Tensor,
        plan_stopped: Tensor,
        stopped_since: Tensor,
        leg_begun: Tensor,
        episode_time: Tensor,
        xpos: Tensor,
        xquat: Tensor,
    ) -> dict[str, Tensor]:
        made, goes = self._gripping, plan_stopped < 0
        # Sticks that stopped at once would be thrown out of the hand.
        rate = torch.exp((stopped_since - episode_time) / SLOWING)
        rate = torch.where(goes, 1.0, rate)
        time = torch.where(goes, episode_time - plan_since, plan_stopped + SLOWING * (1.0 - rate))
        row = followed.long().clamp(0, len(self._bank.goals) - 1)  # a number that went wrong
        whole, gone = frame_at(time)
        whole = torch.where(goes, whole, (time / DT).floor())
        share = torch.where(goes, gone, time / DT - whole)[:, None]
        frame = whole.long()[:, None] + goes[:, None] * self._steps
        here, after = self._bank.at(row, frame), self._bank.at(row, frame + 1)
        if not self._plans:
            here = after = self._unplanned(row, here)
        turning = rate[:, None] * (after[..., 7] - here[..., 7]) / DT
        speed = rate[:, None, None] * (after[..., :7] - here[..., :7]) / DT
        arm = here[..., :7] + share[..., None] * (after[..., :7] - here[..., :7])
        angle = here[..., 7] + share * (after[..., 7] - here[..., 7])
        hand, slope = made.at(made.poses, angle)
        pose = torch.cat([arm, hand], dim=-1)
        velocity = torch.cat([speed, slope * turning[..., None]], dim=-1)
        lower, away = made.lower.expand(*angle.shape, 7), self._bank.shifts[row, None, None]
        lower = torch.cat([lower[..., :3] + away * self._axis, lower[..., 3:]], dim=-1)
        still = torch.zeros_like(lower[..., :6])
        gripper = torch.cat([lower, angle[..., None], still, turning[..., None]], dim=-1)
        held, now = here[:, 0, HELD] * goes, lower[:, 0]
        targets, _ = made.at(made.targets, angle[:, 0] + self._squeeze * held)
        palm, turn = xpos[:, self._palm, None], xquat[:, self._palm, None]
        thing = _between(here[..., OBJECT], after[..., OBJECT], torch.where(goes, gone, 0.0))
        judged = self._judged(row, whole, time)
        # As it slows down it may come to frames of the next relocation, which has not begun.
        leg = torch.where(goes, judged[:, LEG], leg_begun)
        return {
            "planned_angle": angle[:, 0],
            "planned_targets": torch.cat(
                [arm[:, 0] + self._lead * velocity[:, 0, : len(ARM_POSE)], targets], dim=1
            ),
            "planned_pose": pose[:, 0],
            "planned_velocity": velocity[:, 0],
            "planned_upper": made.upper(now, angle[:, 0]),
            "planned_lower": now,
            "plan_ahead": torch.cat([pose, velocity, gripper], dim=-1)[:, 1:],
            "plan_time": time,
            "plan_lasts": DT * self._bank.lengths[row].float(),
            "planned_object": thing[:, 0],
            "planned_held": held,
            "planned_goal": self._bank.goals[row, leg.long()],
            "planned_leg": leg,
            "leg_over": judged[:, LAST],
            "object_shape": self._bank.seen[row],
            "object_ahead": torch.cat(
                [
                    rotations.inverse_rotate(
                        turn.expand(-1, len(AHEAD), 4), thing[:, 1:, :3] - palm
                    ),
                    rotations.multiply(
                        rotations.conjugate(turn).expand_as(thing[:, 1:, 3:]), thing[:, 1:, 3:]
                    ),
                ],
                dim=-1,
            ),
        }

    def _judged(self, row: Tensor, whole: Tensor, time: Tensor) -> Tensor:
        """(N, _FRAME) of the plans `row` (N,): of the frames that the control period until `time` (N,) s came to the last one of a
        relocation, if there is one, so that each is judged once; else the frame `whole` (N,), of which nothing is over if it came to it
        before."""
        passed = whole.long()[:, None] - self._passed
        frames = self._bank.at(row, passed)
        came = DT * passed > (time - self._period)[:, None] + 0.5 * _SOON
        over = frames[..., LAST] * came
        which = over.argmax(dim=1)
        found = frames[torch.arange(len(row), device=row.device), which].clone()
        found[:, LAST] = over.amax(dim=1)
        return found

    def _unplanned(self, row: Tensor, here: Tensor) -> Tensor:
        """The frames `here` (N, K, _FRAME) of the plans `row` (N,) with arm and sticks as they begin, nothing held, and the object
        where it should be in the end."""
        found = here.clone()
        found[..., : OBJECT.start] = self._bank.frames[row, 0, : OBJECT.start][:, None]
        found[..., OBJECT] = self._bank.at(row, self._bank.lengths[row])[:, None, OBJECT]
        found[..., HELD] = 0.0
        return found


def _between(here: Tensor, after: Tensor, share: Tensor) -> Tensor:
    """(N, K, 7) poses by a `share` (N,) of the way from `here` to `after`, which are near."""
    share = share[:, None, None]
    same = (here[..., 3:] * after[..., 3:]).sum(-1, keepdim=True) >= 0
    end = torch.cat([after[..., :3], torch.where(same, after[..., 3:], -after[..., 3:])], dim=-1)
    found = here + share * (end - here)
    found = torch.cat([found[..., :3], rotations.normalize(found[..., 3:])], dim=-1)
    return torch.where(share > 0, found, here)
