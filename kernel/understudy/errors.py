"""The errors that a user can cause, each one sentence that says what to do next.

The command line prints a :class:`UnderstudyError` as one line and exits with its ``exit_status``;
every other exception is a defect and keeps its traceback.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable

__all__ = [
    "ConfigError",
    "FileError",
    "PluginError",
    "PreemptedError",
    "RunError",
    "TrainingError",
    "UnderstudyError",
    "said",
    "shown",
    "suggestion",
]


class UnderstudyError(Exception):
    """Something outside the program is wrong: a config, a file, a plugin, the machine."""

    exit_status = 2


class ConfigError(UnderstudyError):
    """A configuration value, key or combination that cannot work."""


class PluginError(UnderstudyError):
    """A plugin that does not import, registers badly, or provides what another one provides."""


class FileError(UnderstudyError):
    """A file that is missing, unreadable, damaged, or not what it should be."""


class RunError(UnderstudyError):
    """A run folder or checkpoint that cannot be used as asked."""


class TrainingError(UnderstudyError):
    """A training that cannot go on: numbers are not finite, or there is nothing to learn from."""

    exit_status = 1


class PreemptedError(UnderstudyError):
    """The run was told to stop, and saved everything; it can be started again."""

    exit_status = 75  # EX_TEMPFAIL of sysexits.h: "try again later", what cluster requeues look for


def said(error: BaseException) -> str:
    """The message of a stranger's `error` on one line, even if making it text fails."""
    kind = type(error).__name__
    try:
        return " ".join(f"{kind}: {error}".split("\n")[0].split())
    except BaseException:
        return f"{kind}, which cannot say what it is"


def shown(text: str) -> str:
    """`text` without characters that would command a terminal, which strangers' files may have."""
    return "".join(c for c in text if c.isprintable() or c == "\n")


def suggestion(word: str, known: Iterable[str]) -> str:
    """`` Did you mean 'x'?`` if `word` is nearly a known name or its end, in any case of letters;
    else all known names; many are grouped by what comes before their slash."""
    names = sorted(set(known))
    small, low = word.lower(), {n.lower(): n for n in reversed(names)}
    close = [low[small]] if small in low else []
    close = close or [n for n in names if n.lower().endswith((f"/{small}", f".{small}"))]
    close = close or [low[n] for n in difflib.get_close_matches(small, low, n=1, cutoff=0.6)]
    if word and close:
        return f" Did you mean {' or '.join(map(repr, close))}?"
    if not 0 < len(names) <= 200:
        return f" It is none of the {len(names)} known here." if names else " None is known here."
    groups: dict[str, list[str]] = {}
    for name in names:
        head, _, tail = name.rpartition("/") if len(names) > 8 else ("", "", name)
        groups.setdefault(head, []).append(tail)
    shown = _first(groups.pop("", []))
    shown += [f"{head}/{{{', '.join(_first(tails))}}}" for head, tails in groups.items()]
    return f" Known: {', '.join(shown)}."


def _first(names: list[str], most: int = 48) -> list[str]:
    """As many as one reads, and how many more there are."""
    return names if len(names) <= most else [*names[:most], f"… and {len(names) - most} more"]
