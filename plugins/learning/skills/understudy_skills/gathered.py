"""The states that a job has gathered, and how far it has come in its words and figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from understudy.records.runs import Run
from understudy.running.evaluation import Evaluation, Measured
from understudy.task import Scene, State
from understudy_skills import bank


class Gathered:
    """Up to `wanted` states, of each field (S, …), and how many iterations in a row found none."""

    def __init__(self, wanted: int) -> None:
        self._wanted = wanted
        self._states: dict[str, Tensor] = {}
        self.barren = 0

    @property
    def count(self) -> int:
        return len(next(iter(self._states.values()))) if self._states else 0

    @property
    def enough(self) -> bool:
        return self.count >= self._wanted

    def add(self, new: Mapping[str, Tensor]) -> None:
        """What an iteration found, of each field (S', …); S' may be 0."""
        found = len(next(iter(new.values())))
        self.barren = 0 if found else self.barren + 1
        self._states = {
            name: torch.cat([self._states[name], value]) if self._states else value
            for name, value in new.items()
        }

    def stage(self) -> str:
        return f"{min(self.count, self._wanted)} of {self._wanted} states"

    def evaluation(self) -> Evaluation:
        """How many states there are; they need no other judgement."""
        states = torch.tensor([float(min(self.count, self._wanted))])
        return Evaluation(episodes=1, measures={"states": Measured.of("last", states)})

    def save(self, run: Run, about: Mapping[str, Any], scene: Scene | None) -> None:
        """Leave them, states of `scene`, if there are any, as the bank of `run`."""
        if self.count:
            states = {name: value[: self._wanted] for name, value in self._states.items()}
            bank.save(run.path / bank.NAME, states, about, scene)

    def state_dict(self) -> State:
        return {"found": dict(self._states), "barren": self.barren}

    def load_state_dict(self, state: State) -> None:
        self._states, self.barren = dict(state["found"]), state["barren"]
