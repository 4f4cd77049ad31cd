"""Searches carried out by ask and tell on functions, without any training."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from understudy_sweeps.loops import OuterLoop, Report, Trial

#: What happened, in order: a trial is asked for, or reported on.
Told = list[Trial | Report]


def retold(loop: OuterLoop, told: Sequence[Trial | Report]) -> Told:
    """Tell a new `loop` what another one asked for and was told."""
    for event in told:
        if isinstance(event, Report):
            loop.tell(event)
        else:
            assert loop.recall(event)
    return list(told)


def carry_on(
    loop: OuterLoop,
    objective: Callable[[Trial], float | None],
    told: Sequence[Trial | Report] = (),
    upto: int | None = None,
) -> Told:
    """Tell `loop` what was `told`, then go on, one trial after another, to its end or `upto` trials.

    A trial costs 100 samples, at fidelity 0 a quarter of it.
    """
    events = retold(loop, told)
    asked = [event for event in events if isinstance(event, Trial)]
    if asked and events[-1] is asked[-1]:
        events.append(_report(loop, asked[-1], objective))
    number = len(asked)
    while (upto is None or number < upto) and (trial := loop.ask(number)) is not None:
        number += 1
        events += [trial, _report(loop, trial, objective)]
    return events


def _report(loop: OuterLoop, trial: Trial, objective: Callable[[Trial], float | None]) -> Report:
    cost = 100 * (0.25 + 0.75 * (1.0 if trial.fidelity is None else trial.fidelity))
    loop.tell(Report(trial.key, "running", 0.1, cost=cost / 2))
    report = Report(trial.key, "ok", objective(trial), cost=cost)
    loop.tell(report)
    return report


def valley(trial: Trial) -> float:
    """0 at a.x = 0.3, learner.rate = 1e-2 and below 0 elsewhere; easier tasks have higher values."""
    easier = 0.0 if trial.fidelity is None else 0.5 * (1 - trial.fidelity)
    off = math.log10(trial.point.get("learner.rate", 1e-2)) + 2
    return easier - (trial.point["a.x"] - 0.3) ** 2 - 0.2 * off**2
