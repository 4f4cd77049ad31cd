"""The parts of a task, and checks that they return what they promise."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.running.table import FieldTable
from understudy.task import (
    Actuation,
    Curriculum,
    Encoder,
    Fields,
    InitialStates,
    Memory,
    Shape,
    Simulator,
)
from understudy.task.terms import Term, Wired

__all__ = ["MISFITS", "Parts", "calls", "returned"]


@dataclass
class Parts:
    """The built parts of a task, each with the fields that it reads."""

    simulator: Simulator
    actuation: Wired[Actuation]
    initial_states: InitialStates
    encoders: Mapping[str, Wired[Encoder]]
    rewards: Sequence[Term]
    terminations: Sequence[Term] = ()
    measures: Sequence[Term] = ()
    fields: Sequence[Wired[Fields]] = ()
    memories: Mapping[str, Wired[Memory]] = field(default_factory=dict)
    curriculum: Curriculum | None = None
    combine: Literal["sum", "product"] = "product"


def check(num_worlds: int, who: str, value: Tensor, shape: Shape) -> None:
    """Raise :class:`ConfigError` unless `value` has one row of `shape` for each world."""
    if tuple(value.shape) != (num_worlds, *shape):
        raise ConfigError(
            f"{who} has shape {tuple(value.shape)}; it must be {(num_worlds, *shape)}, "
            f"one row of shape {list(shape)} per world."
        )


def returned(
    num_worlds: int,
    where: str,
    shapes: Mapping[str, Shape],
    given: Mapping[str, Tensor],
    what: str = "",
) -> None:
    """Raise :class:`ConfigError` unless all that has a shape is given, and has it."""
    for name, shape in shapes.items():
        if name not in given:
            raise ConfigError(f"{where} promises {what}'{name}' and does not return it.")
        check(num_worlds, f"{what}'{name}' of {where}", given[name], shape)


def check_initial(
    parts: Parts, num_worlds: int, varied: Sequence[str], given: Mapping[str, Tensor]
) -> None:
    """Check that initial states and curriculum return what they promised, with the parameters that
    are `varied`, and nothing else."""
    simulator = parts.simulator
    promised = {
        **{name: simulator.fields[name] for name in simulator.state_fields},
        **{name: simulator.parameters[name] for name in varied},
        **parts.initial_states.episode_fields,
        **(parts.curriculum.provides if parts.curriculum else {}),
    }
    returned(num_worlds, "initial_states", promised, given)
    for name in given.keys() - promised.keys():
        raise ConfigError(
            f"initial_states returns '{name}', which is no state of this simulator and not "
            f"among its episode_fields. It takes: {', '.join(sorted(promised))}."
        )


#: A part's place in the configuration, the fields that it reads, and the function of these.
Call = tuple[str, Mapping[str, str], Callable[..., Any]]
#: What a part may raise when it is given tensors of other shapes than it was made for.
MISFITS = (RuntimeError, LookupError, ValueError, TypeError, AttributeError)


def calls(parts: Parts, action: Tensor) -> Iterator[Call]:
    """Each part that is a pure function; `action` (N, A)."""
    for provider in parts.fields:
        yield provider.where, provider.reads, provider.part.compute
    yield (acts := parts.actuation).where, acts.reads, functools.partial(acts.part.control, action)
    for encoder in parts.encoders.values():
        yield encoder.where, encoder.reads, encoder.part.encode
    for term in (*parts.rewards, *parts.terminations, *parts.measures):
        yield term.where, term.reads, functools.partial(term.function, **term.options)


@torch.no_grad()
def name_misfit(parts: Parts, table: FieldTable, action: Tensor) -> None:
    """Call every part; a ConfigError for one that cannot use the fields that its ``reads`` names
    for it. A part that fails although nothing is renamed raises its own error."""
    for where, reads, call in calls(parts, action):
        given: dict[str, Tensor] = {}
        try:
            given |= table.pick(reads)
            call(**given)
        except MISFITS as error:
            other = {own: field for own, field in reads.items() if own != field}
            if reads and not given:
                continue  # the part that provides a field failed, which has its own turn
            shapes = [f"{field} {list(given[own].shape[1:])}" for own, field in other.items()]
            if not other or isinstance(error, torch.OutOfMemoryError):
                raise  # it got the fields that it asks for, so the fault is its own
            raise ConfigError(
                f"{where} cannot use what its reads gives it: {', '.join(shapes)}. Name fields of the "
                "shape that it takes (`understudy describe --fields` lists them), and options that fit."
            ) from error


def check_shapes(parts: Parts, table: FieldTable, action: Tensor) -> None:
    """Check the shape of all that parts return, once; `action` (N, A)."""
    n = len(action)
    for provider in parts.fields:
        given = provider.part.compute(**table.pick(provider.reads))
        returned(n, provider.where, provider.part.provides, given, "the field ")
    control = parts.actuation.part.control(action, **table.pick(parts.actuation.reads))
    check(n, "the control of actuation", control, (parts.simulator.control_size,))
    for encoder in parts.encoders.values():
        value = encoder.part.encode(**table.pick(encoder.reads))
        check(n, encoder.where, value, encoder.part.shape)
        if (names := encoder.part.columns) and (len(names),) != encoder.part.shape:
            raise ConfigError(
                f"{encoder.where} names {len(names)} columns; its shape is {encoder.part.shape}."
            )
    for term in (*parts.rewards, *parts.terminations, *parts.measures):
        value = term.function(**table.pick(term.reads), **term.options)
        check(n, term.where, value, ())
        if term in parts.terminations and value.dtype != torch.bool:
            raise ConfigError(f"{term.where} returns {value.dtype}; it must return bool.")
