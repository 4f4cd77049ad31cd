"""Configuration: composed by Hydra from the plugins' options, validated against the registry.

A configuration is data. It names components; it never names Python code, and keys by which Hydra
would call code (``_target_`` and its like) are refused wherever they stand.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import json
import re
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import yaml
from hydra import compose, initialize_config_dir
from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Quote, QuotedString
from hydra.core.plugins import Plugins as HydraPlugins
from hydra.errors import HydraException
from hydra.plugins.search_path_plugin import SearchPathPlugin
from hydra.types import RunMode
from omegaconf import MISSING, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException

from understudy.errors import ConfigError, suggestion
from understudy.options import Option, check_range, checked_options, make_options
from understudy.setup.plugins import Plugins, installed, kernel_conf
from understudy.setup.registry import Component, Registry, Slot
from understudy.task.terms import Outcome, Reduction


@dataclass(frozen=True)
class ControlOptions:
    """Control and physics rates; 30 Hz control, 600 Hz physics by default (thesis, section 3.5)."""

    frequency: float = 30.0  #: control periods per second
    substeps: int = 20  #: physics steps per control period
    decision: int = 1  #: control periods that one decision of the policy lasts

    def __post_init__(self) -> None:
        check_range(self, "frequency", above=0, most=1e5)
        check_range(self, "substeps", least=1, most=100_000)
        check_range(self, "decision", least=1, most=10_000)


@dataclass(frozen=True)
class EpisodeOptions:
    seconds: float = 20.0  #: episodes are truncated at this length

    def __post_init__(self) -> None:
        check_range(self, "seconds", above=0)


@dataclass(frozen=True)
class BudgetOptions:
    """A training ends at whichever of these it reaches first; both are absolute over resumes."""

    samples: int | None = None  #: environment steps, summed over worlds
    minutes: float | None = None  #: minutes of training time

    def __post_init__(self) -> None:
        check_range(self, "samples", "minutes", above=0)


@dataclass(frozen=True)
class MeasureThreshold:
    """Success by a measure: its value over the episode lies within these limits."""

    measure: str
    at_least: float | None = None
    at_most: float | None = None

    def __post_init__(self) -> None:
        if self.at_least is None and self.at_most is None:
            raise ValueError("at_least and at_most are both unset: give one of them.")


@dataclass(frozen=True)
class EvaluationOptions:
    """How a policy is judged: deterministic, from starts that training never saw."""

    episodes: int = 64  #: of one draw of starts, all at once
    final_episodes: int = 128  #: of the draw that confirms a criterion, and of the last one
    seconds: float = 20.0  #: episodes are cut at this length
    #: ``survived`` (no failure until the end), a termination term with outcome=success, or
    #: ``{measure: NAME, at_least: x}``; null is the task's success term, else survival.
    success: str | MeasureThreshold | None = None
    #: Failure terms that end an evaluation's episode, the others being only reported; null is all.
    failures: tuple[str, ...] | None = None
    #: What searches maximise: ``success_rate``, ``return``, or a measure (its mean).
    objective: str = "success_rate"
    #: Success rate at which a training is done, on one draw of starts and then, confirmed, on a
    #: second; null trains to the budget.
    criterion: float | None = None
    #: An evaluation starts when training episodes would last this share of its seconds …
    gate: float = 0.3
    #: … and this many samples were consumed since the last one; null is 100 000 where there is a
    #: criterion, and never where there is none.
    every_samples: int | None = None

    def __post_init__(self) -> None:
        check_range(self, "episodes", "final_episodes", least=1)
        check_range(self, "seconds", above=0)
        check_range(self, "criterion", above=0, most=1)
        check_range(self, "gate", least=0, most=1)
        check_range(self, "every_samples", least=0)


@dataclass(frozen=True)
class CheckpointOptions:
    minutes: float = 2.0  #: training time between checkpoints
    keep: int = 3  #: how many of the newest are kept

    def __post_init__(self) -> None:
        check_range(self, "minutes", least=0)
        check_range(self, "keep", least=1)


@dataclass(frozen=True)
class RunOptions:
    dir: str | None = None  #: run folder; null makes ``runs/<experiment>-<n>``
    video_seconds: float = 8.0

    def __post_init__(self) -> None:
        check_range(self, "video_seconds", least=0)


#: What a run can take over from another one.
Part = Literal["actor", "critic", "normaliser", "initial_states", "curriculum"]


@dataclass(frozen=True)
class StartOptions:
    """Begin with parts of another run's newest checkpoint."""

    run: str  #: its folder
    parts: tuple[Part, ...] = ("actor", "critic", "normaliser")


