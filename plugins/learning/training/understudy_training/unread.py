"""Words of a command line that have no effect: they set what no part of a run reads (decision 127).

Parts do not declare what they read. The experiment that a run is built from notes what is looked up in it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

from understudy.setup.config import Experiment
from understudy.setup.root import Root

__all__ = ["noting", "unread"]

_ROOT = frozenset(field.name for field in fields(Root))
#: Keys that every run reads, but only once it is made or under way.
_LATER = frozenset({"task", "budget", "checkpoint", "evaluation", "run"})


class _Noting(dict[str, Any]):
    """A mapping that adds each key that is looked up to `noted`. So does its copy, into which the kernel puts built sections."""

    def __init__(self, items: Mapping[str, Any], noted: set[str]) -> None:
        super().__init__(items)
        self.noted = noted

    def __getitem__(self, key: str) -> Any:
        self.noted.add(key)
        return super().__getitem__(key)

    def get(self, key: str, default: Any = None) -> Any:
        self.noted.add(key)
        return super().get(key, default)


def noting(experiment: Experiment) -> Experiment:
    """`experiment`, noting from here on which slots, sections and keys of the root are looked up, for :func:`unread`."""
    noted: set[str] = set()

    class NotingRoot(Root):
        def __getattribute__(self, key: str) -> Any:
            noted.add(key)
            return super().__getattribute__(key)

    root = NotingRoot(**vars(experiment.root))
    noted.clear()  # of what its own checks have read
    choices, sections = (_Noting(one, noted) for one in (experiment.choices, experiment.sections))
    return replace(experiment, root=root, choices=choices, sections=sections)


def unread(experiment: Experiment, overrides: Sequence[str]) -> Iterator[str]:
    """A sentence on each of the `overrides` that sets what no part looked up in `experiment`, which is :func:`noting`."""
    assert isinstance(experiment.choices, _Noting), "an experiment that notes nothing"
    chosen = {slot.partition(".")[0] for slot, parts in experiment.choices.items() if parts}
    there = (chosen | experiment.sections.keys() | _ROOT) - _LATER
    never = there - {key.partition(".")[0] for key in experiment.choices.noted}
    for word in overrides:
        key = word.lstrip("+").partition("=")[0].partition(".")[0]
        if key in never:
            yield f"{word} changes nothing: no part of this run reads {key}."
