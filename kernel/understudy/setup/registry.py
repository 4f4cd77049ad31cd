"""The registry: every part that a configuration can name, who provides it, and its options.

A *kind* is a slot in a task or run (``reward``, ``simulator`` …). A *component* is a named way to
fill it. Components are looked up by name only; a configuration never names Python code.
"""

from __future__ import annotations

import contextlib
import difflib
import functools
import importlib
import inspect
import re
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from understudy.errors import ConfigError, PluginError, UnderstudyError, said, suggestion
from understudy.options import Option, options_of
from understudy.setup.root import KEYS
from understudy.signals import is_stop

__all__ = ["Component", "Registrar", "Registry"]
_signature = functools.lru_cache(1024)(inspect.signature)  # every environment asks again


@dataclass(frozen=True)
class Slot:
    """A place in the configuration that one component fills, or several, each under a name."""

    name: str  #: its key path
    kind: str  #: of component
    summary: str
    many: bool = False
    plugin: str = ""  #: that added it


#: The kernel's own slots. Plugins may add slots, and kinds.
KERNEL_SLOTS: tuple[Slot, ...] = (
    Slot("job", "job", "what a run iterates; unset, reinforcement learning"),
    Slot("scene", "scene", "what is simulated"),
    Slot("simulator", "simulator", "owns the physics state of N worlds"),
    Slot("fields", "fields", "derives state fields from other state fields", many=True),
    Slot("memory", "memory", "tensors per world that carry the past", many=True),
    Slot("encoder", "encoder", "turns state fields into one named observation", many=True),
    Slot("actuation", "actuation", "turns actions into controls"),
    Slot("reward.terms", "reward", "one value per world and step", many=True),
    Slot("termination.terms", "termination", "ends a world's episode", many=True),
    Slot("measure", "measure", "one value per world and step, reduced over episodes", many=True),
    Slot("evaluation.starts", "initial_states", "where evaluations begin", many=True),
    Slot("initial_states", "initial_states", "where episodes begin"),
    Slot("curriculum", "curriculum", "changes what the next episodes begin with"),
    Slot("policy", "policy", "observation to action distribution and value"),
    Slot("learner", "learner", "improves a policy from rollouts"),
    Slot("outer_loop", "outer_loop", "proposes trials and digests reports"),
    Slot("executor", "executor", "runs trials"),
)


@dataclass(frozen=True)
class Entry:
    """A task, whose parts are in the config option ``task/<name>``; a kind of component; a
    citation; or one of the kernel's own keys."""

    name: str
    summary: str
    plugin: str = ""


KERNEL_KINDS: tuple[Entry, ...] = (
    *(Entry(slot.kind, slot.summary) for slot in KERNEL_SLOTS),
    Entry("command", "a command of the command line"),
    Entry("observer", "is told what happens in every run"),
)

#: The tables that a plugin's module can have, and how a row of each is written.
TABLES: dict[str, str] = {
    "KINDS": '{"kind": "what its components are"}',
    "SLOTS": '{"slot": {"kind": "of what fills it", "summary": "what it is", "many": False}}',
    "PARTS": '{"kind": {"name": ("module:name", "what it is")}}',
    "SECTIONS": '{"section": ("module:Options", "module:build")}',
    "TASKS": '{"task": "what is learned"}',
    "CITATIONS": '{"key": "how to cite it"}',
}

#: Keys of a configuration that are neither slot nor section.
KERNEL_KEYS = {
    key: Entry(key, "") for key in KEYS | {"ablation", "defaults", "experiment", "hydra", "search"}
}


