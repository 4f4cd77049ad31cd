"""What is counted of episodes while they run: returns, lengths, why they ended."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import torch
from torch import Tensor

from understudy.errors import TrainingError
from understudy.task import State
from understudy.task.terms import Term


class EpisodeStatistics:
    """Lengths, returns and reasons of ended episodes, summed on the device."""

    def __init__(self, terminations: Sequence[Term], num_worlds: int, device: torch.device) -> None:
        #: Terms that end episodes; the others only report.
        self.terms = [t.name for t in terminations if t.outcome != "report"]
        #: (N,) the running episodes' returns so far.
        self.returns = torch.zeros(num_worlds, device=device)
        self._names = ["seconds", "return", "episodes", "succeeded", "truncated", "unsound"]
        self._names += [f"ended_by/{t}" for t in self.terms]
        self._sums = torch.zeros(len(self._names), dtype=torch.float64, device=device)

    def forget(self, worlds: Tensor) -> None:
        """Begin new returns where `worlds` (N,) is true."""
        self.returns.masked_fill_(worlds, 0.0)

    def digest(
        self,
        rewards: Tensor,
        seconds: Tensor,
        endings: Mapping[str, Tensor],
        *,
        succeeded: Tensor,
        truncated: Tensor,
        unsound: Tensor,
        ended: Tensor,
    ) -> None:
        """Digest one step, before ended worlds begin anew; `seconds` (N,) is the episodes' time."""
        self.returns.add_(rewards)
        amounts = (torch.stack([seconds, self.returns]) * ended).sum(1)
        flags = [ended, succeeded, truncated, unsound, *(endings[t] for t in self.terms)]
        self._sums += torch.cat([amounts, (torch.stack(flags) & ended).sum(1)])

    def collect(self) -> dict[str, float]:
        """Means since the last call, in seconds and shares; resets the sums. One host transfer."""
        sums = dict(zip(self._names, self._sums.tolist(), strict=True))
        self._sums.zero_()
        episodes = sums["episodes"]
        row: dict[str, float] = {"episodes": episodes, "unsound": sums["unsound"]}
        if episodes:
            row["episode_seconds"] = sums["seconds"] / episodes
            for name in ("return", "succeeded", "truncated", *self._names[6:]):
                row[name] = sums[name] / episodes
        return row

    def state_dict(self) -> State:
        return {"return": self.returns.clone(), "sums": self._sums.clone()}

    def load_state_dict(self, state: State) -> None:
        self.returns.copy_(state["return"])
        self._sums.copy_(state["sums"])


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
