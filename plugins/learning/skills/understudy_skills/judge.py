"""A job that learns nothing, but judges the policy of another run under this run's configuration."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from understudy.command.command import tell
from understudy.errors import RunError
from understudy.records import runs
from understudy.records.runs import Run, newest_state
from understudy.setup.config import Experiment
from understudy.task import State
from understudy_reinforcement import promised
from understudy_reinforcement.job import Reinforcement, sources_of
from understudy_reinforcement.origins import terms_behind
from understudy_reinforcement.policy import build_policy
from understudy_skills.folder import run_folder

#: What a policy sees, what its actions do and how often it acts: a policy learns these.
_LEARNED = ("encoder", "actuation", "control")


class Judge(Reinforcement):
    """Takes the policy of a finished run and ends; the run is only for its evaluation.

    Task, policy and evaluation are this run's own, so variants of a sweep can judge one policy under different
    conditions, of which its training had only one. If observations or actions differ from those of the training, a line
    says so, since a network fits any that have as many numbers.
    """

    @dataclass(frozen=True)
    class Options:
        #: folder of the run whose policy is judged; null where the task needs none, as its actuation has others'
        run: str | None

    def __init__(self, options: Options, experiment: Experiment) -> None:  # type: ignore[override]
        super().__init__(None, experiment)
        self.options = options

    def prepare(self) -> None:
        # what does not fit is said before the run has a folder, as it is of runs that train
        promised.begin(self.evaluator.built.environment)
        if self.options.run is None:
            self.policy = build_policy(self.experiment, self.evaluator.built.context)
            self._started = sources_of(self.evaluator.built)
            return
        source = runs.open_run(run_folder(self.options.run, registry=self.experiment.registry))
        state = newest_state(str(source.path))
        try:
            self.load_learned(state, state["progress"]["samples"])
        except (LookupError, TypeError, ValueError, RuntimeError) as error:
            raise RunError(
                f"job.run: the policy of {self.options.run} does not fit: {error}. Give the "
                "experiment that it was trained with."
            ) from error
        now, then = self.experiment.effective(), source.config
        changes = [
            c for part in _LEARNED for c in runs.differences(then.get(part), now.get(part), part)
        ]
        for change in changes:
            tell(f"Unlike in the training of {self.options.run}: {change}")
        behind = terms_behind(source.info, source.path)
        self._started = {
            **source.info["sources"],
            "policy": {"run": self.options.run, "behind": behind},
        }

    def watch(self, run: Run | None, tell: Callable[[str], None]) -> None:
        pass

    def iterate(self, samples: int) -> dict[str, Any]:
        raise AssertionError("it is finished before it begins")

    def finished(self) -> bool:
        return True

    def notes(self) -> list[str]:
        return []  # what a policy reads was settled where it learned

    def sources(self) -> Mapping[str, Any]:
        return self._started

    def report(self) -> Mapping[str, int]:
        return self.evaluator.built.environment.parts.simulator.report()

    def state_dict(self) -> State:
        return {"policy": dict(self.policy.state_dict())}

    def load_state_dict(self, state: State) -> None:
        self.policy.load_state_dict(state["policy"])

    def forget_worlds(self) -> None:
        pass
