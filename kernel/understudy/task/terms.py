"""Terms: rewards, terminations and measures, each a named pure function of the state."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar

from understudy.errors import ConfigError, suggestion

if TYPE_CHECKING:
    from torch import Tensor

__all__ = ["Reduction", "Term", "Wired", "ranges", "renamed"]

T = TypeVar("T")

#: What a termination term that fires does to the episode; ``report`` only reports it.
Outcome = Literal["failure", "truncation", "success", "report"]

#: How a measure's values over an episode become one number.
Reduction = Literal["last", "min", "max", "mean", "sum", "any"]


@dataclass(frozen=True)
class Wired(Generic[T]):
    """A part of a task, with the fields that it reads and provides under names of its own."""

    where: str  #: its key path in the configuration, for errors
    part: T
    reads: Mapping[str, str] = field(default_factory=dict)  #: its own name → the field's
    provides: Mapping[str, str] = field(default_factory=dict)  #: its own name → the field's


def renamed(
    where: str, option: str, names: tuple[str, ...], other: Mapping[str, str]
) -> dict[str, str]:
    """The field for each of `names`: that of the same name, unless `other` maps it to another. A
    ConfigError if it maps something that is none of `names`."""
    for name in other:
        if name not in names:
            raise ConfigError(
                f"{where}.{option}: there is no field '{name}' to rename.{suggestion(name, names)}"
            )
    return {name: other.get(name, name) for name in names}


def ranges(low: float, high: float) -> Callable[[T], T]:
    """Declares the range of a reward term. A product of rewards refuses what can be negative."""

    def declare(term: T) -> T:
        term.range = (low, high)  # type: ignore[attr-defined]
        return term

    return declare


def parameters_of(function: Callable[..., Any]) -> dict[str, bool]:
    """The fields that a term's function reads, which are its positional parameters, in order; and
    whether each is optional, because it has a default."""
    return {
        p.name: p.default is not p.empty
        for p in inspect.signature(function).parameters.values()
        if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)
    }


@dataclass(frozen=True)
class Term:
    """A term with its options bound. ``function`` is called with the fields of ``reads``."""

    where: str  #: its key path in the configuration, for errors
    name: str
    function: Callable[..., Tensor]
    options: Mapping[str, Any] = field(default_factory=dict)
    reads: Mapping[str, str] = field(default_factory=dict)  #: parameter → field
    optional: frozenset[str] = frozenset()  #: parameters that the task need not have a field for
    weight: float = 1.0  #: of a reward: its factor in a sum, its exponent in a product
    outcome: Outcome = "failure"  #: of a termination
    reduce: Reduction = "last"  #: of a measure


def make_term(
    where: str,
    name: str,
    function: Callable[..., Any],
    options: Mapping[str, Any],
    *,
    reads: Mapping[str, str],
    **counts: Any,
) -> Term:
    """The term `name` of `function`, whose parameters `reads` may rename."""
    parameters = parameters_of(function)
    wired = renamed(where, "reads", tuple(parameters), reads)
    optional = frozenset(name for name, left_out in parameters.items() if left_out)
    return Term(where, name, function, options, wired, optional, **counts)
