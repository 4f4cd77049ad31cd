"""Episodes that begin where episodes of another run ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.random import WorldStreams
from understudy.task import Context, InitialStates, Shape
from understudy_skills import bank


class Bank(InitialStates):
    """States drawn uniformly from a bank (:mod:`understudy_skills.bank`).

    Evaluations begin in every fifth state, in which no training begins.

    What the bank has beside the simulator's state are parameters, which then vary between worlds, and fields of the
    same name, constant over the episode.
    """

    @dataclass(frozen=True)
    class Options:
        file: str  #: the bank, or the folder of the run that has one
        leave: tuple[str, ...] = ()  #: fields of the bank that the task takes from elsewhere
        #: further banks with the same fields; each bank is drawn from equally often
        beside: tuple[str, ...] = ()

    def __init__(self, options: Options, context: Context) -> None:
        simulator = context.simulator
        assert simulator is not None
        files = (options.file, *options.beside)
        banks = [bank.starts(file, context, "initial_states", options.leave) for file in files]
        shapes = [{name: value.shape[1:] for name, value in states.items()} for states in banks]
        for file, own in zip(files, shapes, strict=True):
            if own != shapes[0]:
                raise ConfigError(
                    f"initial_states.beside: the banks {options.file} and {file} do not have the same fields of the "
                    "same shapes. Harvest both in tasks of this scene."
                )
        self._states = {
            name: torch.cat([states[name] for states in banks]).to(context.device)
            for name in shapes[0]
        }
        counts = torch.tensor([len(next(iter(states.values()))) for states in banks])
        self._counts = counts.to(context.device)
        self._firsts = (counts.cumsum(0) - counts).to(context.device)
        for name in simulator.state_fields:
            shape, own = self._shape(name), simulator.fields[name]
            if shape != own:
                raise ConfigError(
                    f"initial_states: the bank {options.file} does not fit this simulator: '{name}' is "
                    f"{shape or 'missing'} there and {own} here. Harvest it in a task of this scene."
                )
        others = [name for name in self._states if name not in simulator.state_fields]
        self.varies = tuple(name for name in others if name in simulator.parameters)
        self.episode_fields: Mapping[str, Shape] = {
            name: tuple(self._states[name].shape[1:]) for name in others if name not in self.varies
        }

    def _shape(self, name: str) -> Shape | None:
        return tuple(self._states[name].shape[1:]) if name in self._states else None

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        drawn = streams.uniform(1).squeeze(1) * len(self._counts)
        which = drawn.long().clamp(max=len(self._counts) - 1)
        count = self._counts[which]
        row = self._firsts[which] + ((drawn - which) * count).long().minimum(count - 1)
        return {name: value[row] for name, value in self._states.items()}
