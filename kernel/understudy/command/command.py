"""Commands, which plugins add, and how they write messages."""

from __future__ import annotations

import argparse
import contextlib
import sys
from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path

from understudy.errors import shown

__all__ = ["Command", "tell"]


def tell(text: str) -> None:
    """Show a message to whoever runs the command."""
    with contextlib.suppress(OSError, RuntimeError, AttributeError):  # no terminal; or a signal
        print(shown(text), file=sys.stderr, flush=sys.stderr.writable())  # fails if it is closed


class Command(ABC):
    """A command of the command line, registered as a ``command`` whose name is its words: the
    component ``motion check`` is run as ``understudy motion check``. Its summary is its help."""

    #: Whether it takes overrides (KEY=VALUE), which are then in ``options.overrides``.
    takes_overrides = False
    example = ""  #: A whole command line, which ``--help`` shows.

    @abstractmethod
    def arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the command's arguments."""

    def writes(self, options: argparse.Namespace) -> Iterator[Path | None]:
        """The files that it writes where the user says. A command with such files has
        ``--overwrite``; without it, files that exist are refused before :meth:`run`."""
        yield from ()

    @abstractmethod
    def run(self, options: argparse.Namespace) -> int:
        """Carry it out; returns the exit status. What a user can cause raises UnderstudyErrors."""
