"""A task's fields, observations and terms, computed of a model's states as the task's own parts do."""

from __future__ import annotations

import functools
import operator
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.running.environment import OWN_FIELDS
from understudy.running.promises import Parts
from understudy.task import Box, Context, Fields
from understudy.task.terms import Term, Wired
from understudy_imagination.rigid import Posed, Rigid
from understudy_networks.policies import action_space

#: The environment's own fields that no derivative goes through: they are taken as they were.
_TAKEN = frozenset(OWN_FIELDS) - {"reward"}
#: Least share of a margin, for the derivative of a power.
_LEAST = 1e-3
_WHO = "learner 'imagination'"


@runtime_checkable
class Margin(Protocol):
    """A termination that knows how near it is: a term's class that has this beside ``__call__``, which takes
    the same fields."""

    def used(self, *args: Any, **fields: Any) -> Tensor:
        """(N, K): how much of the way to its end each of K things has gone, differentiable in the
        fields: 0 where none of it, 1 where the term begins to hold."""
        ...


class Imagined:
    """What a task makes of positions and velocities; of its encoders those of the observations `seen`.

    Fields are of three kinds: what moves with the state, which providers compute anew; what they
    compute from the clock and an episode's constants alone, once for many states; and these
    themselves, which a rollout brings.

    Raises
    ------
    ConfigError
        an encoder, the actuation, a reward or a termination reads a field that positions
        and velocities do not decide; names it.
    """

    def __init__(self, parts: Parts, context: Context, rigid: Rigid, seen: Collection[str]) -> None:
        self._parts, self._rigid = parts, rigid
        self._encoders = {name: e for name, e in parts.encoders.items() if name in seen}
        self._gives = {f: p for p in parts.fields for f in p.provides.values()}
        curriculum = parts.curriculum.provides if parts.curriculum else {}
        parameters = parts.simulator.parameters
        self._constants = {
            *_TAKEN,
            *parts.initial_states.episode_fields,
            *(name for name in curriculum if name not in parameters),
        }
        #: Whether a field moves with the state, of all that are needed.
        self._moves: dict[str, bool] = {}
        #: Providers by turns: of what does not move, and of what does.
        self._still: list[Wired[Fields]] = []
        self._moving: list[Wired[Fields]] = []
        for who, names in self._readers():
            for name in names:
                self._resolve(name, who)
        #: Fields that a rollout has to bring, beside ``qpos`` and ``qvel``.
        self.taken = tuple(n for n in self._moves if n in self._constants)
        space = action_space(context, _WHO)
        self._boxes = [part for part in space.parts.values() if isinstance(part, Box)]
        if len(self._boxes) < len(space.parts):
            raise ConfigError(
                f"{_WHO} needs actions that are numbers, and this task's have choices. Choose learner=ppo."
            )
        reach = [torch.as_tensor(b.reach).expand(b.size) for b in self._boxes]
        #: (A,) what counts as one unit of each number of an action.
        self.reach = torch.cat(reach).float().to(context.device)
        #: Per box: the field that says its middle, or the middle (size,) itself.
        self._middles = [
            around
            if isinstance(around := box.around, str)
            else torch.tensor(
                around if around is not None else [0.0] * box.size,
                dtype=torch.float32,
                device=context.device,
            )
            for box in self._boxes
        ]
        #: Terminations that are to be kept away from, and say how near they are.
        self.margins = [
            term
            for term in parts.terminations
            if isinstance(term.function, Margin) and term.outcome in ("failure", "report")
        ]
        #: Terms without a derivative, by their places in the configuration.
        self.flat = (
            *(t.where for t in parts.terminations if t not in self.margins),
            *(t.where for t in parts.rewards if not self._smooth(t)),
        )
        self._rewarding = any(self._smooth(t) for t in parts.rewards)
        if not self.margins and not self._rewarding:
            raise ConfigError(
                f"{_WHO} needs a term with a derivative, and this task has none: no termination says how near "
                "it is, and no reward depends on more than whether the episode failed. Choose learner=ppo."
            )

    def _readers(self) -> Iterator[tuple[str, Sequence[str]]]:
        parts = self._parts
        for part in (parts.actuation, *self._encoders.values()):
            yield part.where, tuple(part.reads.values())
        for term in (*parts.rewards, *parts.terminations):
            yield term.where, tuple(term.reads.values())
        for part in parts.actuation.part.action_space.parts.values():
            if isinstance(part, Box) and isinstance(part.around, str):
                yield "actuation", (part.around,)

    def _resolve(self, name: str, who: str) -> bool:
        """Whether the field moves with the state; notes what provides it."""
        if name in self._moves:
            return self._moves[name]
        provider = self._gives.get(name)
        if name in self._rigid.fields or name == "action":
            self._moves[name] = True
        elif name in self._constants:
            self._moves[name] = False
        elif provider is not None:
            moves = [self._resolve(read, who) for read in provider.reads.values()]
            self._moves |= dict.fromkeys(provider.provides.values(), any(moves))
            (self._moving if any(moves) else self._still).append(provider)
        else:
            raise ConfigError(
                f"{_WHO} needs fields that positions and velocities decide, and {who} reads '{name}', "
                f"which they do not. Choose learner=ppo, or leave {who} out of the task."
            )
        return self._moves[name]

    def _smooth(self, term: Term) -> bool:
        """Whether the term's value may have a derivative."""
        return any(self._moves[name] for name in term.reads.values())

    def constants(self, taken: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """All fields (B, …) that do not move with the state, of what rollouts brought (B, …)."""
        values = {name: taken[name] for name in self.taken}
        for provider in self._still:
            _provide(provider, values)
        return values

    def fields(
        self, posed: Posed, constants: Mapping[str, Tensor], action: Tensor
    ) -> dict[str, Tensor]:
        """All fields (B, …)."""
        values = {**constants, "action": action}
        for name in self._moves:
            if name in self._rigid.fields:
                values[name] = posed.field(name)
        for provider in self._moving:
            _provide(provider, values)
        return values

    def observations(self, fields: Mapping[str, Tensor]) -> dict[str, Tensor]:
        return {
            name: encoder.part.encode(**_picked(encoder.reads, fields))
            for name, encoder in self._encoders.items()
        }

    def control(self, action: Tensor, fields: Mapping[str, Tensor]) -> Tensor:
        actuation = self._parts.actuation
        return actuation.part.control(action, **_picked(actuation.reads, fields))

    def offset(self, action: Tensor, fields: Mapping[str, Tensor]) -> Tensor:
        """`action` (B, A) from the middle of its space, in units of its reach."""
        middles = [
            fields[m] if isinstance(m, str) else m.expand(len(action), -1) for m in self._middles
        ]
        return (action - torch.cat(middles, dim=1)) / self.reach

    def reward(self, fields: Mapping[str, Tensor]) -> Tensor | None:
        """(B,), as the task combines it; None if it has no derivative."""
        if not self._rewarding:
            return None
        values = [(_evaluated(term, fields), term.weight) for term in self._parts.rewards]
        if self._parts.combine == "sum":
            return functools.reduce(operator.add, [v * weight for v, weight in values])
        return functools.reduce(operator.mul, [v if w == 1.0 else v**w for v, w in values])

    def used(self, fields: Mapping[str, Tensor], norm: float, power: float) -> Tensor:
        """(B,): of each margin, the `norm` over its things of what is used of it, to the `power`;
        their sum."""
        total = torch.zeros(len(fields["action"]), device=self.reach.device)
        for term in self.margins:
            margin = term.function
            assert isinstance(margin, Margin)
            share = margin.used(**_picked(term.reads, fields), **term.options)
            most = share.abs().clamp(min=_LEAST).pow(norm).sum(1).pow(1.0 / norm)
            total = total + most.pow(power)
        return total


def _provide(provider: Wired[Fields], values: dict[str, Tensor]) -> None:
    given = provider.part.compute(**_picked(provider.reads, values))
    values.update({field: given[own] for own, field in provider.provides.items()})


def _picked(reads: Mapping[str, str], fields: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {parameter: fields[name] for parameter, name in reads.items()}


def _evaluated(term: Term, fields: Mapping[str, Tensor]) -> Tensor:
    return term.function(**_picked(term.reads, fields), **term.options)