@dataclass(frozen=True)
class Component:
    """A registered part: where it comes from, how it is made, which options it takes.

    ``target`` is either the object itself or ``"package.module:name"``, imported when the
    component is first built, so that loading plugins imports no heavy library.
    """

    kind: str
    name: str
    target: Callable[..., Any] | str
    plugin: str
    distribution: str = ""
    version: str = ""
    summary: str = ""

    @functools.cached_property
    def factory(self) -> Callable[..., Any]:
        if not isinstance(self.target, str):
            return self.target
        module, _, attribute = self.target.partition(":")
        with self.guarded("cannot be used", "Install what it is missing"):
            loaded = importlib.import_module(module)
        if not hasattr(loaded, attribute):
            raise self.fault(f"is registered as '{self.target}', which does not exist")
        return getattr(loaded, attribute)

    @functools.cached_property
    def options(self) -> Mapping[str, Option]:
        with self.guarded("has options that cannot be read"):  # neither dataclass nor function, say
            return options_of(self.factory)

    @contextlib.contextmanager
    def guarded(self, why: str, advice: str = "Mend the plugin") -> Iterator[None]:
        """Inside, what the plugin's code raises becomes a :meth:`fault` of the plugin, except an
        UnderstudyError, with which it refuses something, and a stop signal."""
        try:
            yield
        except BaseException as error:  # a stranger's code may raise anything
            if isinstance(error, UnderstudyError) or is_stop(error):
                raise
            raise self.fault(f"{why}: {said(error).rstrip('.')}", advice) from error

    def call(self, *given: Any, **options: Any) -> Any:
        """What the factory of a kind of functions returns; what it raises is a :meth:`fault`."""
        with self.guarded("cannot be used"):
            return self.factory(*given, **options)

    def fault(self, why: str, advice: str = "Mend the plugin") -> PluginError:
        """The error for a component that cannot be used, with the reason `why`."""
        by = f"{self.kind} '{self.name}' of plugin '{self.plugin}'"
        return PluginError(f"{by} {why}. {advice}, or choose another one.")

    def make(self, like: type, *given: Any) -> Any:
        """An instance, made of `given`, for kinds that are classes; or a :class:`PluginError` that
        says in what it differs from `like`, the interface of its kind."""
        factory, kinds = self.factory, ", ".join(type(item).__name__ for item in given)
        try:
            _signature(factory).bind(*given)
        except (TypeError, ValueError) as error:
            raise self.fault(f"is not made of ({kinds}): {said(error)}") from error
        if abstract := ", ".join(sorted(getattr(factory, "__abstractmethods__", ()))):
            raise self.fault(f"does not define {abstract}")
        part, declared = factory(*given), inspect.get_annotations(like)
        names = (name for name in {*declared, *vars(like)} if name[0] != "_")
        if lacking := ", ".join(sorted(name for name in names if not hasattr(part, name))):
            raise self.fault(f"lacks {lacking}, which {like.__name__} declares")
        for name, form in declared.items():
            if not _fits(value := getattr(part, name), form):
                raise self.fault(f"has {name} = {value!r}, which must be a {form}")
        return part


def _fits(value: Any, form: str) -> bool:
    """Whether the `value` of an attribute has the type `form`; ``("position")`` is no tuple."""
    several = isinstance(value, Sequence) and not isinstance(value, str)
    if form in ("tuple[str, ...]", "Sequence[str]"):
        return several and all(isinstance(item, str) for item in value)
    if form == "Shape":
        return several and all(hasattr(item, "__index__") for item in value)
    if form == "Mapping[str, Shape]":
        return isinstance(value, Mapping) and all(_fits(v, "Shape") for v in value.values())
    if form.startswith(("ActionSpace", "Literal")):
        kinds = [kind.__name__ for kind in type(value).__mro__]
        return form in kinds or (isinstance(value, str) and repr(value) in form)
    return form != "int" or getattr(value, "__index__", lambda: -1)() >= 0


@dataclass(frozen=True)
class Section:
    """A top-level part of the configuration that a plugin owns (for example ``motion``).

    ``build(options, registry, inputs)`` makes the object that components find under
    ``context.sections[name]``.
    """

    name: str
    options: Component
    build: Component
    plugin: str


