"""Episodes that begin as a Gaussian fits where others ended."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, InitialStates, Shape
from understudy_skills import bank

#: States of a bank: so many numbers are drawn for each world.
_MOST = 10_000


class Gaussian(InitialStates):
    """Draws from N(μ, α Σ), where μ and Σ are the mean and the covariance of a bank's states (section 5,
    lines 5 and 10).

    Σ has the bank's rank and is never formed: with M states, x = μ + √(α / (M − 1)) Σ_k z_k (x_k − μ), z_k
    standard normal. The simulator's state is drawn so, all of its fields together. What the bank has
    beside it, such as parameters, is that of one of its states, drawn uniformly. A state's sum is no
    state where it has rotations as quaternions, or cloth that touches something: begin in the bank there.
    """

    @dataclass(frozen=True)
    class Options:
        file: str  #: the bank, or the folder of the run that has one
        widening: float = 1.0  #: α, by which the covariance is multiplied

        def __post_init__(self) -> None:
            check_range(self, "widening", least=0)

    def __init__(self, options: Options, context: Context) -> None:
        simulator = context.simulator
        assert simulator is not None
        states = bank.fitting(options.file, context, "initial_states")
        count = len(next(iter(states.values())))
        if count < 2:
            raise ConfigError(
                f"initial_states: the bank {options.file} has one state, which has no spread. Keep more "
                "(job.count=…)."
            )
        if count > _MOST:
            raise ConfigError(
                f"initial_states: the bank {options.file} has {count} states, and a Gaussian is drawn from at "
                f"most {_MOST}. Keep fewer (job.count=…)."
            )
        for name in simulator.state_fields:
            own = simulator.fields[name]
            shape = tuple(states[name].shape[1:]) if name in states else None
            if shape != own:
                raise ConfigError(
                    f"initial_states: the bank {options.file} does not fit this simulator: '{name}' is "
                    f"{shape or 'missing'} there and {own} here. Harvest it in a task of this scene."
                )
        self._mean: dict[str, Tensor] = {}
        self._offsets: dict[str, Tensor] = {}  # (M, …), scaled
        for name in simulator.state_fields:
            value = states[name].to(context.device, torch.float32)
            self._mean[name] = value.mean(dim=0)
            self._offsets[name] = (value - self._mean[name]) * math.sqrt(
                options.widening / (count - 1)
            )
        others = [name for name in states if name not in simulator.state_fields]
        self._others = {name: states[name].to(context.device) for name in others}
        self._count = count
        self.varies = tuple(name for name in others if name in simulator.parameters)
        self.episode_fields: Mapping[str, Shape] = {
            name: tuple(states[name].shape[1:]) for name in others if name not in self.varies
        }

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        drawn = streams.uniform(2 * self._count + 1)
        one, two = drawn[:, : self._count], drawn[:, self._count : -1]
        # Box and Muller; 1 − u is above 0
        normal = (-2.0 * torch.log1p(-one)).sqrt() * torch.cos(2.0 * math.pi * two)
        found = {
            name: mean + torch.tensordot(normal, self._offsets[name], dims=1)
            for name, mean in self._mean.items()
        }
        row = (drawn[:, -1] * self._count).long().clamp(max=self._count - 1)
        return found | {name: value[row] for name, value in self._others.items()}