@dataclass(frozen=True)
class RewardOptions:
    terms: Mapping[str, Any] = field(default_factory=dict)
    combine: Literal["sum", "product"] = "product"


@dataclass(frozen=True)
class TerminationOptions:
    terms: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Root:
    """The top level of a configuration, beside the slots and plugins' sections."""

    seed: int = 0
    device: str = "cpu"
    num_worlds: int = 256
    difficulty: float = 1.0  #: in [0, 1]: what evaluations run at, and trainings lead to
    task: str | None = None
    control: ControlOptions = field(default_factory=ControlOptions)
    episode: EpisodeOptions = field(default_factory=EpisodeOptions)
    budget: BudgetOptions = field(default_factory=BudgetOptions)
    evaluation: EvaluationOptions = field(default_factory=EvaluationOptions)
    checkpoint: CheckpointOptions = field(default_factory=CheckpointOptions)
    run: RunOptions = field(default_factory=RunOptions)
    start: StartOptions | None = None
    reward: RewardOptions = field(default_factory=RewardOptions)
    termination: TerminationOptions = field(default_factory=TerminationOptions)

    def __post_init__(self) -> None:
        check_range(self, "num_worlds", least=1)
        check_range(self, "seed", least=0, most=2**63 - 1)
        check_range(self, "difficulty", least=0, most=1)


@dataclass(frozen=True)
class Chosen:
    """A component chosen by the configuration, with its validated options."""

    name: str  #: among several of its slot; else the slot's
    component: Component
    options: Any  #: an ``Options`` instance, a function's keyword arguments, or None
    where: str  #: its key path
    extras: Mapping[str, Any] = field(default_factory=dict)  #: what its kind takes besides

    def build(self, *context: Any) -> Any:
        """The component of these options; `context` is what its kind is built with."""
        return self.component.factory(self.options, *context)

    def effective(self) -> dict[str, Any]:
        """As configuration, every default filled in."""
        options: dict[str, Any] = self.options or {}
        if dataclasses.is_dataclass(self.options) and not isinstance(self.options, type):
            options = dataclasses.asdict(self.options)
        extras = {k: v for k, v in self.extras.items() if v != {}}
        return {"name": self.component.name, **options, **extras}


@dataclass(frozen=True)
class Experiment:
    """A validated configuration: every component found, every option of the right type."""

    root: Root
    choices: Mapping[str, tuple[Chosen, ...]]  #: by slot
    sections: Mapping[str, Any]
    registry: Registry

    def one(self, slot: str) -> Chosen | None:
        """What fills `slot`, which takes one component."""
        return next(iter(self.choices[slot]), None)

    def many(self, slot: str) -> tuple[Chosen, ...]:
        """What fills `slot`, by name in the order of the configuration."""
        return self.choices[slot]

    def need(self, slot: str) -> Chosen:
        """What fills `slot`; an error says that it must be set."""
        chosen = self.one(slot)
        if chosen is None:
            kind = self.registry.slots[slot].kind
            raise ConfigError(
                f"{slot} is not set. Choose an experiment (experiment=…) or a {kind} ({slot}=…)."
                + suggestion("", self.registry.names(kind))
            )
        return chosen

    def components(self) -> Iterator[Component]:
        """Every component in use."""
        for chosen in self.choices.values():
            yield from (c.component for c in chosen)

    @functools.cached_property
    def failures(self) -> tuple[str, ...]:
        """The termination terms that fail an evaluation's episode."""
        terms = self.many("termination.terms")
        named = self.root.evaluation.failures
        if named is None:
            return tuple(t.name for t in terms if t.extras["outcome"] == "failure")
        names = {t.name for t in terms}
        for failure in named:
            if failure not in names:
                raise ConfigError(
                    f"evaluation.failures names '{failure}', which is no termination term of this "
                    f"task.{suggestion(failure, names)}"
                )
        return named

    def need_measure(self, name: str, where: str) -> None:
        """Raise :class:`ConfigError` if there is no measure `name`, which `where` asks for."""
        names = [m.name for m in self.many("measure")]
        if name not in (*names, "return"):
            raise ConfigError(
                f"{where} names '{name}', which is no measure of this task."
                + suggestion(name, [*names, "return"])
            )

    def effective(self) -> dict[str, Any]:
        """The configuration as plain data, every default filled in; validates to the same, also
        where plugins that it does not use are absent."""
        found = _plain_data(dataclasses.asdict(self.root))
        for slot in self.registry.slots.values():
            chosen = self.choices[slot.name]
            if not chosen and f"slot {slot.name}" in self.registry.owners:
                continue
            value: Any = {c.name: c.effective() for c in chosen}
            if not slot.many:
                value = chosen[0].effective() if chosen else None
            _put(found, slot.name, _plain_data(value))
        for name, options in self.sections.items():
            found[name] = _plain_data(dataclasses.asdict(options))
        return found


