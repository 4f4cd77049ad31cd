"""Configuration: composed by Hydra from the plugins' options, validated against the registry.

A configuration is data. It names components; it never names Python code, and keys by which Hydra
would call code (``_target_`` and its like) are refused wherever they stand.
"""

from __future__ import annotations

import contextlib
import dataclasses
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
from hydra.core.plugins import Plugins as HydraPlugins
from hydra.errors import HydraException
from hydra.plugins.search_path_plugin import SearchPathPlugin
from hydra.types import RunMode
from omegaconf import OmegaConf
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException

from understudy.errors import ConfigError, suggestion
from understudy.options import Option, check_range, checked_options, make_options
from understudy.running.environment import Outcome
from understudy.setup.plugins import Plugins, installed
from understudy.setup.registry import Component, Registry


@dataclass(frozen=True)
class ControlOptions:
    """Control and physics rates; 30 Hz control, 600 Hz physics by default (thesis, section 3.5)."""

    frequency: float = 30.0  #: control steps per second
    substeps: int = 20  #: physics steps per control step

    def __post_init__(self) -> None:
        check_range(self, "frequency", above=0, most=1e5)
        check_range(self, "substeps", least=1, most=100_000)


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
class EvaluationOptions:
    """How a policy is judged: deterministic, on fresh initial states, until a failure term fires."""

    episodes: int = 64
    seconds: float = 20.0
    #: Termination terms that count as failures; the others are only reported.
    failures: tuple[str, ...] = ()
    #: Share of successful episodes at which a training is done; null trains to the budget.
    criterion: float | None = None
    #: An evaluation starts when this share of training episodes' time was survived …
    gate: float = 0.3
    #: … and this many samples were consumed since the last one.
    every_samples: int = 100_000

    def __post_init__(self) -> None:
        check_range(self, "episodes", least=1)
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
    dir: str | None = None  #: run folder; null makes ``runs/<task>-<n>``
    video_seconds: float = 8.0

    def __post_init__(self) -> None:
        check_range(self, "video_seconds", least=0)


@dataclass(frozen=True)
class TermSet:
    terms: Mapping[str, Any] = field(default_factory=dict)
    combine: Literal["sum", "product"] = "product"


@dataclass(frozen=True)
class TerminationSet:
    terms: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Root:
    """The top level of a configuration. Plugins' sections stand beside these."""

    seed: int = 0
    device: str = "cpu"
    num_worlds: int = 256
    task: str | None = None
    control: ControlOptions = field(default_factory=ControlOptions)
    episode: EpisodeOptions = field(default_factory=EpisodeOptions)
    budget: BudgetOptions = field(default_factory=BudgetOptions)
    evaluation: EvaluationOptions = field(default_factory=EvaluationOptions)
    checkpoint: CheckpointOptions = field(default_factory=CheckpointOptions)
    run: RunOptions = field(default_factory=RunOptions)
    scene: Any = None
    simulator: Any = None
    fields: Mapping[str, Any] = field(default_factory=dict)
    encoder: Mapping[str, Any] = field(default_factory=dict)
    actuation: Any = None
    reward: TermSet = field(default_factory=TermSet)
    termination: TerminationSet = field(default_factory=TerminationSet)
    initial_states: Any = None
    policy: Any = None
    learner: Any = None
    outer_loop: Any = None
    executor: Any = None

    def __post_init__(self) -> None:
        check_range(self, "num_worlds", least=1)
        check_range(self, "seed", least=0, most=2**63 - 1)


@dataclass(frozen=True)
class Choice:
    """A component chosen by the configuration, with its validated options."""

    component: Component
    options: Any
    where: str

    def build(self, context: Any) -> Any:
        return self.component.factory(self.options, context)


@dataclass(frozen=True)
class TermChoice:
    """A term chosen by the configuration: a function, its options, and how it counts."""

    name: str
    component: Component
    options: Mapping[str, Any]
    weight: float = 1.0
    outcome: Outcome = "failure"


@dataclass(frozen=True)
class Experiment:
    """A validated configuration: every component found, every option of the right type."""

    root: Root
    raw: Mapping[str, Any]
    scene: Choice
    simulator: Choice
    fields: Mapping[str, Choice]
    encoders: Mapping[str, Choice]
    actuation: Choice
    initial_states: Choice
    rewards: tuple[TermChoice, ...]
    terminations: tuple[TermChoice, ...]
    policy: Choice | None
    learner: Choice | None
    outer_loop: Choice | None
    executor: Choice | None
    sections: Mapping[str, Any]
    registry: Registry

    def components(self) -> Iterator[Component]:
        """Every component in use."""
        for value in vars(self).values():
            if isinstance(value, Choice):
                yield value.component
            elif isinstance(value, Mapping):
                yield from (v.component for v in value.values() if isinstance(v, Choice))
            elif isinstance(value, tuple):
                yield from (v.component for v in value)


SINGLE_SLOTS = ("scene", "simulator", "actuation", "initial_states")
OPTIONAL_SLOTS = ("policy", "learner", "outer_loop", "executor")


