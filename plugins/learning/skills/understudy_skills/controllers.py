"""An action space above other runs: which of their controllers acts, and with what goal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.options import check_range
from understudy.task import ActionSpace, Actuation, Box, Choice, Context, Shape
from understudy_skills.controller import Controller


class Controllers(Actuation):
    """Switches between the frozen controllers of finished runs, which all read this task's fields.

    The action gives a ``goal``, a field that they may read (``provides: {goal: target}``), and ``switch``, the number
    of the one that acts. Controls are computed every control period, so a decision may last several.
    """

    every = "period"

    @dataclass(frozen=True)
    class Options:
        runs: tuple[str, ...]  #: run folders or skills, in the order of the switch's numbers
        goal: int  #: how many numbers a goal has
        scale: float = 1.0  #: goal, in its own unit, for an action of 1

        def __post_init__(self) -> None:
            check_range(self, "goal", least=1, most=10_000)
            check_range(self, "scale", above=0)
            if not self.runs:
                raise ValueError("runs=() is not possible: name the folder of a run.")

    def __init__(self, options: Options, context: Context) -> None:
        self._scale = options.scale
        self._controllers = [Controller.load(run, context) for run in options.runs]
        self.action_space = ActionSpace(
            {"switch": Choice(len(self._controllers)), "goal": Box(options.goal)}
        )
        self.keeps: Mapping[str, Shape] = {"goal": (options.goal,), "switch": ()}
        read = [name for controller in self._controllers for name in controller.reads]
        self.reads = tuple(dict.fromkeys(read))
        self._worlds = torch.arange(context.num_worlds, device=context.device)
        self._nothing = torch.zeros(context.num_worlds, options.goal, device=context.device)

    def begin(self, **fields: Tensor) -> dict[str, Tensor]:
        return {"goal": self._nothing, "switch": self._nothing[:, 0]}

    def advance(self, action: Tensor, **fields: Tensor) -> dict[str, Tensor]:
        chosen = self.action_space.split(action)
        return {"goal": chosen["goal"] * self._scale, "switch": chosen["switch"].float()}

    def control(self, action: Tensor, **fields: Tensor) -> Tensor:
        controls = torch.stack([controller(fields) for controller in self._controllers])
        return controls[self.action_space.split(action)["switch"], self._worlds]
