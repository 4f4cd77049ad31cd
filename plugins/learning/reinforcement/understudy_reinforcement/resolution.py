"""Physics that is coarser at the beginning of a training, and is sharpened later."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from understudy.errors import ConfigError
from understudy.inputs import Inputs
from understudy.options import check_range
from understudy.running.environment import Environment
from understudy.running.training import Progress
from understudy.setup.config import Experiment
from understudy.setup.registry import Registry
from understudy.task import State

__all__ = ["resolution_of"]

#: What evaluations at coarse physics are called; none of them meets the criterion.
REHEARSAL = "rehearsal"


@dataclass(frozen=True)
class ResolutionOptions:
    """Coarser physics for the beginning of a training, which is judged at ``control.substeps``.

    It changes to the latter, *sharpens*, as soon as the criterion is met with coarse physics, the curriculum has
    reached `difficulty`, or the share `budget` of the budget is spent.
    """

    substeps: int | None = None  #: physics steps per control period at first; null is the task's
    difficulty: float | None = None  #: mean difficulty at which physics sharpens; null is none
    budget: float = 0.75  #: share of the samples, or of the minutes, after which physics sharpens

    def __post_init__(self) -> None:
        check_range(self, "substeps", least=1)
        check_range(self, "difficulty", least=0, most=1)
        check_range(self, "budget", above=0, most=1)


def section(options: ResolutionOptions, registry: Registry, inputs: Inputs) -> ResolutionOptions:
    """The options themselves, which only the job reads."""
    return options


def resolution_of(experiment: Experiment) -> ResolutionOptions:
    """The section ``resolution``; without one, physics is always the task's own.

    Raises
    ------
    ConfigError
        if physics would begin finer than it ends.
    """
    options = experiment.sections.get("resolution") or ResolutionOptions()
    coarse, own = options.substeps, experiment.root.control.substeps
    if coarse is not None and coarse > own:
        raise ConfigError(
            f"resolution.substeps={coarse} is not possible: physics begins coarser than it ends, "
            f"so give at most control.substeps={own}, or null."
        )
    return options


class Resolution:
    """How fine a training's physics is now, and when it becomes the task's own."""

    def __init__(self, experiment: Experiment) -> None:
        self._root, self._options = experiment.root, resolution_of(experiment)
        self.own = self._root.control.substeps  #: physics steps of a control period: the task's
        self.substeps = self._options.substeps or self.own  #: those of iterations, at present

    @property
    def coarse(self) -> bool:
        """Whether iterations simulate more coarsely than evaluations."""
        return self.substeps < self.own

    @property
    def hertz(self) -> float:
        """The physics rate of iterations, Hz."""
        return self._root.control.frequency * self.substeps

    @property
    def in_words(self) -> str:
        return f"physics at {self.hertz:.4g} Hz"

    def hard(self, environment: Environment) -> bool:
        """Whether the mean difficulty of running episodes has reached the value at which physics sharpens. Waits for the device,
        if physics depends on it."""
        enough = self._options.difficulty
        if enough is None:
            return False
        return float(environment.table["difficulty"].mean()) >= enough - 1e-6

    def ripe(self, row: Mapping[str, Any], progress: Progress) -> bool:
        """Whether the criterion is met with coarse physics, by the `row` of this iteration, or enough of the budget is
        spent."""
        criterion = self._root.evaluation.criterion
        rate = row.get(f"{REHEARSAL}/success_rate")  # at_most, of a rehearsal that was given up
        met = criterion is not None and rate is not None and rate >= criterion
        return met or progress.spent(self._root.budget) >= self._options.budget

    def look_soon(self, progress: Progress) -> None:
        """Make the next evaluation come after half as many samples as usual: what was learned mostly holds."""
        if (every := self._root.evaluation.every) < math.inf:
            soon = progress.samples - round(every / 2)
            progress.evaluated_at = min(progress.evaluated_at, soon)

    def state_dict(self) -> State:
        return {"substeps": self.substeps} if self._options.substeps else {}