def _plain_data(value: Any) -> Any:
    """Tuples as lists: what JSON and YAML have."""
    if isinstance(value, Mapping):
        return {str(k): _plain_data(v) for k, v in value.items()}
    return [_plain_data(v) for v in value] if isinstance(value, (list, tuple)) else value


def _put(tree: dict[str, Any], path: str, value: Any) -> None:
    *above, last = path.split(".")
    for key in above:
        tree = tree[key]
    tree[last] = value


#: What components of a kind take beside their own options: renamed fields, and how terms count.
_READS = {"reads": Option("reads", dict[str, str], {})}
_PROVIDES = {"provides": Option("provides", dict[str, str], {})}
EXTRAS: dict[str, dict[str, Option]] = {
    "fields": {**_READS, **_PROVIDES},
    "memory": {**_READS, **_PROVIDES},
    "encoder": _READS,
    "actuation": {**_READS, **_PROVIDES},
    "reward": {**_READS, "weight": Option("weight", float, 1.0)},
    "termination": {**_READS, "outcome": Option("outcome", Outcome, "failure")},
    "measure": {**_READS, "reduce": Option("reduce", Reduction, "last")},
}


def validate(raw: Mapping[str, Any], registry: Registry) -> Experiment:
    """Look up every component that `raw` names and check every option.

    Raises
    ------
    ConfigError
        for an unknown key or component, a missing or wrong value; the message has the key path.
    """
    refuse_code(raw)
    own = {f.name for f in dataclasses.fields(Root)}
    slots = {slot.name for slot in registry.slots.values()}
    known = own | {s for s in slots if "." not in s} | set(registry.sections)
    for key in raw:
        if key not in known:
            raise ConfigError(
                f"There is no configuration key '{key}'.{suggestion(str(key), known)}"
                + registry.absent()
            )
    filled = {k: v for k, v in raw.items() if k in own and not (v is None and k in _GROUPS)}
    root = make_options(Root, filled, "")
    choices = {
        slot.name: tuple(_chosen(slot, _at(raw, slot.name), registry))
        for slot in registry.slots.values()
    }
    experiment = Experiment(
        root=root,
        choices=choices,
        sections={
            name: make_options(section.schema(), raw[name], name)
            for name, section in registry.sections.items()
            if raw.get(name) is not None
        },
        registry=registry,
    )
    if root.evaluation.objective != "success_rate":
        experiment.need_measure(root.evaluation.objective, "evaluation.objective")
    _ = experiment.failures
    return experiment


#: Groups of the root that an override of null empties.
_GROUPS = ("reward", "termination")


def _at(raw: Any, path: str) -> Any:
    """What stands at the key path `path`, or None."""
    for key in path.split("."):
        raw = raw.get(key) if isinstance(raw, Mapping) else None
    return raw


