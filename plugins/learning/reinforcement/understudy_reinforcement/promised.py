"""What the parts of a task do with the fields that they read, tried once before anything is learned."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.running.environment import Environment

__all__ = ["begin"]

#: What a part raises that is given tensors of other shapes than it was made for, and what is raised of its result if
#: that is no tensor.
_MISFITS = (RuntimeError, LookupError, ValueError, TypeError, AttributeError)


def begin(environment: Environment) -> dict[str, Tensor]:
    """The first observations, after a reset in which each part was found to keep to what parts promise.

    Raises
    ------
    ConfigError
        naming the part that returns no tensor, that writes into a field which others read, or that cannot use the
        field which its ``reads`` gives it.
    """
    try:
        observations = environment.reset()
    except _MISFITS:
        with contextlib.suppress(*_MISFITS):
            _try_all(environment)
        raise  # of a part's own
    _try_all(environment)
    return observations


@torch.no_grad()
def _try_all(environment: Environment) -> None:
    table = environment.table
    for where, reads, call in _parts(environment):
        given = table.pick(reads)
        versions = {name: _written(value) for name, value in given.items()}
        try:
            found = call(**given)
        except _MISFITS as error:
            other = {own: field for own, field in reads.items() if own != field}
            if not other:
                raise  # it reads what it asks for, so it is the part that is at fault
            shapes = ", ".join(
                f"{field} {list(given[own].shape[1:])}" for own, field in other.items()
            )
            raise ConfigError(
                f"{where} cannot use what its reads gives it: {shapes}. Name fields of the shape that it takes "
                "(`understudy describe --fields` lists them)."
            ) from error
        for name, version in versions.items():
            if _written(given[name]) != version:
                raise ConfigError(
                    f"{where} writes into the field '{reads[name]}', which others read: have it return a tensor of its "
                    "own, as a + b is, and a.add_(b) is not."
                )
        values = found.values() if isinstance(found, Mapping) else (found,)
        for value in values:
            if not isinstance(value, Tensor):
                raise ConfigError(
                    f"{where} returns a {type(value).__name__}: it must return a tensor, with a row for each world."
                )


def _written(value: Tensor) -> int:
    """How often it was written into; one that was made in torch's inference mode does not count that."""
    return 0 if value.is_inference() else value._version


def _parts(
    environment: Environment,
) -> Iterator[tuple[str, Mapping[str, str], Callable[..., Any]]]:
    """Of each part that is a pure function: its place in the configuration, what it reads, and the function."""
    parts = environment.parts
    for provider in parts.fields:
        yield provider.where, provider.reads, provider.part.compute
    control = parts.actuation.part.control
    yield (
        parts.actuation.where,
        parts.actuation.reads,
        lambda **given: control(environment.action, **given),
    )
    for encoder in parts.encoders.values():
        yield encoder.where, encoder.reads, encoder.part.encode
    for term in (*parts.rewards, *parts.terminations, *parts.measures):
        yield term.where, term.reads, _bound(term.function, term.options)


def _bound(function: Callable[..., Any], options: Mapping[str, Any]) -> Callable[..., Any]:
    return lambda **given: function(**given, **options)
