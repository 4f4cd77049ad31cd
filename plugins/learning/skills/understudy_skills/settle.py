"""A job that lets a task's starts come to rest, without a policy, and keeps them for others to begin in."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch

from understudy.errors import TrainingError
from understudy.options import check_range
from understudy.records.runs import Run
from understudy.setup.building import build_environment, device_of
from understudy.setup.config import Experiment
from understudy.task import State
from understudy_reinforcement.job import sources_of
from understudy_reinforcement.long_work import LongWork
from understudy_reinforcement.origins import terms_behind
from understudy_skills.gathered import Gathered, Gathering


class Settle(Gathering):
    """Begins the task's episodes, acts with zeros for some seconds, and keeps the states of episodes that did not end: any
    termination discards a state, and so do numbers that go wrong. The job writes the bank ``bank`` into its folder.
    """

    @dataclass(frozen=True)
    class Options:
        count: int = 1024  #: how many states are wanted, from 1
        seconds: float = 1.0  #: s, for which each episode is simulated (dressing: 1 s)
        fields: tuple[str, ...] = ()  #: fields that are kept beside the simulator's state
        patience: int = 20  #: iterations in a row without any state after which the job gives up

        def __post_init__(self) -> None:
            check_range(self, "count", "patience", least=1)
            check_range(self, "seconds", above=0, most=3600)

    def __init__(self, options: Options, experiment: Experiment) -> None:
        self.options, self._experiment = options, experiment
        self.device = device_of(experiment.root.device)
        self._gathered = Gathered(options.count)

    def prepare(self) -> None:
        seconds = self.options.seconds
        self._built = build_environment(self._experiment, episode_seconds=2.0 * seconds)
        self.environment = environment = self._built.environment
        self._decisions = max(1, math.ceil(seconds / environment.control_dt / environment.decision))
        self._names = self._keeps(self.options.fields, "this task")
        environment.reset()

    @torch.no_grad()
    def iterate(self, samples: int) -> dict[str, Any]:
        environment = self.environment
        count, device = environment.num_worlds, environment.device
        environment.begin(torch.ones(count, dtype=torch.bool, device=device))
        still = torch.zeros(count, environment.action_size, device=device)
        gone = torch.zeros(count, dtype=torch.bool, device=device)
        work = LongWork(f"Settling {count} worlds", pause=30.0)
        for step in range(self._decisions):
            work.done(step / self._decisions)
            gone |= environment.advance(still).ended  # which go on, and count no more
        new = {name: environment.table[name][~gone].cpu() for name in self._names}
        self._gathered.add(new)
        if self._gathered.barren >= self.options.patience:
            raise TrainingError(
                f"No episode of this task lasts {self.options.seconds:g} s, in {self._gathered.barren} times "
                f"{count} worlds. Shorten job.seconds, or choose other initial states or terminations."
            )
        return {
            "consumed": self._decisions * count,
            "states": self._gathered.count,
            "discarded": float(gone.float().mean()),
        }

    def products(self, run: Run) -> None:
        assert self._built is not None
        clips = terms_behind({**run.info, "sources": sources_of(self._built)}, run.path)
        about = {"settled": f"{self.options.seconds:g} s", "clips": clips}
        self._gathered.save(run, about, self._built.scene)

    def state_dict(self) -> State:
        return {"environment": self.environment.state_dict(), **self._gathered.state_dict()}

    def load_state_dict(self, state: State) -> None:
        self.environment.load_state_dict(state["environment"])
        self.load_learned(state, 0)
