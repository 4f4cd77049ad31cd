"""How much success rounding a policy's weights costs, and how many bits they need."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from understudy.running.jobs import Judgement
from understudy.running.training import Training
from understudy.setup.config import Experiment
from understudy_reinforcement.evaluation import Evaluation
from understudy_reinforcement.paired import Paired
from understudy_skills.pack import rounded
from understudy_skills.packing import BITS
from understudy_skills.skill import Skill

__all__ = ["Rounding", "enough_bits", "judged"]

#: Episodes from which on a loss of a sixth of the starts shows, whatever ``evaluation.final_episodes`` says.
LEAST = 32


@dataclass(frozen=True)
class Rounding:
    """A policy with weights of so many bits, judged."""

    bits: int
    evaluation: Judgement  #: of the policy as it is once packed
    #: beside its own weights; None where nothing was rounded or could be paired
    paired: Paired | None = None

    @property
    def falls(self) -> bool:
        """Whether the loss is more than chance."""
        return self.paired is not None and self.paired.falls

    def sentence(self) -> str:
        cost = (
            "nothing is rounded" if self.bits == max(BITS) else "not compared, as its task cannot"
        )
        return f"{self.bits} bits a weight: {self.paired.sentence() if self.paired else cost}"

    def as_json(self) -> dict[str, Any]:
        return {"bits": self.bits, "compared": self.paired and self.paired.as_json()}


def enough_bits(
    skill: Skill, experiment: Experiment, bits: int | None, tell: Callable[[str], None]
) -> Rounding:
    """The fewest bits, from 8 up, with which `skill` loses nothing measurable in `experiment` beside its own weights, from
    the same held-out starts; or `bits`, if given, whatever the loss. `tell` gets a line on each that is tried.

    Raises
    ------
    RunError
        if the policy does not fit, or a number of it is not finite.
    """
    tries = list(BITS if bits is None else (bits,))
    with _Judged(skill, experiment) as task:
        own: Judgement | None = None
        while True:
            tried = tries.pop(0)
            own = own or task.with_weights_of(skill)
            rounding = Rounding(tried, own)
            if tried < max(BITS):
                found = task.with_weights_of(rounded(skill, tried))
                rounding = Rounding(tried, found, _paired(own, found))
            if not rounding.falls or not tries:
                break
            tell(f"{rounding.sentence()}. The next precision is tried.")
    tell(f"{rounding.sentence()}." + " It is written so, as --bits says." * rounding.falls)
    return rounding


def _paired(first: Judgement, second: Judgement) -> Paired | None:
    if isinstance(first, Evaluation) and isinstance(second, Evaluation):
        return Paired.of_evaluations(first, second)
    return None


def judged(skill: Skill, experiment: Experiment) -> Judgement:
    """Judge `skill` in `experiment`, on as many held-out starts as comparisons use."""
    with _Judged(skill, experiment) as found:
        return found.with_weights_of(skill)


class _Judged:
    """A task in which policies are judged one after another, from the same held-out starts."""

    def __init__(self, skill: Skill, experiment: Experiment) -> None:
        self._whole = skill.whole()
        self._training = Training(experiment)
        self._episodes = max(LEAST, experiment.root.evaluation.final_episodes)

    def __enter__(self) -> _Judged:
        return self

    def __exit__(self, *_: object) -> None:
        self._training.close()

    def with_weights_of(self, skill: Skill) -> Judgement:
        progress = {**self._training.progress.state_dict(), "samples": skill.samples}
        policy = {**self._whole, **skill.policy}
        self._training.load_learned({"policy": policy, "progress": progress})
        return self._training.job.evaluate("final", self._episodes)
