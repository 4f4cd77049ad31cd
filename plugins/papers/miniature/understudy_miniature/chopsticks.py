"""A policy for several hands: what its observations have in common is that it reads them all."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor, nn

from understudy.errors import ConfigError, suggestion
from understudy.task import Context, Distribution, Policy
from understudy_networks.policies import MLPPolicy

_JOINED = "joined"


class SideBySide(Policy):
    """An MLP of several flat observations, one beside the other."""

    @dataclass(frozen=True)
    class Options:
        observations: tuple[str, ...]  #: names of encoders, in this order
        #: Of the MLP; its ``observation`` is what is joined.
        mlp: MLPPolicy.Options = field(default_factory=MLPPolicy.Options)

    def __init__(self, options: Options, context: Context) -> None:
        super().__init__()
        self._names, shapes = options.observations, context.observation_shapes
        for name in self._names:
            if name not in shapes:
                raise ConfigError(
                    f"policy.observations names '{name}', which is no encoder of this task."
                    + suggestion(name, shapes)
                )
        size = sum(shapes[name][0] for name in self._names)
        inner = replace(context, observation_shapes={_JOINED: (size,)})
        self.mlp = MLPPolicy(replace(options.mlp, observation=_JOINED), inner)

    def _join(self, observations: Mapping[str, Tensor]) -> dict[str, Tensor]:
        return {_JOINED: torch.cat([observations[name] for name in self._names], dim=-1)}

    def distribution(self, observations: Mapping[str, Tensor]) -> Distribution:
        return self.mlp.distribution(self._join(observations))

    def value(self, observations: Mapping[str, Tensor]) -> Tensor:
        return self.mlp.value(self._join(observations))

    def actor_parameters(self) -> Iterator[nn.Parameter]:
        return self.mlp.actor_parameters()

    def critic_parameters(self) -> Iterator[nn.Parameter]:
        return self.mlp.critic_parameters()

    def observe(self, observations: Mapping[str, Tensor]) -> None:
        self.mlp.observe(self._join(observations))

    def schedule(self, samples: int) -> None:
        self.mlp.schedule(samples)
