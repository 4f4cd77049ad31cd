"""What counts as success of an episode, by ``evaluation.success``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from torch import Tensor

from understudy.errors import ConfigError
from understudy.setup.config import Experiment

__all__ = ["success_of"]


@dataclass(frozen=True)
class Success:
    """A criterion of success: survival, a term, or a measure."""

    text: str
    term: str | None = None
    measure: str | None = None
    at_least: float = -math.inf
    at_most: float = math.inf

    def of(
        self, failed: Tensor, reached: Mapping[str, Tensor], measures: Mapping[str, Tensor]
    ) -> Tensor:
        """(N,) bool, for ended episodes, from whether they failed, which terms fired, and their measures."""
        if self.measure is not None:
            value = measures[self.measure]
            return (value >= self.at_least) & (value <= self.at_most)
        return reached[self.term] & ~failed if self.term is not None else ~failed


def success_of(experiment: Experiment) -> Success | None:
    """The criterion of ``evaluation.success``; by default the success terms, else survival, else None."""
    options = experiment.root.evaluation
    outcomes = {t.name: t.extras["outcome"] for t in experiment.many("termination.terms")}
    chosen = options.success
    if chosen is None:
        chosen = next((n for n, outcome in outcomes.items() if outcome == "success"), None)
        if chosen is None and not experiment.failures:
            return None
        chosen = chosen or "survived"
    if isinstance(chosen, str) and chosen != "survived":
        if outcomes.get(chosen) != "success":
            raise ConfigError(
                f"evaluation.success={chosen} names no termination term with outcome=success. Name "
                "one, 'survived', or {measure: NAME, at_least: NUMBER}."
            )
        return Success(f"{chosen} within {options.seconds:g} s", term=chosen)
    if isinstance(chosen, str):
        if not experiment.failures:
            raise ConfigError(
                "evaluation.success=survived cannot be judged: no termination term is a failure. Add "
                "one, or choose a measure (evaluation.success={measure: NAME, at_least: NUMBER})."
            )
        return Success(f"survived {options.seconds:g} s without {', '.join(experiment.failures)}")
    experiment.need_measure(chosen.measure, "evaluation.success.measure")
    least, most = chosen.at_least, chosen.at_most
    if least is not None and most is not None and least > most:
        raise ConfigError(
            f"evaluation.success.at_least={least:g} is not possible: it is more than at_most={most:g}, and no episode would succeed."
        )
    limits = [
        f"{word} {value:g}"
        for word, value in (("at least", chosen.at_least), ("at most", chosen.at_most))
        if value is not None
    ]
    return Success(
        f"{chosen.measure} {' and '.join(limits)}",
        measure=chosen.measure,
        at_least=-math.inf if chosen.at_least is None else chosen.at_least,
        at_most=math.inf if chosen.at_most is None else chosen.at_most,
    )