def _chosen(slot: Slot, value: Any, registry: Registry) -> Iterator[Chosen]:
    """The components that the configuration chooses for `slot`."""
    if value is None:
        return
    if not slot.many:
        yield _choice(slot, slot.name, value, slot.name, registry)
        return
    if not isinstance(value, Mapping):
        raise ConfigError(
            f"{slot.name} must be {{NAME: {{name: COMPONENT, …}}, …}}, not {value!r}."
        )
    for name, item in value.items():
        if item is not None:
            yield _choice(slot, str(name), item, f"{slot.name}.{name}", registry)


def _choice(slot: Slot, name: str, value: Any, where: str, registry: Registry) -> Chosen:
    component_name, options = _named(value, where)
    component = registry.find(slot.kind, component_name, where)
    extra = EXTRAS.get(slot.kind, {})
    given = {k: v for k, v in options.items() if k in extra}
    extras = checked_options(extra, given, where)
    extras = {k: extras.get(k, option.default) for k, option in extra.items()}
    own = {k: v for k, v in options.items() if k not in extra}
    schema = getattr(component.factory, "Options", None)
    checked: Any
    if schema is not None:
        checked = make_options(schema, own, where)
    else:  # a function's options are its keyword-only parameters; a class without Options has none
        checked = {name: option.default for name, option in component.options.items()}
        checked = {**checked, **checked_options(component.options, own, where)} or None
    return Chosen(name, component, checked, where, extras)


def _named(value: Any, where: str) -> tuple[str, dict[str, Any]]:
    if isinstance(value, str):
        return value, {}
    if not isinstance(value, Mapping) or not isinstance(value.get("name"), str):
        raise ConfigError(f"{where} must be {{name: COMPONENT, option: value, …}}, not {value!r}.")
    options = dict(value)
    return options.pop("name"), options


#: Keys by which Hydra's instantiate calls code.
CODE_KEYS = frozenset({"_target_", "_partial_", "_args_", "_recursive_", "_convert_"})


def refuse_code(value: Any, where: str = "") -> None:
    """Raise :class:`ConfigError` if any key in the nested `value` could name code."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            path = f"{where}.{key}" if where else str(key)
            if key in CODE_KEYS:
                raise ConfigError(
                    f"{path}: configurations name registered components (name: …) and never Python code. "
                    "Remove the key; `understudy plugins` lists what can be named."
                )
            refuse_code(item, path)
    elif isinstance(value, (list, tuple)):
        for i, item in enumerate(value):
            refuse_code(item, f"{where}[{i}]")


# ---------------------------------------------------------------------- composition

_active = threading.local()


class UnderstudySearchPath(SearchPathPlugin):
    """Adds every plugin's config directory to Hydra's search path."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        plugins: Plugins | None = getattr(_active, "plugins", None)
        if plugins is not None:
            for name, directory in plugins.config_directories():
                search_path.append(provider=f"understudy plugin {name}", path=f"file://{directory}")


@contextlib.contextmanager
def _hydra(plugins: Plugins, overrides: Sequence[str]) -> Iterator[None]:
    for override in overrides:
        if override.lstrip("+~'\" ").startswith("hydra"):  # hydra.searchpath=[pkg://x] imports x
            raise ConfigError(f"{override}: Hydra itself cannot be configured. Remove it.")
    HydraPlugins.instance().register(UnderstudySearchPath)
    GlobalHydra.instance().clear()
    _active.plugins = plugins
    try:
        with initialize_config_dir(str(kernel_conf()), version_base="1.3", job_name="understudy"):
            yield
    except (HydraException, OmegaConfBaseException, ValueError) as error:
        raise ConfigError(_plain(error, plugins) + plugins.registry.absent()) from error
    finally:
        _active.plugins = None
        GlobalHydra.instance().clear()


