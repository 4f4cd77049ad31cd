"""When a training is given up: its numbers mostly leave the finite."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from understudy.errors import TrainingError

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
            if more than a quarter of all steps of the iteration were quarantined, or most
            of the episodes that ended since there were enough of them.
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
                "causes are a term that divides by zero or has a root of what is negative, a time step too "
                "large for the gains, initial states in deep penetration, or an action scale far too large."
            )
