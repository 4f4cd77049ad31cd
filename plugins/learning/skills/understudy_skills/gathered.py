"""What jobs that gather states have in common: the states, and their progress in words and figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from understudy.command.command import tell
from understudy.errors import ConfigError, RunError, TrainingError, suggestion
from understudy.records.runs import Run
from understudy.running.environment import Environment
from understudy.running.jobs import Job
from understudy.setup.building import Built
from understudy.task import Scene, State
from understudy_reinforcement.evaluation import Evaluation, Measured
from understudy_reinforcement.long_work import LongWork
from understudy_skills import bank

__all__ = ["Gathered", "Gathering"]


class Gathered:
    """Up to `wanted` states, (S, …) by field, and how many iterations in a row found none."""

    def __init__(self, wanted: int) -> None:
        self._wanted = wanted
        self._states: dict[str, Tensor] = {}
        self._work = LongWork("Gathering states")  # since this process began
        self.barren = 0

    @property
    def count(self) -> int:
        return len(next(iter(self._states.values()))) if self._states else 0

    @property
    def enough(self) -> bool:
        return self.count >= self._wanted

    def add(self, new: Mapping[str, Tensor]) -> None:
        """Add what an iteration found, (S', …) by field; S' may be 0.

        Raises
        ------
        RunError
            the states of a checkpoint have other fields.
        """
        found, kind = len(next(iter(new.values()))), _kinds(new)
        if self._states and _kinds(self._states) != kind:
            raise RunError(
                f"The states of the checkpoint are none of this task: they have {_kinds(self._states)}, not {kind}."
            )
        self.barren = 0 if found else self.barren + 1
        self._states = {
            name: torch.cat([self._states[name], value]) if self._states else value
            for name, value in new.items()
        }

    def stage(self, of: str = "states") -> str:
        count = min(self.count, self._wanted)
        return f"{count} of {self._wanted} {of}{self._work.left(count / self._wanted)}"

    def evaluation(self) -> Evaluation:
        """The number of states, which need no other judgement."""
        states = torch.tensor([float(min(self.count, self._wanted))])
        return Evaluation(episodes=1, measures={"states": Measured.of("last", states)})

    def save(self, run: Run, about: Mapping[str, Any], scene: Scene | None) -> None:
        """Write them, states of `scene`, as the bank of `run`.

        Raises
        ------
        TrainingError
            there are none.
        """
        more = f"understudy resume {run.path} budget.samples=N goes on"
        if not self.count:
            raise TrainingError(
                f"No state was found before the budget was spent, so there is no bank: {more}."
            )
        if not self.enough:
            tell(
                f"The budget was spent at {self.count} of {self._wanted} states, which the bank has: {more}."
            )
        states = {name: value[: self._wanted] for name, value in self._states.items()}
        bank.save(run.path / bank.NAME, states, about, scene)

    def state_dict(self) -> State:
        return {"found": dict(self._states), "barren": self.barren}

    def load_state_dict(self, state: State) -> None:
        found, barren = dict(state["found"]), state["barren"]
        if not all(isinstance(value, Tensor) and value.dim() for value in found.values()):
            raise ValueError("'found' are no states")
        if len({len(value) for value in found.values()}) > 1 or type(barren) is not int:
            raise ValueError("'found' are not equally many of each field")
        self._states, self.barren = found, barren


def _kinds(states: Mapping[str, Tensor]) -> dict[str, tuple[Any, ...]]:
    """Of each field, what all of its states have in common."""
    return {name: (*value.shape[1:], str(value.dtype)) for name, value in states.items()}


class Gathering(Job):
    """A job that gathers states of an environment. A subclass builds that, iterates, and keeps the products."""

    environment: Environment
    _gathered: Gathered
    _built: Built | None = None

    def _keeps(self, fields: Sequence[str], of: str) -> list[str]:
        """The fields that are kept: the simulator's own and `fields`; a ConfigError for one that the task of `of` does not
        have."""
        shapes = self.environment.table.shapes
        for name in fields:
            if name not in shapes:
                raise ConfigError(
                    f"job.fields names '{name}', which is no field of {of}."
                    + suggestion(name, shapes)
                )
        return list(dict.fromkeys((*self.environment.parts.simulator.state_fields, *fields)))

    def finished(self) -> bool:
        return self._gathered.enough

    def stage(self) -> str:
        return self._gathered.stage()

    def evaluate(
        self, draw: str, episodes: int, *, give_up_below: float | None = None
    ) -> Evaluation:
        return self._gathered.evaluation()

    def report(self) -> Mapping[str, int]:
        return self._built.environment.parts.simulator.report() if self._built else {}

    def load_learned(self, state: State, samples: int) -> None:
        self._gathered.load_state_dict(state)

    def forget_worlds(self) -> None:
        self.environment.reset()

    def close(self) -> None:
        if self._built is not None:
            self._built.environment.close()
