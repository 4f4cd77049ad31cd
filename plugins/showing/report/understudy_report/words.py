"""Numbers and other values in words."""

from __future__ import annotations

import json
from typing import Any

__all__ = ["duration", "share", "short", "text"]


def text(value: Any) -> str:
    """`value` on one line: lists as words, everything else as JSON would say it."""
    if isinstance(value, str):
        return value
    if isinstance(value, list | tuple):
        return ", ".join(map(text, value))
    if isinstance(value, float):
        return f"{value:g}"
    return json.dumps(value, ensure_ascii=False, default=str)


def share(value: float) -> str:
    """A share in percent. Only exact zeros and ones are 0 % and 100 %."""
    percent = 100 * value
    if round(percent) in (0, 100) and value not in (0.0, 1.0):
        percent = min(max(round(percent, 1), 0.1), 99.9)
        return f"{percent:.1f} %"
    return f"{percent:.0f} %"


def duration(seconds: float) -> str:
    """Seconds in the unit that suits them."""
    for unit, size in (("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.1f} s"


def short(value: float) -> str:
    """`value` in three digits, such as ``614k``."""
    for suffix, size in (("G", 999.5e6), ("M", 999.5e3), ("k", 999.5)):
        if abs(value) >= size:
            return f"{value / (size / 0.9995):.3g}{suffix}"
    return f"{value:.3g}"
