"""Whether a motion depends on the time step of its physics.

A result that half the time step takes away belongs to the solver, not to the character. Both judgements have the
same starts, policy and model.
"""

from __future__ import annotations

import math
from typing import Any, Protocol, runtime_checkable

from understudy.running.jobs import Judgement
from understudy_reinforcement.evaluation import wilson_interval

#: Success may differ by this much, as a share, in what is said to be the same.
TOLERANCE = 0.1


@runtime_checkable
class Finer(Protocol):
    """A job that can judge at a finer time step than its task's."""

    def evaluate_finer(self, draw: str, episodes: int) -> tuple[float, Judgement]:
        """As :meth:`understudy.running.jobs.Job.evaluate`, at half the time step of physics; and the
        rate of that in Hz."""
        ...


def difference(first: Judgement, second: Judgement) -> tuple[float, float, float] | None:
    """The success rate of `second` minus that of `first`, and the ends of its 95 % interval; None if there is no
    success.

    Newcombe's hybrid score interval of a difference of independent shares (Newcombe 1998, method 10). Starts
    that are the same make it too wide, never too narrow, as long as worlds do not part for the worse.
    """
    p, q = first.success_rate, second.success_rate
    if p is None or q is None:
        return None
    (p_low, p_high), (q_low, q_high) = (
        wilson_interval(rate, one.trials) for rate, one in ((p, first), (q, second))
    )
    low = q - p - math.hypot(q - q_low, p_high - p)
    return q - p, low, q - p + math.hypot(q_high - q, p - p_low)


def verdict(interval: tuple[float, float]) -> str:
    """``depends``, ``independent``, or ``undecided``, of the 95 % interval of a difference of shares."""
    low, high = interval
    if low > 0 or high < 0:
        return "depends"
    return "independent" if max(-low, high) <= TOLERANCE else "undecided"


def compared(first: Judgement, hertz: float, second: Judgement) -> dict[str, Any]:
    """For ``evaluation.json``: what `second` found with physics at `hertz`, beside `first`."""
    found: dict[str, Any] = {
        "physics_hz": hertz,
        "mean_episode_seconds": second.mean_episode_seconds,
        "objective": second.objective_value,
    }
    if (apart := difference(first, second)) is None or second.success_rate is None:
        return found
    return found | {
        "success_rate": second.success_rate,
        "success_rate_95": [*wilson_interval(second.success_rate, second.trials)],
        "difference": apart[0],
        "difference_95": [*apart[1:]],
        "verdict": verdict(apart[1:]),
    }
