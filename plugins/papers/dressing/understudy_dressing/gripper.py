"""A gripper that learns to dress a person whose policy is frozen (section 8.3, figure 9)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.task import Actuation, Context, Encoder, Shape, box
from understudy_dressing.person import PersonScene
from understudy_skills.controller import Controller

#: Forces and torques of the gripper, and its own coordinates.
_OWN = 6


def _driven(context: Context, who: str) -> PersonScene:
    person = context.need_scene(PersonScene, who)
    if not person.options.driven:
        raise ConfigError(f"{who} drives the gripper: set scenes.person.driven=true.")
    return person


class GripperObservation(Encoder):
    """[cos q, sin q, q̇ of the person; position, turn and velocity of the gripper]: 78 numbers with all 22 hinges."""

    reads = ("qpos", "qvel")

    def __init__(self, options: None, context: Context) -> None:
        self._hinges = len(_driven(context, "encoder 'dressing/gripper'").hinges)
        self.shape = (3 * self._hinges + 2 * _OWN,)

    def encode(self, qpos: Tensor, qvel: Tensor) -> Tensor:
        q, rate, k = qpos[:, : self._hinges], qvel[:, : self._hinges], self._hinges
        return torch.cat([q.cos(), q.sin(), rate, qpos[:, k:], qvel[:, k:]], dim=1)


class GripperForces(Actuation):
    """Forces and torques of the gripper, in shares of 2 N and 2 N m, cut at ±1; the person acts by the mode of a
    run's policy, as often as in that policy's training."""

    @dataclass(frozen=True)
    class Options:
        run: str  #: the run folder or skill whose policy is the person's

    every = "period"

    def __init__(self, options: Options, context: Context) -> None:
        self._hinges = len(_driven(context, "actuation 'dressing/gripper'").hinges)
        self._person = Controller.load(options.run, context, any_rate=True)
        self.action_space = box(_OWN)
        size = self._person.action_size
        self.keeps: Mapping[str, Shape] = {"person_action": (size,), "person_age": ()}
        self.reads = tuple(dict.fromkeys(("person_action", "person_age", *self._person.reads)))
        self._nothing = torch.zeros(context.num_worlds, size, device=context.device)

    def begin(self, **fields: Tensor) -> dict[str, Tensor]:
        due = self._nothing[:, 0] + self._person.decision
        return {"person_action": self._nothing, "person_age": due}

    def advance(
        self, action: Tensor, person_action: Tensor, person_age: Tensor, **fields: Tensor
    ) -> dict[str, Tensor]:  # fmt: skip
        decides = person_age >= self._person.decision
        new = self._person.decide({name: fields[name] for name in self._person.reads})
        return {
            "person_action": torch.where(decides.unsqueeze(1), new, person_action),
            "person_age": torch.where(decides, 1.0, person_age + 1.0),
        }

    def control(self, action: Tensor, person_action: Tensor, **fields: Tensor) -> Tensor:
        theirs = self._person.control(person_action, fields)
        k = self._hinges
        return torch.cat([theirs[:, :k], action.clamp(-1.0, 1.0), theirs[:, k:]], dim=1)