def validate(raw: Mapping[str, Any], registry: Registry) -> Experiment:
    """Look up every component that `raw` names and check every option.

    Raises
    ------
    ConfigError
        for an unknown key or component, a missing or wrong value; the message has the key path.
    """
    refuse_code(raw)
    known = {f.name for f in dataclasses.fields(Root)}
    for key in raw:
        if key not in known and key not in registry.sections:
            raise ConfigError(
                f"There is no configuration key '{key}'.{suggestion(str(key), known | set(registry.sections))}"
            )
    root = make_options(Root, {k: v for k, v in raw.items() if k in known}, "")

    def choice(kind: str, value: Any, where: str, required: bool = True) -> Any:
        if value is None:
            if not required:
                return None
            raise ConfigError(
                f"{where} is not set, so there is no task. Choose an experiment (experiment=…) or a "
                f"{kind} ({where}=…).{suggestion('', registry.names(kind))}"
            )
        name, options = _named(value, where)
        component = registry.find(kind, name, where)
        schema = getattr(component.factory, "Options", None)
        if schema is not None:
            return Choice(component, make_options(schema, options, where), where)
        checked_options({}, options, where)
        return Choice(component, None, where)

    def term(kind: str, name: str, value: Any) -> TermChoice:
        where = f"{kind}.terms.{name}"
        component_name, options = _named(value, where)
        extra: dict[str, Option] = {
            "reward": {"weight": Option("weight", float, 1.0)},
            "termination": {"outcome": Option("outcome", Outcome, "failure")},
        }[kind]
        component = registry.find(kind, component_name, where)
        checked = checked_options({**component.options, **extra}, options, where)
        own = {k: v for k, v in checked.items() if k not in extra}
        counts = {k: v for k, v in checked.items() if k in extra}
        return TermChoice(name, component, own, **counts)

    single = {slot: choice(slot, getattr(root, slot), slot) for slot in SINGLE_SLOTS}
    optional = {slot: choice(slot, getattr(root, slot), slot, False) for slot in OPTIONAL_SLOTS}
    if not any(root.reward.terms.values()):
        raise ConfigError("reward.terms is empty: a task needs at least one reward term.")
    if not any(root.encoder.values()):
        raise ConfigError("encoder is empty: a task needs at least one encoder.")
    terminations = tuple(
        term("termination", k, v) for k, v in root.termination.terms.items() if v is not None
    )
    names = {t.name for t in terminations}
    for failure in root.evaluation.failures:
        if failure not in names:
            raise ConfigError(
                f"evaluation.failures names '{failure}', which is no termination term of this "
                f"task.{suggestion(failure, names)}"
            )
    return Experiment(
        root=root,
        raw=raw,
        **single,
        **optional,
        fields={
            k: choice("fields", v, f"fields.{k}") for k, v in root.fields.items() if v is not None
        },
        encoders={
            k: choice("encoder", v, f"encoder.{k}")
            for k, v in root.encoder.items()
            if v is not None
        },
        rewards=tuple(term("reward", k, v) for k, v in root.reward.terms.items() if v is not None),
        terminations=terminations,
        sections={
            name: make_options(section.schema(), raw[name], name)
            for name, section in registry.sections.items()
            if raw.get(name) is not None
        },
        registry=registry,
    )


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


def kernel_conf() -> Path:
    """The kernel's own config directory (``conf/`` at the top of the source tree)."""
    here = Path(__file__).resolve()
    packaged = here.parents[1] / "conf"
    return packaged if packaged.is_dir() else here.parents[3] / "conf"


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
    if isinstance(error, MissingMandatoryValue):
        return f"{getattr(error, 'full_key', None) or text} is not set. Give it a value."
    stray = re.search(r"Could not override '(\w+)'", text)
    if stray:
        known = {f.name for f in dataclasses.fields(Root)} | set(plugins.registry.sections)
        return f"There is no configuration key '{stray[1]}'.{suggestion(stray[1], known)}"
    return text or type(error).__name__


def _sources(plugins: Plugins) -> list[Path]:
    """The directories of config options: the kernel's, then each plugin's."""
    return [kernel_conf(), *(directory for _, directory in plugins.config_directories())]


def _settable(override: str) -> str:
    """Let ``a.b=value`` set an option that no file mentions; validation knows which ones exist."""
    key, equals, value = override.partition("=")
    plain = bool(equals and key) and key[0] not in "+~"
    return f"++{override}" if plain and ("." in key or value.startswith("{")) else override


def replaced(overrides: Sequence[str], by: Sequence[str]) -> list[str]:
    """`overrides`, then `by`, without those of the former that the latter set anew."""

    def key(override: str) -> str:
        return override.lstrip("+~").partition("=")[0]

    new = {key(o) for o in by}
    return [*(o for o in overrides if key(o) not in new), *by]


def compose_raw(overrides: Sequence[str], plugins: Plugins | None = None) -> dict[str, Any]:
    """The composed configuration as plain data.

    Raises
    ------
    ConfigError
        if Hydra cannot compose it, or it contains a key that names code.
    """
    with _hydra(plugins or installed(), overrides):
        config = compose("config", overrides=[_settable(o) for o in overrides])
        raw = OmegaConf.to_container(config, resolve=True, throw_on_missing=True)
    assert isinstance(raw, dict)
    refuse_code(raw)
    return {str(k): v for k, v in raw.items()}


def load_experiment(overrides: Sequence[str], plugins: Plugins | None = None) -> Experiment:
    """Compose `overrides` and validate the result."""
    plugins = plugins or installed()
    return validate(compose_raw(overrides, plugins), plugins.registry)


def provenance(overrides: Sequence[str], plugins: Plugins | None = None) -> dict[str, str]:
    """For each key path of the composed configuration, the file (or override) that set it."""
    plugins = plugins or installed()
    origin: dict[str, str] = {}
    with _hydra(plugins, overrides):
        loader = GlobalHydra.instance().config_loader()
        defaults = loader.compute_defaults_list(
            "config", [_settable(o) for o in overrides], RunMode.RUN
        )
        sources = _sources(plugins)
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
                        origin[key] = _shorten(file)
        for override in OverridesParser.create().parse_overrides(list(overrides)):
            for key in _paths(override.value(), override.key_or_group):
                if not any(k.startswith(f"{key}.") for k in origin):  # else it chose a file
                    origin[key] = f"command line: {override.input_line}"
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
