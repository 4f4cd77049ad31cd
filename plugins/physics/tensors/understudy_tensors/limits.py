"""Ranges of the options of terms that are functions, checked as a configuration is composed."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, TypeVar

from understudy.options import check_range

__all__ = ["limits"]

T = TypeVar("T", bound=Callable[..., Any])


def limits(**options: tuple[float, float]) -> Callable[[T], T]:
    """Declares between which values the `options` of a term, a function, lie: the least and the most of each, of a
    tuple's values alike. What a configuration has beyond is refused by its key path; None is not looked at. Options called ``least`` and ``most`` are a range: exchanged, a
    term would mean its opposite."""

    def check(**given: Any) -> None:
        for name, (least, most) in options.items():
            check_range(SimpleNamespace(**given), name, least=least, most=most)
        if {"least", "most"} <= options.keys() and not given["least"] < given["most"]:
            raise ValueError(
                f"least={given['least']:g} is not possible: it must be less than most={given['most']:g}."
            )

    def declare(term: T) -> T:
        term.limits = check  # type: ignore[attr-defined]
        return term

    return declare
