"""Ranges of the options of terms that are functions, checked as a configuration is composed."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, TypeVar

from understudy.options import as_yaml, check_range

__all__ = ["ANGLE", "DEGREES", "check_angle", "check_degrees", "in_degrees", "limits"]

ANGLE = (0.0, 2.0 * math.pi)
"""rad, of an option that says how far something may turn, for :func:`limits`."""

DEGREES = (2.0, 180.0)
"""The same in degrees."""

T = TypeVar("T", bound=Callable[..., Any])


def check_angle(options: Any, *names: str, least: float = -ANGLE[1]) -> None:
    """For the ``__post_init__`` of a dataclass of options: a ValueError unless each of the options `names`, rad, each value of
    a tuple alike, is None, or at least `least` and at most a whole turn. What is more is mostly in degrees."""
    for name in names:
        given = getattr(options, name)
        for value in given if isinstance(given, tuple) else (given,):
            if value is not None and ANGLE[1] < abs(value) < math.inf:
                raise ValueError(f"{name}={as_yaml(given)} is not possible: {in_degrees(value)}")
    check_range(options, *names, least=least, most=ANGLE[1])


def check_degrees(options: Any, *names: str, most: float = 180.0) -> None:
    """As :func:`check_angle`, of options that say in degrees how far something may turn, above 0 and at most `most`: less than
    two are mostly rad."""
    check_range(options, *names, above=0, most=most)
    for name in names:
        if (value := getattr(options, name)) is not None and value < 2.0:
            raise ValueError(
                f"{name}={value:g} is not possible: it must be at least 2 degrees; if {value:g} are rad, give {math.degrees(value):.4g}."
            )


def in_degrees(value: float) -> str:
    """What is wrong with an angle of `value` rad, which is more than a whole turn."""
    return f"it must be at most {ANGLE[1]:.3f} rad, a whole turn; if {value:g} are degrees, give {math.radians(value):.4g}."


def limits(**options: tuple[float, float]) -> Callable[[T], T]:
    """Declares between which values the `options` of a term, a function, lie: the least and the most of each, of a
    tuple's values alike. What a configuration has beyond is refused by its key path; None is not looked at. Options called ``least`` and ``most`` are a range: exchanged, a
    term would mean its opposite."""

    def check(**given: Any) -> None:
        for name, (least, most) in options.items():
            if (least, most) == DEGREES:
                check_degrees(SimpleNamespace(**given), name)
            elif (least, most) == ANGLE:
                check_angle(SimpleNamespace(**given), name, least=least)
            else:
                check_range(SimpleNamespace(**given), name, least=least, most=most)
        if {"least", "most"} <= options.keys() and not given["least"] < given["most"]:
            raise ValueError(
                f"least={given['least']:g} is not possible: it must be less than most={given['most']:g}."
            )

    def declare(term: T) -> T:
        term.limits = check  # type: ignore[attr-defined]
        return term

    return declare
