"""Tries, before anything is learned, whether parts leave the fields that they read unchanged and return tensors."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.running.environment import Environment
from understudy.running.promises import calls

__all__ = ["begin"]


def begin(environment: Environment) -> dict[str, Tensor]:
    """Reset, check that each part keeps its promises, and return the first observations.

    Raises
    ------
    ConfigError
        a part returns no tensor, or writes into a field that others read; or as of
        :meth:`Environment.reset`.
    """
    try:
        observations = environment.reset()
    except (AttributeError, TypeError):  # of what is no tensor, say
        with contextlib.suppress(AttributeError, TypeError):
            _try_all(environment)
        raise  # of a part's own
    _try_all(environment)
    return observations


@torch.no_grad()
def _try_all(environment: Environment) -> None:
    table = environment.table
    for where, reads, call in calls(environment.parts, environment.action):
        given = table.pick(reads)
        versions = {name: _written(value) for name, value in given.items()}
        found = call(**given)
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
    """How often it was written into; 0 if it was made in torch's inference mode, which does not count."""
    return 0 if value.is_inference() else value._version