def _plain(error: Exception, plugins: Plugins) -> str:
    """Hydra's error in one line, with a suggestion where an option was not found."""
    text = next((line.strip() for line in str(error).splitlines() if line.strip()), "")
    missing = re.search(r"Could not find '([^/']+)/([^']+)'", text)
    if missing:
        group, name = missing.groups()
        folders = [folder / group for folder in _sources(plugins)]
        options = {
            file.relative_to(folder).with_suffix("").as_posix()
            for folder in folders
            for file in folder.rglob("*.yaml")
        }
        return f"There is no {group}={name}.{suggestion(name, options)}"
    stray = re.search(r"Could not override '(\w+)'", text)
    if stray:
        slots = {s.name: s for s in plugins.registry.slots.values()}
        if stray[1] in slots:
            one = "{name: COMPONENT, …}"
            form = f"{{NAME: {one}}}" if slots[stray[1]].many else one
            return f"There is no such choice of {stray[1]}. Give one: '{stray[1]}={form}'."
        known = _VALUES | set(slots) | set(plugins.registry.sections)
        return f"There is no configuration key '{stray[1]}'.{suggestion(stray[1], known)}"
    return text or type(error).__name__


def _sources(plugins: Plugins) -> list[Path]:
    """The directories of config options: the kernel's, then each plugin's."""
    return [kernel_conf(), *(directory for _, directory in plugins.config_directories())]


#: Root keys that are values, not groups of options.
_VALUES = frozenset(f.name for f in dataclasses.fields(Root)) - {"task", "reward", "termination"}


def _settable(override: str) -> str:
    """Let ``a.b=value`` set an option that no file mentions; validation knows which ones exist."""
    key, equals, value = override.partition("=")
    plain = bool(equals and key) and key[0] not in "+~"
    sets = "." in key or value.startswith("{") or key in _VALUES
    return f"++{override}" if plain and sets else override


def _without_emptied(
    overrides: Sequence[str], plugins: Plugins
) -> tuple[list[str], dict[str, str]]:
    """The overrides that Hydra is to apply, and, by key, those (``policy=null``) that empty a slot
    whatever else chooses it: Hydra has no null for a group of options."""
    groups = _groups(plugins)
    kept: list[str] = []
    emptied: dict[str, str] = {}
    for override in overrides:
        key, _, value = override.partition("=")
        if key in groups and value == "null":
            emptied[key] = override
        else:
            kept.append(override)
            emptied.pop(key.lstrip("+"), None)  # chosen again
    return kept, emptied


def _groups(plugins: Plugins) -> set[str]:
    """The root keys for which plugins offer files of options, other than tasks and experiments."""
    return {*_GROUPS, *(name for name in plugins.registry.slots if "." not in name)}


def _words(overrides: Sequence[str], plugins: Plugins) -> set[str]:
    """The groups for which an override chooses a file (``policy=mlp``)."""
    groups, found = _groups(plugins), set()
    for override in overrides:
        key, equals, value = override.lstrip("+").partition("=")
        if equals and key in groups and not value.lstrip().startswith("{"):
            found.add(key)
    return found


def _alone(overrides: Sequence[str], groups: set[str]) -> list[str]:
    """Those of the overrides that concern `groups`."""
    return [o for o in overrides if re.split(r"[.=]", o.lstrip("+~"), maxsplit=1)[0] in groups]


def replaced(overrides: Sequence[str], by: Sequence[str]) -> list[str]:
    """`overrides`, then `by`, without those of the former that the latter set anew."""

    def key(override: str) -> str:
        return override.lstrip("+~").partition("=")[0]

    new = {key(o) for o in by}
    return [*(o for o in overrides if key(o) not in new), *by]


