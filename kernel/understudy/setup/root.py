"""The keys of a configuration that are the kernel's own, with defaults and ranges."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal

from understudy.options import check_range

__all__ = ["Root"]

#: The most physics steps in a decision, decisions in an episode of an evaluation, and decisions in
#: all of its episodes.
_STEPS, _DECISIONS, _JUDGED = 100_000, 1_000_000, 100_000_000


@dataclass(frozen=True)
class ControlOptions:
    """Control and physics rates; 30 Hz control, 600 Hz physics by default (thesis, section 3.5)."""

    frequency: float = 30.0  #: control periods per second
    substeps: int = 20  #: physics steps per control period
    decision: int = 1  #: control periods that one decision of the policy lasts

    def __post_init__(self) -> None:
        check_range(self, "frequency", least=1e-3, most=1e5)
        check_range(self, "substeps", least=1, most=10_000)
        check_range(self, "decision", least=1, most=10_000)
        if self.substeps * self.decision > _STEPS:
            raise ValueError(
                f"decision={self.decision} is not possible: with substeps={self.substeps} a "
                f"decision would be more than {_STEPS} steps of physics."
            )


@dataclass(frozen=True)
class EpisodeOptions:
    seconds: float = 20.0  #: episodes are truncated at this length

    def __post_init__(self) -> None:
        check_range(self, "seconds", above=0, most=1e7)


@dataclass(frozen=True)
class BudgetOptions:
    """A training ends at whichever of these it reaches first; both count across resumes."""

    samples: int | None = None  #: environment steps, summed over worlds
    minutes: float | None = None  #: of training, without evaluations and compiling
    #: Samples after which ``evaluation.criterion`` is usually met, if known; for the time left.
    usual_samples: int | None = None

    def __post_init__(self) -> None:
        check_range(self, "samples", "minutes", "usual_samples", above=0, most=2**63 - 1)


@dataclass(frozen=True)
class MeasureThreshold:
    """Success by a measure: over the episode, its value is within these limits."""

    measure: str  #: name of the measure
    at_least: float | None = None  #: in the measure's unit
    at_most: float | None = None  #: in the measure's unit

    def __post_init__(self) -> None:
        if self.at_least is None and self.at_most is None:
            raise ValueError("at_least and at_most are both unset: give one of them.")


@dataclass(frozen=True)
class EvaluationOptions:
    """How a policy is judged: deterministic, from starts that training never saw."""

    episodes: int = 64  #: of one draw of starts, all at once
    final_episodes: int = 128  #: of the draw that confirms a criterion, and of the last evaluation
    seconds: float = 20.0  #: episodes are truncated at this length
    starts: Mapping[str, Any] = field(default_factory=dict)  #: where they begin; the first decides
    #: ``survived`` (no failure until the end), a termination term with outcome=success, or
    #: ``{measure: NAME, at_least: x}``; null is the task's success term, else survival.
    success: str | MeasureThreshold | None = None
    #: Failure terms that end an episode of an evaluation; the others only report. Null is all.
    failures: tuple[str, ...] | None = None
    #: What searches maximise: ``success_rate``, ``return``, or a measure (its mean).
    objective: str = "success_rate"
    #: Success rate at which a training is done, if it is reached on one draw of starts and again on
    #: a second one that confirms it; null trains to the budget.
    criterion: float | None = None
    #: Whether an evaluation stops once the criterion is out of reach; it then records no measures.
    give_up: bool = True
    #: An evaluation starts when training episodes would last this share of its seconds …
    gate: float = 0.3
    #: … and this many samples were consumed since the last one; null is 100 000 with a criterion,
    #: and never without one.
    every_samples: int | None = None

    def __post_init__(self) -> None:
        check_range(self, "episodes", "final_episodes", least=1)
        check_range(self, "seconds", above=0, most=1e7)
        check_range(self, "criterion", above=0, most=1)
        check_range(self, "gate", least=0, most=1)
        check_range(self, "every_samples", least=0, most=2**63 - 1)

    @property
    def every(self) -> float:
        """Samples from one evaluation to the next."""
        if self.every_samples is None:
            return math.inf if self.criterion is None else 100_000
        return max(self.every_samples, 1)


@dataclass(frozen=True)
class CheckpointOptions:
    minutes: float = 2.0  #: training time between checkpoints
    keep: int = 3  #: how many of the newest are kept

    def __post_init__(self) -> None:
        check_range(self, "minutes", least=0)
        check_range(self, "keep", least=1)


@dataclass(frozen=True)
class RunOptions:
    dir: str | None = None  #: run folder; null makes ``runs/<experiment>-<n>``
    video_seconds: float = 8.0  #: length of the film made when a training ends; 0 makes none
    video_size: tuple[int, int] | None = None  #: width and height in pixels; null is the report's
    video_camera: float | None = None  #: degrees about the vertical; 0 is from behind, 90 the right

    def __post_init__(self) -> None:
        check_range(self, "video_seconds", least=0, most=3600)
        check_range(self, "video_size", least=1, most=8192)


@dataclass(frozen=True)
class RewardOptions:
    terms: Mapping[str, Any] = field(default_factory=dict)  #: by name: {name: COMPONENT, weight: 1}
    #: ``sum``: each term times its weight, added. ``product``: each term to the power of its
    #: weight, multiplied; none may be negative.
    combine: Literal["sum", "product"] = "product"


@dataclass(frozen=True)
class TerminationOptions:
    terms: Mapping[str, Any] = field(default_factory=dict)  #: by name: {name: COMPONENT}


@dataclass(frozen=True)
class Root:
    """The top level of a configuration, without slots and plugins' sections."""

    seed: int = 0  #: of all random streams, from 0
    device: str = "cpu"  #: as torch names it
    num_worlds: int = 256  #: simulated at once in training, from 1
    difficulty: float = 1.0  #: in [0, 1]: what evaluations run at, and trainings lead to
    task: str | None = None  #: its name, where one was chosen
    control: ControlOptions = ControlOptions()  #: how often the policy decides
    episode: EpisodeOptions = EpisodeOptions()  #: how long episodes last at most
    budget: BudgetOptions = BudgetOptions()  #: when a training ends
    evaluation: EvaluationOptions = EvaluationOptions()  #: how a policy is judged
    checkpoint: CheckpointOptions = CheckpointOptions()  #: how often a run is saved
    run: RunOptions = RunOptions()  #: its folder and its film
    reward: RewardOptions = RewardOptions()  #: what is rewarded
    termination: TerminationOptions = TerminationOptions()  #: what ends an episode

    def __post_init__(self) -> None:
        check_range(self, "num_worlds", least=1)
        check_range(self, "seed", least=0, most=2**63 - 1)
        check_range(self, "difficulty", least=0, most=1)
        decision, judged = self.control.decision / self.control.frequency, self.evaluation
        for name, seconds in (("episode", self.episode.seconds), ("evaluation", judged.seconds)):
            if seconds < decision * (1 - 1e-6):
                raise ValueError(
                    f"{name}.seconds={seconds:g} is not possible: a decision lasts {decision:g} s."
                )
        if (decisions := judged.seconds / decision) > _DECISIONS:
            raise ValueError(
                f"evaluation.seconds={judged.seconds:g} is not possible: an episode would be more "
                f"than {_DECISIONS} decisions."
            )
        for name, count in vars(judged).items():
            if name in ("episodes", "final_episodes") and count * decisions > _JUDGED:
                raise ValueError(
                    f"evaluation.{name}={count} is not possible: an evaluation would be more than "
                    f"{_JUDGED} decisions."
                )


KEYS = frozenset(f.name for f in fields(Root))