@dataclass
class Registry:
    """All components, tasks, sections and citations of the loaded plugins."""

    kinds: dict[str, Entry] = field(default_factory=lambda: {k.name: k for k in KERNEL_KINDS})
    slots: dict[str, Slot] = field(default_factory=lambda: {s.name: s for s in KERNEL_SLOTS})
    components: dict[tuple[str, str], Component] = field(default_factory=dict)
    tasks: dict[str, Entry] = field(default_factory=dict)
    sections: dict[str, Section] = field(default_factory=dict)
    #: By (plugin, key): how to cite what the plugin implements.
    citations: dict[tuple[str, str], Entry] = field(default_factory=dict)
    #: By name of a plugin that could not be loaded: why; said where something is not found.
    broken: dict[str, str] = field(default_factory=dict)

    def unknown_kinds(self) -> dict[str, PluginError]:
        """By plugin, once all are loaded: a component of a kind that nobody registered."""
        return {
            c.plugin: PluginError(
                f"it registers '{c.name}' as a '{c.kind}', which is no kind of component."
                + suggestion(c.kind, self.kinds)
            )
            for c in self.components.values()
            if c.kind not in self.kinds
        }

    def names(self, kind: str) -> list[str]:
        return sorted(name for k, name in self.components if k == kind)

    def find(self, kind: str, name: str, where: str = "") -> Component:
        """The component; or a :class:`ConfigError` that suggests what was meant."""
        if (component := self.components.get((kind, name))) is not None:
            return component
        place = f" (asked for at {where})" if where else ""
        lost = name.partition("/")[0] in self.broken  # with its plugin, as is said below
        known = "" if lost else suggestion(name, self.names(kind))
        message = f"There is no {kind} '{name}'{place}.{known}"
        if elsewhere := [k for k, n in self.components if n == name]:
            message += f" '{name}' is a {elsewhere[0]}."
        raise ConfigError(message + self.absent())

    def absent(self) -> str:
        """Which plugins did not load, and why; the end of an error about something not found."""
        return "".join(f" Plugin '{name}' did not load: {why}" for name, why in self.broken.items())

    def fault_of(self, error: BaseException) -> PluginError | None:
        """The fault of the stranger's part in whose code `error` arose, the innermost of several."""
        every = (*self.components.values(), *(s.build for s in self.sections.values()))
        parts = [part for part in every if part.distribution != "understudy"]
        made = [(vars(part).get("factory", part.target), part) for part in parts]
        found = {id(getattr(factory, "__code__", factory)): part for factory, part in made}
        for frame, line in reversed([*traceback.walk_tb(error.__traceback__)]):
            for own in (frame.f_code, *type(frame.f_locals.get("self")).__mro__):
                if part := found.get(id(own)):
                    where = f"{Path(frame.f_code.co_filename).name}, line {line}"
                    shows = "Mend the plugin (UNDERSTUDY_TRACEBACK=1 prints the traceback)"
                    return part.fault(f"raises {said(error).rstrip(':.')} ({where})", shows)
        return None

    def remove(self, plugin: str) -> None:
        """Forget what `plugin` registered."""
        for title, table in vars(self).items():
            if title != "broken":
                for key in [k for k, entry in table.items() if entry.plugin == plugin]:
                    del table[key]