def written(value: Any) -> str:
    """Plain data as the value of an override: every string is quoted, whatever is in it."""
    if isinstance(value, Mapping):
        return "{" + ",".join(f"{key}:{written(item)}" for key, item in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ",".join(written(item) for item in value) + "]"
    if isinstance(value, str):
        return QuotedString(value, Quote.single).with_quotes()
    return json.dumps(value)


def _as_given(raw: dict[str, Any], overrides: Sequence[str]) -> dict[str, Any]:
    """`raw` less the options that a component chosen by an override (``policy={name: …}``) would
    inherit from the one that a file chose: Hydra merges the two mappings."""
    given: dict[str, set[str]] = {}
    for override in OverridesParser.create().parse_overrides(list(overrides)):
        key = override.key_or_group
        value = None if override.is_delete() else override.value()
        if isinstance(value, Mapping) and "name" in value:
            given[key] = {str(option) for option in value}
        for above, options in given.items():
            if key.startswith(f"{above}."):
                options.add(key.removeprefix(f"{above}.").partition(".")[0])
    for key, options in given.items():
        component = _at(raw, key)
        if isinstance(component, dict):
            for option in component.keys() - options:
                del component[option]
    return raw


def compose_raw(overrides: Sequence[str], plugins: Plugins | None = None) -> dict[str, Any]:
    """The composed configuration as plain data.

    A part that an override chooses (``policy=mlp``) is as its file has it, and as other overrides
    set it: what the task or experiment says of its own choice is not mixed in.

    Raises
    ------
    ConfigError
        if Hydra cannot compose it, or it contains a key that names code.
    """
    plugins = plugins or installed()
    kept, emptied = _without_emptied(overrides, plugins)
    with _hydra(plugins, overrides):
        config = compose("config", overrides=[_settable(o) for o in kept])
        chosen = _words(kept, plugins)
        if chosen:  # what task and experiment say of other choices does not hold for these
            alone = compose("config", overrides=[_settable(o) for o in _alone(kept, chosen)])
            with open_dict(config):
                for key in chosen:
                    config[key] = alone[key]
        raw = OmegaConf.to_container(config, resolve=True, throw_on_missing=False)
    assert isinstance(raw, dict)
    refuse_code(raw)
    given = _as_given({str(k): v for k, v in raw.items()}, kept) | dict.fromkeys(emptied)
    for path in _missing(given):
        raise ConfigError(f"{path} is not set. Give it a value.")
    return given


def _missing(value: Any, where: str = "") -> Iterator[str]:
    """The key paths at which a value is still to be given."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _missing(item, f"{where}.{key}" if where else str(key))
    elif value == MISSING:
        yield where


def load_experiment(overrides: Sequence[str], plugins: Plugins | None = None) -> Experiment:
    """Compose `overrides` and validate the result."""
    plugins = plugins or installed()
    return validate(compose_raw(overrides, plugins), plugins.registry)


def provenance(overrides: Sequence[str], plugins: Plugins | None = None) -> dict[str, str]:
    """For each key path of the composed configuration, the file (or override) that set it."""
    plugins = plugins or installed()
    origin: dict[str, str] = {}
    overrides, emptied = _without_emptied(overrides, plugins)
    with _hydra(plugins, overrides):
        loader = GlobalHydra.instance().config_loader()
        defaults = loader.compute_defaults_list(
            "config", [_settable(o) for o in overrides], RunMode.RUN
        )
        sources, chosen = _sources(plugins), _words(overrides, plugins)
        for item in defaults.defaults:
            path = item.config_path
            if path is None or path.startswith("hydra/"):
                continue
            for source in sources:
                file = source / f"{path}.yaml"
                if file.is_file():
                    package = item.package or ""
                    prefix = "" if package in ("_global_", "") else package
                    for key in _paths(
                        yaml.safe_load(file.read_text(encoding="utf-8")) or {}, prefix
                    ):
                        group = key.partition(".")[0]
                        if group not in chosen or path.startswith(f"{group}/"):
                            origin[key] = _shorten(file)
        for override in OverridesParser.create().parse_overrides(list(overrides)):
            for key in _paths(override.value(), override.key_or_group):
                if not any(k.startswith(f"{key}.") for k in origin):  # else it chose a file
                    origin[key] = f"command line: {override.input_line}"
    for name, override in emptied.items():
        origin = {k: v for k, v in origin.items() if k != name and not k.startswith(f"{name}.")}
        origin[name] = f"command line: {override}"
    return origin


def _paths(value: Any, prefix: str) -> Iterator[str]:
    if isinstance(value, Mapping):
        for key, item in value.items():
            if key != "defaults" or prefix:
                yield from _paths(item, f"{prefix}.{key}" if prefix else str(key))
    else:
        yield prefix


def _shorten(file: Path) -> str:
    parts = file.parts
    for anchor in ("plugins", "conf"):
        if anchor in parts:
            return "/".join(parts[parts.index(anchor) :])
    return str(file)
