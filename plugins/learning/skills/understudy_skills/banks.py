"""Episodes that begin where episodes of another run ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from torch import Tensor

from understudy.errors import ConfigError
from understudy.random import WorldStreams
from understudy.task import Context, InitialStates, Shape
from understudy_skills import bank


class Bank(InitialStates):
    """States drawn uniformly from a bank (:mod:`understudy_skills.bank`).

    Evaluations begin in every fifth of them, in which no training does.

    What the bank has beside the simulator's state: its parameters vary between worlds again, all
    else is readable as a field of the same name, constant over the episode.
    """

    @dataclass(frozen=True)
    class Options:
        file: str  #: the bank, or the folder of the run that has one
        leave: tuple[str, ...] = ()  #: fields of the bank that the task takes from elsewhere

    def __init__(self, options: Options, context: Context) -> None:
        simulator = context.simulator
        assert simulator is not None
        states = bank.starts(options.file, context, "initial_states", options.leave)
        self._states = {name: value.to(context.device) for name, value in states.items()}
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
        count = len(next(iter(self._states.values())))
        row = (streams.uniform(1).squeeze(1) * count).long().clamp(max=count - 1)
        return {name: value[row] for name, value in self._states.items()}
