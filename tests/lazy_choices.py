"""Hydra makes a table of all choices for each file of options that it reads, for those of its words that refer to other
choices (``${…}``); in tests it makes it when the first such word is resolved: a composition takes a third less of processor time.

What it is then, and so what is composed, are as without; a fresh interpreter composes as users' do.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator
from typing import Any

from hydra._internal import defaults_list
from hydra.core.default_element import InputDefault
from omegaconf import DictConfig

_table = defaults_list._create_interpolation_map
_resolve = InputDefault._resolve_interpolation_impl


def _when_asked(*of: Any) -> Callable[[], DictConfig]:
    return functools.cache(lambda: _table(*of))


def _resolved(self: InputDefault, known: Any, value: str | None) -> str:
    return _resolve(self, known(), value)


def use() -> None:
    """From here on, in this process and its forks."""
    hidden: Any = defaults_list
    hidden._create_interpolation_map = _when_asked
    InputDefault._resolve_interpolation_impl = _resolved  # type: ignore[method-assign]


@contextlib.contextmanager
def not_used() -> Iterator[None]:
    """Inside, Hydra makes them as it does."""
    hidden: Any = defaults_list
    hidden._create_interpolation_map = _table
    InputDefault._resolve_interpolation_impl = _resolve  # type: ignore[method-assign]
    try:
        yield
    finally:
        use()
