"""The part of a BVH from MOTION on: the time between frames, and their numbers; see :mod:`understudy_motion.readers.bvh`."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from understudy.errors import FileError
from understudy_motion.limits import check_size
from understudy_motion.readers.bvh_hierarchy import REMARK, Joint
from understudy_motion.readers.text import is_number, number_rows, shown

SLOWEST = 1.0
"""s between frames: more is a rate, or milliseconds, where seconds belong."""

_NUMBER = re.compile(r"[-+]?\.?[0-9]|[-+]?(nan|inf)", re.IGNORECASE)
"""How a line of a frame begins."""

_SAID = re.compile(
    r"(frames(?![\s_-]*(?:time|rate))|frames?[\s_-]*time|(?:frames?|sample)[\s_-]*rate|fps)\b"
    r"(?:\s*[\[(]\s*(ms|us|µs|s)\w*\s*[\])])?[\s:=]*(\S*(?:\s*/\s*\S+)?(?:\s*(?:[mµu]?s|sec\w*|milli\w*|micro\w*|fps|hz)\b)?)",
    re.IGNORECASE,
)
"""A line, or a part of it, between MOTION and the numbers: what it says, in which unit, and the value."""

_VALUE = re.compile(
    r"([^a-zµ/]*?(?:e[-+]?[0-9]+)?)(?:\s*/\s*([0-9.]+))?\s*(?:(fps|hz)|(s|f|mic|mil|ms|us|µs))?[a-z]*[.,;]?",
    re.IGNORECASE,
)
"""A number or a fraction, and its unit of times or of rates."""
_PARTS = {"ms": 1e3, "mil": 1e3, "us": 1e6, "µs": 1e6, "mic": 1e6}
"""In a second, by what a unit begins with."""


def read_motion(
    path: Path,
    lines: Sequence[str],
    start: int,
    joints: Sequence[Joint],
    parts: Sequence[tuple[int, tuple[tuple[str, int], ...]]],
    rate: float | None,
) -> tuple[float, list[np.ndarray]]:
    """Seconds per frame, and of each joint the values (F, channels) in the file's order.

    Where the `rate` is given the file need not say it, and what it says does not matter.
    """
    count, interval, odd = None, None, ""
    lines = _said_in_one(lines, start)
    head = [
        (i, REMARK.sub("", line))
        for i, line in itertools.takewhile(
            lambda said: not said[1] or _is_word(said[1].split()[0]),
            enumerate(lines[start : start + 100], start),
        )
        if line
    ]
    for i, word, unit, said in [(i, *said) for i, line in head for said in _SAID.findall(line)]:
        if word.lower() != "frames":
            interval = (i, _seconds(said, unit, word.lower().endswith("time")), said)
        elif number := re.match(r"\+?([0-9]{1,18})(\.0*)?(?:\s|$)|-1$", said):
            count = (i, int(number[1] or 0))  # 0 and -1 of programs that cannot know it yet
        elif said:
            odd = f", and 'Frames' is {shown(said)}"
    last = head[-1][0] if head else start - 1
    unsaid = count is None and any(
        w.lower() == "frames" for _, line in head for w, _, _ in _SAID.findall(line)
    )
    if (interval is None and rate is None) or unsaid:
        raise FileError(
            f"Clip {path}: line {max(last, start) + 1}: 'Frames: <count>' and 'Frame Time: <seconds>' are "
            f"expected after MOTION{odd}; the rate can also be given as motion.rate (--source-rate)."
        )
    seconds = 1.0 / rate if rate else 0.0
    if interval and not rate:
        seconds = interval[1]
        if not 1e-6 <= seconds <= SLOWEST:
            raise FileError(
                f"Clip {path}: line {interval[0] + 1}: 'Frame Time' must be seconds above 0 and up to {SLOWEST:g}, not "
                f"{shown(interval[2])}; or give motion.rate (--source-rate)."
            )
    columns = sum(len(channels) for _, channels in parts)
    if not any(joint.channels for joint in joints):
        raise FileError(f"Clip {path}: no joint has channels, so nothing moves.")
    body = lines[last + 1 :]
    if any(sign in line for line in body for sign in ("#", "//")):
        body = [REMARK.sub("", line) for line in body]
    body = _without_end(path, body, last + 2, columns)
    frames = sum(1 for line in body if line)
    if frames == 0:
        raise FileError(f"Clip {path}: no frame follows MOTION.")
    if count is not None and frames != count[1] > 0:
        body = _rejoined(body, count[1], columns)
        frames = sum(1 for line in body if line)
    if count is not None and frames != count[1] > 0:
        raise FileError(
            f"Clip {path}: line {count[0] + 1}: {count[1]} frames are announced, but "
            f"{frames} lines of numbers follow. Export or fetch it again; if these are all, write their number there."
        )
    check_size(path, frames, [joint.name for joint in joints])
    if any(";" in line for line in body):
        body = [line.replace(";", " ") for line in body]
    if any("," in line for line in body):  # between numbers, or within
        whole = next(line for line in body if line)
        apart = any("." in line for line in body) or len(whole.split()) != columns
        mark = " " if apart else "."
        body = [line.replace(",", mark) for line in body]
    values = number_rows(path, body, last + 2, columns)
    found = [np.empty((frames, 0)) for _ in joints]
    at = 0
    for joint, channels in parts:
        own = values[:, at : at + len(channels)]
        at += len(channels)
        if joint >= 0:
            found[joint] = own
            continue
        tip = np.zeros(3)  # an end turns nothing, and its place replaces its OFFSET
        for column, (kind, axis) in enumerate(channels):
            if kind == "position":
                tip[axis] = np.median(own[:, column])
        if tip.any():
            joints[-1 - joint].tip = tuple(tip.tolist())
    return seconds, found


def _seconds(said: str, unit: str, time: bool) -> float:
    """Between frames, of what is `said`, a time (in a `unit`, if that is named beside it) or else a rate; 0 if it
    is no number."""
    if not (found := _VALUE.fullmatch(said.strip())):
        return 0.0
    above, below, rate, own = found.groups()
    parts = [p.strip(" ,;").replace(",", ".") for p in (above, below or "1")]
    if not all(map(is_number, parts)) or not float(parts[1]):
        return 0.0
    number = float(parts[0]) / float(parts[1])
    if time and not rate:
        return number / _PARTS.get((own or unit).lower(), 1.0)
    return 1.0 / number if number else 0.0


def _is_word(word: str) -> bool:
    """Whether a line that begins with it has no numbers of a frame."""
    return word[0].isalpha() and word.lower() not in ("nan", "inf", "infinity")


def _said_in_one(lines: Sequence[str], start: int) -> Sequence[str]:
    """`lines` with a value, or the rest of its name, that stands in the line below it beside its name."""
    joined = list(lines)
    words = [i for i, line in enumerate(lines[start : start + 100], start) if line]
    for i, below in itertools.pairwise(words):
        alone = re.fullmatch(r"frame|(.*frame[\s_]*time|frames)[\s:=]*", joined[i], re.IGNORECASE)
        value = is_number(joined[below]) or joined[below].lower().startswith("time")
        if alone and value:
            joined[below], joined[i] = f"{joined[i]} {joined[below]}", ""
    return joined


def _without_end(path: Path, body: Sequence[str], first: int, columns: int) -> Sequence[str]:
    """`body`, whose first line is the file's line `first`, without what stands below its frames."""
    end = next((i for i, line in enumerate(body) if line and not _NUMBER.match(line)), None)
    if end is None:
        return body
    rest = [line.split() for line in body[end:]]
    for number, words in enumerate(rest, start=first + end):
        if words and words[0].upper().rstrip(":") in ("HIERARCHY", "MOTION"):
            raise FileError(
                f"Clip {path}: line {number}: a second motion begins here; save each in a file of its own."
            )
    # What is like a frame shows that it is damage among them.
    among = any(
        len(words) == columns and 2 * sum(map(is_number, words)) > columns for words in rest
    )
    return body if among else body[:end]


def _rejoined(body: Sequence[str], frames: int, columns: int) -> Sequence[str]:
    """`body` with each frame in one line, where its numbers are wrapped; else as it is."""
    words = [line.split() for line in body]
    if sum(map(len, words)) != frames * columns:
        return body
    flat = list(itertools.chain.from_iterable(words))
    return [" ".join(flat[i : i + columns]) for i in range(0, len(flat), columns)]
