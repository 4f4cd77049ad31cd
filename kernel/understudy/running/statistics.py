"""What is counted while episodes run: returns, lengths, and why they ended."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from understudy.running.step import Step
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

    def digest(self, step: Step, seconds: Tensor) -> None:
        """Count one step, before ended worlds begin anew; `seconds` (N,) is the episodes' time."""
        ended, endings = step.ended, [step.endings[t] for t in self.terms]
        amounts = (torch.stack([seconds, step.returns]) * ended).sum(1)
        flags = [ended, step.succeeded, step.truncated, step.unsound, *endings]
        self._sums += torch.cat([amounts, (torch.stack(flags) & ended).sum(1)])

    def collect(self) -> dict[str, float]:
        """Means since the last call, in seconds and shares of episodes. One host transfer."""
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
