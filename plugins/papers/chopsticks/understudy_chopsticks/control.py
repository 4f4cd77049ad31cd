"""What the policy sees (table 5.1) and what it decides: offsets from the grip (thesis, section 5.4.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from understudy.task import Actuation, Context, Encoder, box
from understudy_chopsticks.plan import AHEAD, GRIPPER, gripping
from understudy_hand.table import ARM_POSE
from understudy_hand.tools import tips
from understudy_tensors.limits import check_angle

#: The object as it is, and as it is planned.
_OBJECT = ("object_state", "object_ahead")
_SHAPE, _STROKE = ("object_shape",), ("tip_offset",)


class State(Encoder):
    """Table 5.1 without an object: arm and hand, sticks, fingertips' distances, normal forces, the plan ahead.

    Sticks are in the palm's frame. Forces f N are those of the last sub-step, as log(1 + f). Where several grips
    share the job, the last numbers say whose a world is.
    """

    @dataclass(frozen=True)
    class Options:
        #: whether normal forces on fingertips and on the sticks' tips are observed
        forces: bool = True
        #: whether the plan of arm and hand is observed beside that of the sticks
        planned_hand: bool = True
        #: whether the object is observed, as it is and as it is planned, in the palm's frame
        object: bool = False
        #: whether the object's kind and size are observed, for worlds that differ in them
        shape: bool = False
        #: whether the way from a brush's tip to its planned place is observed, in the palm's frame
        stroke: bool = False

    def __init__(self, options: Options, context: Context) -> None:
        made = gripping(context, "encoder 'chopsticks/state'")
        scene, touching = made.scene, len(made.touching)
        self._options, self._hinges = options, scene.hinges
        places = (
            *(f"{finger}_distal" for finger in scene.measures.names),
            *tips(scene.options.tool),
        )
        self._touch = (
            tuple(f"recent_sensor_touch_{name}" for name in places) if options.forces else ()
        )
        self._from = tuple(f"from_{name}" for name in made.names) if made.several else ()
        self.reads = (
            "qpos", "qvel", "stick_state", "tip_distance", "plan_ahead", *self._touch, *self._from,
            *(_OBJECT if options.object else ()), *(_SHAPE if options.shape else ()),
            *(_STROKE if options.stroke else ()),
        )  # fmt: skip
        planned = GRIPPER + (2 * scene.hinges if options.planned_hand else 0)
        size = (
            2 * scene.hinges + 13 * made.parts + touching + len(self._touch) + len(AHEAD) * planned
        )
        size += (13 + 7 * len(AHEAD) if options.object else 0) + (3 if options.stroke else 0)
        size += 6 if options.shape else 0
        self.shape = (size + len(self._from),)

    def encode(
        self,
        qpos: Tensor,
        qvel: Tensor,
        stick_state: Tensor,
        tip_distance: Tensor,
        plan_ahead: Tensor,
        **more: Tensor,
    ) -> Tensor:
        ahead = plan_ahead if self._options.planned_hand else plan_ahead[..., -GRIPPER:]
        count = self._hinges
        return torch.cat(
            [
                qpos[:, :count],
                qvel[:, :count],
                stick_state.flatten(1),
                tip_distance,
                *(torch.log1p(more[name]) for name in self._touch),
                ahead.flatten(1),
                *(more[name][:, None] for name in self._from),
                *(more[name].flatten(1) for name in _OBJECT if self._options.object),
                *(more[name] for name in _SHAPE if self._options.shape),
                *(more[name] for name in _STROKE if self._options.stroke),
            ],
            dim=1,
        )


class Offsets(Actuation):
    """Targets are a grip's, or a plan's, plus the action times `hand` or `arm`."""

    reads = ("planned_targets",)

    @dataclass(frozen=True)
    class Options:
        #: rad, offset of the hand's targets for an action of 1 (thesis: the action is the offset)
        hand: float = 1.0
        #: rad, offset of the arm's targets for an action of 1 (the release explores a tenth there)
        arm: float = 0.1
        #: ``grip``: the targets that hold the sticks in parallel (thesis); ``plan``: those that hold them at the
        #: planned angle, by which the sticks open and close a little without any policy.
        base: Literal["grip", "plan"] = "grip"

        def __post_init__(self) -> None:
            check_angle(self, "hand", "arm", least=0)

    def __init__(self, options: Options, context: Context) -> None:
        made = gripping(context, "actuation 'chopsticks/offsets'")
        self._follows = options.base == "plan"
        arm, hand = len(ARM_POSE), made.scene.hinges - len(ARM_POSE)
        self._scale = torch.tensor([options.arm] * arm + [options.hand] * hand)
        self._scale = self._scale.to(context.device)
        self._grip = made.parallel
        self.action_space = box(made.scene.hinges)

    def control(self, action: Tensor, planned_targets: Tensor) -> Tensor:
        still = torch.cat(
            [planned_targets[:, : len(ARM_POSE)], self._grip.expand(len(action), -1)], dim=1
        )
        return (planned_targets if self._follows else still) + self._scale * action
