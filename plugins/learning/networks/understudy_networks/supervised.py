"""A base for jobs that train one network by gradient descent on a loss."""

from __future__ import annotations

from typing import Generic, TypeVar

import torch
from torch import Tensor, nn

from understudy.errors import RunError
from understudy.random import generator
from understudy.records.checkpoint import misshapen
from understudy.running.jobs import Job
from understudy.task import State
from understudy_networks import averages, optimisers

__all__ = ["NetworkJob"]

N = TypeVar("N", bound=nn.Module)


class NetworkJob(Job, Generic[N]):
    """Trains ``network`` by Adam, with random numbers of ``generator``. Both are the job's state."""

    network: N
    generator: torch.Generator
    _optimiser: torch.optim.Optimizer

    def begin(self, learning_rate: float, seed: int, stream: str) -> None:
        """Make optimiser and generator; `stream` names the random numbers of `seed`."""
        rate = torch.tensor(learning_rate, device=self.device)
        self._optimiser = optimisers.adam(list(self.network.parameters()), rate)
        self.generator = generator(seed, stream, self.device)

    def descend(self, loss: Tensor, figures: Tensor) -> Tensor:
        """One step down `loss` (); returns `figures` (K,) as their mean over all processes."""
        self._optimiser.zero_grad()
        loss.backward()
        parameters = list(self.network.parameters())
        mean = averages.average_gradients(parameters, figures.detach())
        self._optimiser.step()
        return mean

    def state_dict(self) -> State:
        return {
            "network": dict(self.network.state_dict()),
            "optimiser": optimisers.state_of(self._optimiser),
            "generator": self.generator.get_state(),
        }

    def load_state_dict(self, state: State) -> None:
        self._load_network(state)
        optimisers.load_state(self._optimiser, state["optimiser"])
        self.generator.set_state(state["generator"])

    def load_learned(self, state: State, samples: int) -> None:
        self._load_network(state)

    def _load_network(self, state: State) -> None:
        for misfit in misshapen(dict(self.network.state_dict()), state.get("network"), "network"):
            raise RunError(f"The checkpoint does not fit this network: {misfit}.")
        self.network.load_state_dict(state["network"])
