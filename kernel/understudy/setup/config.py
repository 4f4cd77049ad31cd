"""A valid configuration: every component is found, every option has the right type."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from understudy import task
from understudy.errors import ConfigError, suggestion
from understudy.inputs import Inputs
from understudy.options import at, plain
from understudy.setup.registry import Component, Registry
from understudy.setup.root import Root

__all__ = ["Chosen", "Experiment"]

#: The job of a configuration that names none.
USUAL_JOB = "reinforcement"


@dataclass(frozen=True)
class Chosen:
    """A component chosen by the configuration, with its validated options."""

    name: str  #: among several of its slot; else the slot's
    component: Component
    options: Any  #: an ``Options`` instance, a function's keyword arguments, or None
    where: str  #: its key path
    extras: Mapping[str, Any] = field(default_factory=dict)  #: what its kind takes besides

    def build(self, *context: Any, like: type | None = None) -> Any:
        """Build the component with its options and the `context` that its kind takes. `like` is the
        interface of a kind that is a plugin's; the kernel's interfaces are named as their kinds."""
        named = getattr(task, self.component.kind.title().replace("_", ""), object)
        return self.component.make(like or named, self.options, *context)

    def effective(self) -> dict[str, Any]:
        """As plain data, every default filled in."""
        options: dict[str, Any] = self.options or {}
        if dataclasses.is_dataclass(self.options) and not isinstance(self.options, type):
            options = dataclasses.asdict(self.options)
        extras = {k: v for k, v in self.extras.items() if v != {}}
        return {"name": self.component.name, **options, **extras}


@dataclass(frozen=True, repr=False)
class Experiment:
    """A validated configuration: every component found, every option of the right type."""

    root: Root
    choices: Mapping[str, tuple[Chosen, ...]]  #: by slot
    sections: dict[str, Any]  #: their options, by name
    registry: Registry
    inputs: Inputs = field(default_factory=Inputs)

    def one(self, slot: str) -> Chosen | None:
        """What fills `slot`, which takes one component."""
        return next(iter(self.choices[slot]), None)

    def many(self, slot: str) -> tuple[Chosen, ...]:
        """What fills `slot`, in the order of the configuration."""
        return self.choices[slot]

    def need(self, slot: str) -> Chosen:
        """What fills `slot`; a ConfigError if nothing does."""
        if (chosen := self.one(slot)) is None:
            kind = self.registry.slots[slot].kind
            raise ConfigError(
                f"{slot} is not set. Choose an experiment (experiment=…), or set it ({slot}=…)."
                + suggestion("", self.registry.names(kind))
            )
        return chosen

    @property
    def job(self) -> Chosen:
        """What a run iterates: the job that is named, else reinforcement learning."""
        found = self.one("job")
        return found or Chosen("job", self.registry.find("job", USUAL_JOB, "job"), None, "job")

    def __repr__(self) -> str:
        names = {s: "+".join(c.component.name for c in many) for s, many in self.choices.items()}
        slots = ", ".join(f"{slot}={name}" for slot, name in names.items() if name)
        return f"Experiment({slots}; seed {self.root.seed})"

    def components(self) -> Iterator[Component]:
        """Every component in use."""
        for chosen in self.choices.values():
            yield from (c.component for c in chosen)
        if not self.choices["job"] and ("job", USUAL_JOB) in self.registry.components:
            yield self.job.component

    @functools.cached_property
    def failures(self) -> tuple[str, ...]:
        """The termination terms that fail an evaluation's episode."""
        terms = self.many("termination.terms")
        if (named := self.root.evaluation.failures) is None:
            return tuple(t.name for t in terms if t.extras["outcome"] == "failure")
        for name in named:
            _find(name, [t.name for t in terms], "termination term", "evaluation.failures")
        return named

    def need_measure(self, name: str, where: str) -> None:
        """Raise :class:`ConfigError` if there is no measure `name`, which `where` asks for."""
        _find(name, [*(m.name for m in self.many("measure")), "return"], "measure", where)

    def effective(self) -> dict[str, Any]:
        """The configuration as plain data, every default filled in. Validating that gives the same
        experiment, even where plugins that it does not use are missing."""
        root, choices = Root(**vars(self.root)), dict(self.choices)  # plain, whatever those are
        found = plain(dataclasses.asdict(root))
        for slot in self.registry.slots.values():
            if not (chosen := choices[slot.name]) and slot.plugin:
                continue
            value: Any = {c.name: c.effective() for c in chosen}
            if not slot.many:
                value = chosen[0].effective() if chosen else None
            above, _, last = slot.name.rpartition(".")
            (at(found, above) if above else found)[last] = plain(value)
        for name, options in self.sections.items():
            found[name] = plain(dataclasses.asdict(options))
        return found


def _find(name: str, known: Sequence[str], what: str, where: str) -> None:
    if name not in known:
        advice = suggestion(name, known)
        raise ConfigError(f"{where} names '{name}', which is no {what} of this task.{advice}")
