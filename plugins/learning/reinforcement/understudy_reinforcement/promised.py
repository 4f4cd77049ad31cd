"""Tries, before anything is learned, whether parts leave the fields that they read unchanged and return tensors."""

from __future__ import annotations

import contextlib
import inspect
import numbers
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.random import WorldStreams
from understudy.running.environment import Environment
from understudy.running.promises import MISFITS, calls, returned
from understudy.task import Curriculum, Shape
from understudy.task.terms import Wired

__all__ = ["begin"]


def begin(environment: Environment) -> dict[str, Tensor]:
    """Reset, check that each part keeps its promises, and return the first observations.

    Raises
    ------
    ConfigError
        a part returns no tensor, or writes into a field that others read; or as of
        :meth:`Environment.reset`.
    """
    _check_calls(environment)
    try:
        observations = environment.reset()
    except MISFITS:  # of what is no tensor, say
        with contextlib.suppress(*MISFITS):
            _draw(environment)
            _try_memories(environment)
            _try_all(environment)
        raise  # of a part's own
    _try_memories(environment)
    _try_all(environment)
    return observations


def _check_calls(environment: Environment) -> None:
    """Raise :class:`ConfigError` for a part that does not take what it is called with."""
    parts, one = environment.parts, environment.action
    wired: list[tuple[Wired[Any], Callable[..., Any], tuple[Any, ...]]] = []
    wired += [(p, p.part.compute, ()) for p in parts.fields]
    wired += [(e, e.part.encode, ()) for e in parts.encoders.values()]
    acts = parts.actuation
    wired.append((acts, acts.part.control, (one,)))
    if acts.part.keeps:
        wired += [(acts, acts.part.begin, ()), (acts, acts.part.advance, (one,))]
    for memory in parts.memories.values():
        wired += [(memory, memory.part.begin, ()), (memory, memory.part.advance, ({},))]
    for part, method, given in wired:
        names = [*part.reads, *(["uniforms"] if getattr(part.part, "uniforms", 0) else [])]
        _check_call(part.where, method, given, names)
    initial = parts.initial_states
    _check_call("initial_states", initial.sample, (one,), initial.reads)


def _check_call(where: str, method: Any, given: Sequence[Any], names: Sequence[str]) -> None:
    try:
        inspect.signature(method).bind(*given, **dict.fromkeys(names))
    except TypeError as error:
        read = ", ".join(names) or "no field"
        raise ConfigError(
            f"{where} says that it reads {read}, and its {method.__name__} does not take that: {error}."
        ) from error


@torch.no_grad()
def _draw(environment: Environment) -> None:
    """What episodes begin with, drawn once more where it could not be begun; a ConfigError for what is no state."""
    parts, like = environment.parts, environment.action
    streams = WorldStreams(0, "promised", len(like), like.device)
    given: dict[str, Tensor] = {}
    if curriculum := parts.curriculum:
        given |= _by_name("curriculum", curriculum.begin(streams), curriculum.provides, like)
    initial, fields = parts.initial_states, {**environment.table.values, **given}
    unset = like.new_zeros(len(like))
    drawn = initial.sample(streams, **{name: fields.get(name, unset) for name in initial.reads})
    _by_name("initial_states", drawn, initial.episode_fields, like)


@torch.no_grad()
def _try_memories(environment: Environment) -> None:
    """What memories keep at the beginning and from then on."""
    like = environment.action
    streams = WorldStreams(0, "promised", len(like), like.device)
    for memory in environment.parts.memories.values():
        count, keeps = memory.part.uniforms, memory.part.keeps
        taken = environment.table.pick(memory.reads)
        taken |= {"uniforms": streams.uniform(count)} if count else {}
        begun = _by_name(memory.where, memory.part.begin(**taken), keeps, like)
        _by_name(memory.where, memory.part.advance(begun, **taken), keeps, like)


def _by_name(
    where: str, given: Any, shapes: Mapping[str, Shape], like: Tensor
) -> Mapping[str, Tensor]:
    """What is `given`, tensors by name, of which those that have `shapes` are all there, for all worlds of `like`."""
    if not isinstance(given, Mapping):
        raise ConfigError(
            f"{where} returns a {type(given).__name__}: it must return tensors by name."
        )
    for name, value in given.items():
        _check_tensor(f"{where} returns '{name}' as", "each must be", value, like)
    returned(len(like), where, shapes, given)
    return given


def _check_tensor(who: str, must: str, value: Any, like: Tensor) -> None:
    """Raise :class:`ConfigError` unless `value` is a tensor of plain numbers where `like` is."""
    if not isinstance(value, Tensor):
        raise ConfigError(
            f"{who} a {type(value).__name__}: {must} a tensor, with a row for each world."
        )
    if value.device != like.device or value.layout != like.layout or value.is_complex():
        raise ConfigError(
            f"{who} {value.dtype}, {value.layout}, on {value.device}: {must} of real numbers, strided, on {like.device}."
        )


@torch.no_grad()
def _try_all(environment: Environment) -> None:
    table, parts = environment.table, environment.parts
    of_fields = {provider.where for provider in parts.fields}
    of_numbers = {part.where for part in (*parts.encoders.values(), parts.actuation)}
    for where, reads, call in calls(parts, environment.action):
        given = table.pick(reads)
        versions = {name: _written(value) for name, value in given.items()}
        found = call(**given)
        for name, version in versions.items():
            if _written(given[name]) != version:
                raise ConfigError(
                    f"{where} writes into the field '{reads[name]}', which others read: have it return a tensor of its "
                    "own, as a + b is, and a.add_(b) is not."
                )
        several = isinstance(found, Mapping) and where in of_fields
        values: Iterable[Any] = found.values() if several else (found,)
        for value in values:
            _check_tensor(f"{where} returns", "it must return", value, environment.action)
            dtype = getattr(value, "dtype", None)
            if where in of_numbers and dtype != torch.float32:
                raise ConfigError(f"{where} returns {dtype}; it must return float32.")


def _written(value: Tensor) -> int:
    """How often it was written into; 0 if it was made in torch's inference mode, which does not count."""
    return 0 if value.is_inference() else value._version


def figures(where: str, given: Any) -> dict[str, Any]:
    """What a part gives as metrics: numbers by name, tensors of one number among them.

    Raises
    ------
    ConfigError
        naming the part, and what of it is no number.
    """
    if not isinstance(given, Mapping):
        raise ConfigError(
            f"{where} returns a {type(given).__name__}: it must return numbers by name."
        )
    found: dict[str, Any] = {}
    for name, value in given.items():
        number = value.item() if isinstance(value, Tensor) and value.numel() == 1 else value
        if not isinstance(name, str) or not isinstance(number, numbers.Real):
            raise ConfigError(
                f"{where} returns {name!r} as a {type(value).__name__}: it must return numbers by name."
            )
        found[name] = number if type(number) in (int, bool) else float(number)
    return found


def check_curriculum(curriculum: Curriculum | None) -> None:
    """Raise :class:`ConfigError` for a curriculum that says of itself what nobody can use."""
    if curriculum is not None:
        stage(curriculum)
        decision = curriculum.decision()
        if decision is not None and not (type(decision) is int and decision > 0):
            raise ConfigError(
                f"curriculum has decisions of {decision!r} control periods: it must be a whole number from 1, or None."
            )


def stage(curriculum: Curriculum) -> str:
    """Where it stands, in words."""
    if not isinstance(words := curriculum.stage(), str):
        raise ConfigError(
            f"curriculum says where it stands by a {type(words).__name__}: it must be text."
        )
    return words
