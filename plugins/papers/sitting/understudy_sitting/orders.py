"""Baselines of Table 3: skills in a fixed order, of which only the moment of change is learned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.options import check_range
from understudy.task import ActionSpace, Actuation, Box, Choice, Context, Shape
from understudy_skills.controller import Controller


class InOrder(Actuation):
    """The controllers of finished runs, one after the other: a^switch says whether to go on to the next
    ("the meta controller is only used to trigger transitions", section 7). The last one stays.

    Like ``controllers``, it keeps the action's ``goal``, and in ``switch`` the number of the controller whose turn it is.
    """

    every = "period"

    @dataclass(frozen=True)
    class Options:
        runs: tuple[str, ...]  #: run folders or skills, in the order of their numbers
        goal: int = 2  #: how many numbers a goal has
        scale: float = 1.0  #: goal, in its own unit, for an action of 1

        def __post_init__(self) -> None:
            check_range(self, "goal", least=1)
            check_range(self, "scale", above=0)
            if not self.runs:
                raise ValueError("runs=() is not possible: name the folder of a run.")

    def __init__(self, options: Options, context: Context) -> None:
        self._scale, self._last = options.scale, len(options.runs) - 1
        self._controllers = [Controller.load(run, context) for run in options.runs]
        self.action_space = ActionSpace({"switch": Choice(2), "goal": Box(options.goal)})
        self.keeps: Mapping[str, Shape] = {"goal": (options.goal,), "switch": (), "decided": ()}
        read = [name for controller in self._controllers for name in controller.reads]
        self.reads = tuple(dict.fromkeys(("switch", "decided", "episode_step", *read)))
        self._periods = context.decision
        self._worlds = torch.arange(context.num_worlds, device=context.device)
        self._nothing = torch.zeros(context.num_worlds, options.goal, device=context.device)

    def begin(self, **fields: Tensor) -> dict[str, Tensor]:
        nothing = self._nothing[:, 0]
        return {"goal": self._nothing, "switch": nothing, "decided": nothing - 1.0}

    def advance(
        self,
        action: Tensor,
        switch: Tensor,
        decided: Tensor,
        episode_step: Tensor,
        **fields: Tensor,
    ) -> dict[str, Tensor]:
        """Each decision counts once, though it lasts several periods."""
        chosen = self.action_space.split(action)
        now = torch.div(episode_step, self._periods, rounding_mode="floor").float()
        onward = (chosen["switch"] > 0) & (now > decided)
        return {
            "goal": chosen["goal"] * self._scale,
            "switch": (switch + onward).clamp(max=float(self._last)),
            "decided": now,
        }

    def control(self, action: Tensor, switch: Tensor, **fields: Tensor) -> Tensor:
        controls = torch.stack([controller(fields) for controller in self._controllers])
        return controls[switch.long().clamp(0, self._last), self._worlds]
