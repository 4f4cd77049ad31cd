"""The object of a relocation: how far it is from its plan, its reward (thesis, eq. 5.4), and endings. N worlds; m, rad, s."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.options import check_range
from understudy.task import Context, Fields, Shape
from understudy.task.terms import ranges
from understudy_chopsticks.plan_bank import MOST, ON_TABLE, bank_of
from understudy_tensors import rotations
from understudy_tensors.limits import limits
from understudy_tool_planner.planner import DT


class Object(Fields):
    """The object, and how far it is from where it should be.

    - ``object_state`` (13,): position, rotation, linear and angular velocity in the palm's frame
    - ``object_distance`` () m and ``object_turn`` () rad from the plan; ``goal_distance`` () m from the goal
    - ``object_placed`` () 1 where the plan is over and the object within `within` m of the goal; where something is to go along, it still
      lies upon it
    - ``plan_over`` () 1 once the plan has ended
    - ``legs_placed`` (8,) 1 in the moment at which that relocation is over and its object within `within` m;
      ``leg_placed`` () 1 where any is, ``leg_missed`` () 1 where one is over and its object elsewhere
    """

    reads = (
        "qpos", "qvel", "xpos", "xquat", "planned_object", "planned_goal", "planned_leg", "leg_over",
        "plan_lasts", "plan_time", "plan_stopped", "object_shape",
    )  # fmt: skip
    provides: Mapping[str, Shape] = {
        "object_state": (13,),
        "object_distance": (),
        "object_turn": (),
        "goal_distance": (),
        "object_placed": (),
        "plan_over": (),
        "legs_placed": (MOST,),
        "leg_placed": (),
        "leg_missed": (),
    }

    @dataclass(frozen=True)
    class Options:
        #: m, greatest distance from the goal that counts as success (figure 5.22)
        within: float = 0.005
        settle: float = 0.3  #: s after the plan's end for which the object comes to rest

        def __post_init__(self) -> None:
            check_range(self, "within", above=0, most=1e3)
            check_range(self, "settle", least=0)

    def __init__(self, options: Options, context: Context) -> None:
        made, _ = bank_of(context, "fields 'chopsticks/object'")
        model = made.scene.model
        self._at, self._dof = (
            int(address[0])
            for address in (model.joint("object").qposadr, model.joint("object").dofadr)
        )
        self._palm, self._options = model.body("palm").id, options
        above, own = made.scene.options.above, made.scene.options.object
        self._above = None if above is None else int(model.joint("above").qposadr[0])
        if above is not None and own is not None:
            self._up, self._half = own.height + above.height, 0.5 * min(own.sizes)
        self._legs = torch.arange(MOST, device=context.device)

    def compute(
        self,
        qpos: Tensor,
        qvel: Tensor,
        xpos: Tensor,
        xquat: Tensor,
        planned_object: Tensor,
        planned_goal: Tensor,
        planned_leg: Tensor,
        leg_over: Tensor,
        plan_lasts: Tensor,
        plan_time: Tensor,
        plan_stopped: Tensor,
        object_shape: Tensor,
    ) -> dict[str, Tensor]:
        place, rotation = qpos[:, self._at : self._at + 3], qpos[:, self._at + 3 : self._at + 7]
        speed = qvel[:, self._dof : self._dof + 3]
        spin = rotations.rotate(rotation, qvel[:, self._dof + 3 : self._dof + 6])
        palm, turn = xpos[:, self._palm], xquat[:, self._palm]
        away = (place - planned_goal).norm(dim=-1)
        goes = plan_stopped < 0
        over = goes & (plan_time >= plan_lasts + self._options.settle - 0.5 * DT)
        turned = rotations.angle_between(rotation, planned_object[:, 3:])
        # The last one is judged when the plan is over, the others in their last frame.
        done = torch.where(plan_time < plan_lasts - 0.5 * DT, goes & (leg_over > 0), over)
        good = away <= self._options.within
        if self._above is not None:
            apart = qpos[:, self._above : self._above + 3] - place
            lies = (apart[:, 2] - self._up).abs() < ON_TABLE
            good &= lies & (apart[:, :2].norm(dim=-1) < self._half)
        there = done & good
        legs = planned_leg.long()[:, None] == self._legs
        return {
            "object_state": torch.cat(
                [
                    rotations.inverse_rotate(turn, place - palm),
                    rotations.canonical(rotations.multiply(rotations.conjugate(turn), rotation)),
                    rotations.inverse_rotate(turn, speed),
                    rotations.inverse_rotate(turn, spin),
                ],
                dim=-1,
            ),
            # Where a plan has stopped there is none for the object.
            "object_distance": (place - planned_object[:, :3]).norm(dim=-1) * goes,
            "object_turn": turned * (object_shape[:, 0] == 0),  # a sphere's rotation is nobody's
            "goal_distance": away,
            "object_placed": (over & good).float(),
            "plan_over": over.float(),
            "legs_placed": (there[:, None] & legs).float(),
            "leg_placed": there.float(),
            "leg_missed": (done & ~there).float(),
        }


@limits(distance=(0, 1e6), turn=(0, 1e6))
@ranges(0.0, 1.0)
def thing(
    object_distance: Tensor,
    object_turn: Tensor,
    *,
    distance: float = 40.0,  #: 1/m, factor of the distance from the plan (eq. 5.4)
    turn: float = 10.0,  #: 1/rad, factor of the angle Θ (eq. 5.4); a sphere's counts as 0
) -> Tensor:
    """exp of eq. 5.4: the object as planned, exp(-40 ‖p - p̃‖ - 10 Θ)."""
    return torch.exp(-distance * object_distance - turn * object_turn)


@limits(distance=(0, 1e3))
def lost(
    object_distance: Tensor,
    *,
    #: m, greatest distance from the plan; here exp(-20 d) is 0.7, the release's; the thesis names
    #: none
    distance: float = 0.0178,
) -> Tensor:
    """The object is far from where it is planned."""
    return object_distance > distance


def missed(plan_over: Tensor, object_placed: Tensor) -> Tensor:
    """The plan is over, and the object not at its goal."""
    return (plan_over > 0) & (object_placed == 0)


def placed(object_placed: Tensor) -> Tensor:
    """The object is at its goal, and the plan over."""
    return object_placed > 0