@dataclass(frozen=True)
class Registrar:
    """Registers, under the plugin's name, what its tables declare and what its hook adds."""

    registry: Registry
    plugin: str
    distribution: str = ""
    version: str = ""

    def component(
        self, kind: str, name: str, target: Callable[..., Any] | str, summary: str = ""
    ) -> None:
        """Register a component. `target` is a class, a term function, or ``"module:name"``."""
        if not (callable(target) or isinstance(target, str)):
            raise PluginError(
                f"Plugin '{self.plugin}' registers {target!r} as the {kind} '{name}'."
            )
        component = self._component(kind, name, target, summary)
        self._add(kind, self.registry.components, (kind, name), component, summary)
        if kind == "command":
            self._check_command(name)

    def _component(self, kind: str, name: str, target: Any, summary: str = "") -> Component:
        origin = (self.plugin, self.distribution, self.version)
        return Component(kind, name, target, *origin, summary)

    def _check_command(self, name: str) -> None:
        """Raise :class:`PluginError` for a command that cannot be typed, or that is a group."""
        words = name.split()
        typed = len(words) <= 2 and all(re.fullmatch(r"[^\W_][\w-]*", word) for word in words)
        others = self.registry.names("command")
        clash = any(o.startswith(f"{name} ") or name.startswith(f"{o} ") for o in others)
        if not typed or clash:
            why = "exists already" if typed else "cannot be typed"
            raise PluginError(f"it registers the command '{name}', which {why}.")

    def tables(self, module: Any) -> None:
        """Register what the plugin's `module` declares in those of the :data:`TABLES` that it has.
        A place, ``"module:name"``, is relative to the module's package."""
        package = getattr(module, "__package__", None)

        def at(place: Any) -> Any:
            return f"{package}.{place}" if package and isinstance(place, str) else place

        def parts(kind: str, rows: Mapping[str, tuple[Any, str]]) -> None:
            for name, (place, summary) in rows.items():
                self.component(kind, name, at(place), summary)

        added: dict[str, Callable[..., None]] = {
            "KINDS": self.kind,
            "SLOTS": lambda name, row: self.slot(name, **row),
            "PARTS": parts,
            "SECTIONS": lambda name, row: self.section(name, *map(at, row)),
            "TASKS": self.task,
            "CITATIONS": self.citation,
        }
        for name in {*filter(str.isupper, dir(module))} - TABLES.keys():
            meant = difflib.get_close_matches(name, TABLES, n=1, cutoff=0.8)
            if meant and isinstance(getattr(module, name), Mapping):
                raise PluginError(f"its table '{name}' is none. Did you mean '{meant[0]}'?")
        for title, form in TABLES.items():
            try:
                for name, row in getattr(module, title, {}).items():
                    added[title](name, row)
            except (AttributeError, TypeError, ValueError) as error:
                why = f"its table {title} is not as tables are"
                raise PluginError(f"{why}. Write {title} = {form}.") from error

    def task(self, name: str, summary: str) -> None:
        """Register a task whose parts are in the plugin's ``conf/task/<name>.yaml``."""
        self._add("task", self.registry.tasks, name, Entry(name, summary, self.plugin), summary)

    def section(self, name: str, options: type | str, build: Callable[..., Any] | str) -> None:
        """Register a top-level config section, and what builds an object from it."""
        schema, maker = (self._component("section", name, target) for target in (options, build))
        section = Section(name, schema, maker, self.plugin)
        self._add("section", self.registry.sections, name, section)

    def kind(self, name: str, summary: str) -> None:
        """Add a kind of component, for example ``clip_reader``."""
        self._add("kind", self.registry.kinds, name, Entry(name, summary, self.plugin), summary)

    def slot(self, name: str, kind: str, summary: str, *, many: bool = False) -> None:
        """Add a top-level slot `name` that components of `kind` fill; jobs build them
        (``experiment.need(name).build(…)``)."""
        slot = Slot(name, kind, summary, many, self.plugin)
        self._add("slot", self.registry.slots, name, slot, kind, summary)

    def citation(self, key: str, text: str) -> None:
        """Record how to cite what the plugin implements; every run that uses it keeps this."""
        entry = Entry(key, text, self.plugin)
        self._add("citation", self.registry.citations, (self.plugin, key), entry, text)

    def _add(self, what: str, table: dict[Any, Any], key: Any, entry: Any, *texts: Any) -> None:
        """Put `entry` into `table`; a :class:`PluginError` if its name cannot be typed, one of the
        `texts` is no text, or the name is taken."""
        name, by = entry.name, f"Plugin '{self.plugin}'"
        typed = " ".join(str(name).split()) == name != "" and name.isprintable()
        if not typed or not all(isinstance(text, str) for text in (what, *texts)):
            raise PluginError(
                f"{by} registers the {what} {name!r}; its name or summary is no text."
            )
        if "." in name:
            slashed = name.replace(".", "/")
            raise PluginError(
                f"{by} registers the {what} '{name}', whose name has a dot. Write it as the {what} "
                f"'{slashed}'."
            )
        registry, there = self.registry, table
        if what in ("slot", "section"):  # which are keys of one configuration
            there = {**KERNEL_KEYS, **registry.slots, **registry.sections}
        if (other := there.get(key)) is not None:
            owner = f"plugin '{other.plugin}'" if other.plugin else "understudy itself"
            raise PluginError(
                f"Both {owner} and plugin '{self.plugin}' register the {what} '{name}'. Rename "
                f"one, or disable a plugin with UNDERSTUDY_DISABLE_PLUGINS={self.plugin}."
            )
        table[key] = entry
