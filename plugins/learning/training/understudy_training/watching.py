"""Who watches a run: the user who gave the command, and the observers that plugins provide."""

from __future__ import annotations

from understudy.command.command import tell
from understudy.errors import said
from understudy.records.observer import RunObserver
from understudy.running.training import Reporter
from understudy.setup import plugins
from understudy.signals import is_stop

__all__ = ["observers", "reporter"]


def reporter() -> Reporter:
    """Tells messages to the user who gave the command, and events to observers of its own."""
    return Reporter(tell, observers())


def observers() -> list[RunObserver]:
    """A fresh one of each kind that plugins provide. One that cannot be made is named and left out."""
    found: list[RunObserver] = []
    for part in plugins.installed().registry.components.values():
        if part.kind != "observer":
            continue
        try:
            observer = part.factory()
            if not isinstance(observer, RunObserver):
                raise TypeError(f"{observer!r} is no run observer")
            found.append(observer)
        except BaseException as error:  # a stranger's may raise anything
            if is_stop(error):
                raise
            tell(f"The observer '{part.name}' of plugin '{part.plugin}' is left out: {said(error)}")
    return found
