"""Gives up a training in which most numbers are not finite."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from torch import Tensor

from understudy.errors import TrainingError
from understudy.running.environment import Environment
from understudy.running.soundness import sound

#: Of so many ended episodes at least, and as many as there are worlds, most may not be unsound.
_ENOUGH = 32


class Hopeless:
    """Stops a training whose worlds mostly fail numerically."""

    def __init__(self, num_worlds: int) -> None:
        self._num_worlds = num_worlds
        self._episodes = self._unsound = 0.0

    def refuse(self, row: Mapping[str, float], steps: int, where: Callable[[], str]) -> None:
        """After an iteration of so many `steps`, with the statistics' `row` of it; `where` says which
        part's numbers go wrong.

        Raises
        ------
        TrainingError
            if more than a quarter of the iteration's steps were unsound, or most of the last episodes, once there were
            enough of these.
        """
        self._episodes += row["episodes"]
        self._unsound += row["unsound"]
        found = []
        share = row["unsound"] / max(1, steps * self._num_worlds)
        if share > 0.25:
            found.append(f"{share:.0%} of all steps")
        if self._episodes >= max(_ENOUGH, self._num_worlds):
            if self._unsound > 0.5 * self._episodes:
                found.append(f"{self._unsound / self._episodes:.0%} of all episodes")
            self._episodes = self._unsound = 0.0
        if found:
            raise TrainingError(
                f"{found[0]} ended in non-finite or diverged states, by the numbers of {where()}. The usual "
                "causes are a term that divides by zero or takes the root of a negative number, a time step too "
                "large for the gains, initial states in deep penetration, or an action scale far too large."
            )


def refuse_negative(environment: Environment) -> None:
    """Raise :class:`TrainingError` if a reward that has an exponent has been negative."""
    for where, least in environment.rewards.least.items():
        world = int(least.argmin())
        if least[world] < 0:
            raise TrainingError(
                f"{where} was {float(least[world]):g} in world {world}. With reward.combine=product "
                "its weight is an exponent, which a negative number cannot have. Use "
                f"reward.combine=sum, {where}.weight=1, or a term that is never negative."
            )


def unsound_parts(environment: Environment) -> list[str]:
    """The parts whose numbers went wrong in the states reached by :meth:`Environment.advance`, before ``begin``."""
    if bool(environment.unsound.any()):
        return ["the actuation or the simulator"]
    parts = environment.parts
    evaluated = [environment.evaluate(term) for term in parts.rewards]
    reward, given = environment.rewards.combined(evaluated)
    values = {term.where: given[term.name] for term in parts.rewards}
    values |= {parts.encoders[n].where: value for n, value in environment.encode().items()}
    values = values if any(map(_unsound, values.values())) else {"reward": reward}
    return [where for where, value in values.items() if _unsound(value)]


def _unsound(value: Tensor) -> bool:
    """Whether any row of `value` (N, …) is not :func:`sound`. Waits for the device."""
    return not bool(sound(value).all())
