"""Times in a column: seconds, clocks, dates, and counts since 1970."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import datetime, timedelta

from understudy_motion.readers.text import is_number, shown

_CLOCK = re.compile(
    r"(?:(\d+) days?,? )?(?:(\d+):)?(\d+):(\d\d?(?:[.,]\d+)?)",
)
"""Days, hours, minutes and seconds."""

_COUNTED = 10**11
"""A time beyond it is no number of seconds, but a computer's count of parts of them since 1970."""


def is_plain_time(word: str) -> bool:
    """Whether `word` is a number that is a time as it is."""
    return is_number(word) and abs(float(word)) < _COUNTED


def since_first(words: Sequence[str], unit: float = 1.0) -> list[float]:
    """The times of a column, since the first of them, in a `unit` of so many s: of dates and clocks (ISO 8601,
    ``10:00:01.5``), and of counts since 1970, which are of milli-, micro- or nanoseconds by their size if the unit
    is the second.

    Raises
    ------
    ValueError
        one of them is none, or of another kind than the first; it says which, and what to write.
    """
    counts = bool(words) and words[0].isdecimal()
    times = list[int]()
    for word in words:
        time = _count(word) if counts else _microseconds(word)
        if time is None:
            raise ValueError(
                f"{shown(word)} is no time; write seconds, as 0.033, or a date and time of ISO 8601"
            )
        times.append(time)
    per = 1e6 * unit
    if counts:
        size = times[0]
        by_size = 1e3 if size < 10**14 else 1e6 if size < 10**17 else 1e9
        per = by_size if unit == 1.0 else 1.0
    return [(time - times[0]) / per for time in times]


def _count(word: str) -> int | None:
    return int(word) if word.isascii() and word.isdecimal() and len(word) < 25 else None


def _microseconds(word: str) -> int | None:
    """That a date, or a clock, says."""
    if clock := _CLOCK.fullmatch(word):
        days, hours, minutes = (int(part or 0) for part in clock.groups()[:3])
        seconds = float(clock[4].replace(",", "."))
        return 60_000_000 * (60 * (24 * days + hours) + minutes) + round(1e6 * seconds)
    try:
        date = datetime.fromisoformat(word)
    except ValueError:
        return None
    return (date - datetime(2000, 1, 1, tzinfo=date.tzinfo)) // timedelta(microseconds=1)
