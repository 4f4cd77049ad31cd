"""Configuration: what one consists of, validated against the registry.

A configuration is data. It names components; it never names Python code, and keys by which Hydra
would call code (``_target_`` and its like) are refused wherever they stand.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from understudy.errors import ConfigError, suggestion
from understudy.inputs import Inputs
from understudy.options import Option, check_range, checked_options, make_options, options_of
from understudy.setup.registry import Component, Registry, Slot
from understudy.task.terms import Outcome, Reduction

__all__ = [
    "EXTRAS",
    "Chosen",
    "Experiment",
    "Part",
    "Root",
    "at",
    "refuse_code",
    "root_keys",
    "validate",
]

#: The most steps of physics in a decision, and decisions in an episode of an evaluation.
_STEPS, _DECISIONS = 100_000, 1_000_000


@dataclass(frozen=True)
class ControlOptions:
    """Control and physics rates; 30 Hz control, 600 Hz physics by default (thesis, section 3.5)."""

    frequency: float = 30.0  #: control periods per second
    substeps: int = 20  #: physics steps per control period
    decision: int = 1  #: control periods that one decision of the policy lasts

    def __post_init__(self) -> None:
        check_range(self, "frequency", above=0, most=1e5)
        check_range(self, "substeps", least=1, most=10_000)
        check_range(self, "decision", least=1, most=10_000)
        if self.substeps * self.decision > _STEPS:
            raise ValueError(
                f"decision={self.decision} is not possible: with substeps={self.substeps} a decision would be "
                f"more than {_STEPS} steps of physics."
            )


@dataclass(frozen=True)
class ResolutionOptions:
    """Coarser physics that a training begins with; ``control.substeps`` is what it is judged by.

    It goes over to the latter, *sharpens*, as soon as the criterion is met at the coarse physics, the
    curriculum has come to `difficulty`, or the share `budget` of the budget is spent.
    """

    substeps: int | None = None  #: physics steps per control period at first; null is the task's
    difficulty: float | None = None  #: mean difficulty at which physics sharpens; null is none
    budget: float = 0.75  #: share of the samples, or of the minutes, after which physics sharpens

    def __post_init__(self) -> None:
        check_range(self, "substeps", least=1)
        check_range(self, "difficulty", least=0, most=1)
        check_range(self, "budget", above=0, most=1)


@dataclass(frozen=True)
class EpisodeOptions:
    seconds: float = 20.0  #: episodes are truncated at this length

    def __post_init__(self) -> None:
        check_range(self, "seconds", above=0, most=1e7)


@dataclass(frozen=True)
class BudgetOptions:
    """A training ends at whichever of these it reaches first; both are absolute over resumes."""

    samples: int | None = None  #: environment steps, summed over worlds
    minutes: float | None = None  #: minutes of training time
    #: After so many ``evaluation.criterion`` is usually met, as far as is known: for the time shown.
    usual_samples: int | None = None

    def __post_init__(self) -> None:
        check_range(self, "samples", "minutes", "usual_samples", above=0)


@dataclass(frozen=True)
class MeasureThreshold:
    """Success by a measure: its value over the episode lies within these limits."""

    measure: str  #: name of the measure
    at_least: float | None = None  #: in the measure's unit
    at_most: float | None = None  #: in the measure's unit

    def __post_init__(self) -> None:
        if self.at_least is None and self.at_most is None:
            raise ValueError("at_least and at_most are both unset: give one of them.")


@dataclass(frozen=True)
class EvaluationOptions:
    """How a policy is judged: deterministic, from starts that training never saw."""

    episodes: int = 64  #: of one draw of starts, all at once
    final_episodes: int = 128  #: of the draw that confirms a criterion, and of the last one
    seconds: float = 20.0  #: episodes are cut at this length
    starts: Mapping[str, Any] = field(default_factory=dict)  #: where they begin; the first decides
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
    give_up: bool = True  #: once the criterion is out of reach; its measures are then not recorded
    #: An evaluation starts when training episodes would last this share of its seconds …
    gate: float = 0.3
    #: … and this many samples were consumed since the last one; null is 100 000 where there is a
    #: criterion, and never where there is none.
    every_samples: int | None = None

    def __post_init__(self) -> None:
        check_range(self, "episodes", "final_episodes", least=1)
        check_range(self, "seconds", above=0, most=1e7)
        check_range(self, "criterion", above=0, most=1)
        check_range(self, "gate", least=0, most=1)
        check_range(self, "every_samples", least=0, most=2**63 - 1)


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
    video_seconds: float = 8.0  #: of the film when a training ends; 0 makes none
    video_size: tuple[int, int] | None = None  #: width and height in pixels; null is the report's
    video_camera: float | None = None  #: degrees about the vertical; 0 is from behind, 90 the right

    def __post_init__(self) -> None:
        check_range(self, "video_seconds", least=0, most=3600)
        check_range(self, "video_size", least=1, most=8192)


#: What a run can take over from another one.
Part = Literal["actor", "critic", "normaliser", "initial_states", "curriculum"]


@dataclass(frozen=True)
class StartOptions:
    """Begin with parts of another run's newest checkpoint."""

    run: str  #: its folder
    parts: tuple[Part, ...] = ("actor", "critic", "normaliser")  #: what is taken over


@dataclass(frozen=True)
class RewardOptions:
    terms: Mapping[str, Any] = field(default_factory=dict)  #: by name: {name: COMPONENT, weight: 1}
    #: ``sum``: each term times its weight, added. ``product``: each term to the power of its weight,
    #: multiplied; none may be negative.
    combine: Literal["sum", "product"] = "product"


@dataclass(frozen=True)
class TerminationOptions:
    terms: Mapping[str, Any] = field(default_factory=dict)  #: by name: {name: COMPONENT}


@dataclass(frozen=True)
class Root:
    """The top level of a configuration, beside the slots and plugins' sections."""

    seed: int = 0  #: of all random streams, from 0
    device: str = "cpu"  #: torch's name of it
    num_worlds: int = 256  #: trained in at once, from 1
    difficulty: float = 1.0  #: in [0, 1]: what evaluations run at, and trainings lead to
    task: str | None = None  #: its name, where one was chosen
    control: ControlOptions = field(default_factory=ControlOptions)  #: how often the policy decides
    resolution: ResolutionOptions = field(
        default_factory=ResolutionOptions
    )  #: how coarse physics begins
    episode: EpisodeOptions = field(default_factory=EpisodeOptions)  #: of training
    budget: BudgetOptions = field(default_factory=BudgetOptions)  #: when a training ends
    evaluation: EvaluationOptions = field(
        default_factory=EvaluationOptions
    )  #: how a policy is judged
    checkpoint: CheckpointOptions = field(
        default_factory=CheckpointOptions
    )  #: what is saved, and how often
    run: RunOptions = field(default_factory=RunOptions)  #: where it goes, and its film
    start: StartOptions | None = None  #: what is taken over from another run
    reward: RewardOptions = field(default_factory=RewardOptions)  #: what is rewarded
    termination: TerminationOptions = field(
        default_factory=TerminationOptions
    )  #: what ends an episode

    def __post_init__(self) -> None:
        check_range(self, "num_worlds", least=1)
        check_range(self, "seed", least=0, most=2**63 - 1)
        check_range(self, "difficulty", least=0, most=1)
        decisions = self.evaluation.seconds * self.control.frequency / self.control.decision
        if decisions > _DECISIONS:
            raise ValueError(
                f"evaluation.seconds={self.evaluation.seconds:g} is not possible: an episode would be more than "
                f"{_DECISIONS} decisions."
            )
        coarse, own = self.resolution.substeps, self.control.substeps
        if coarse is not None and coarse > own:
            raise ValueError(
                f"resolution.substeps={coarse} is not possible: physics begins coarser than it ends, "
                f"so give at most control.substeps={own}, or null."
            )


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
    inputs: Inputs = field(default_factory=Inputs)

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
                f"{slot} is not set. Choose an experiment (experiment=…), or set it ({slot}=…)."
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

    Raises:
        ConfigError: for an unknown key or component, a missing or wrong value; the message has the
            key path.
    """
    refuse_code(raw)
    own = {f.name for f in dataclasses.fields(Root)}
    known = root_keys(registry)
    for key in raw:
        if key not in known:
            raise ConfigError(unknown_key(str(key), registry) + registry.absent())
    filled = {k: v for k, v in raw.items() if k in own and not (v is None and k in GROUPS)}
    root = make_options(Root, filled, "")
    choices = {
        slot.name: tuple(_chosen(slot, at(raw, slot.name), registry))
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
    if root.reward.combine == "product":
        for term in experiment.many("reward.terms"):
            _refuse_negative(term)
    return experiment


def _refuse_negative(term: Chosen) -> None:
    """Raise :class:`ConfigError` for a term of a product that says it can be negative."""
    low, high = getattr(term.component.factory, "range", (0.0, math.inf))
    if low < 0:
        raise ConfigError(
            f"{term.where}: '{term.component.name}' lies between {low:g} and {high:g}, and "
            "reward.combine=product takes no negative terms. Use reward.combine=sum, or another term."
        )


def root_keys(registry: Registry) -> set[str]:
    """The keys at the top level of a configuration."""
    slots = {slot for slot in registry.slots if "." not in slot}
    return {f.name for f in dataclasses.fields(Root)} | slots | set(registry.sections)


def unknown_key(key: str, registry: Registry) -> str:
    """The sentence about a root key that is none; one may have left out what stands before a dot."""
    groups = [o for o in options_of(Root).values() if dataclasses.is_dataclass(o.annotation)]
    meant = [f"{o.name}.{key}" for o in groups if key in options_of(o.annotation)]
    found = suggestion(key, meant or root_keys(registry) | {"experiment"})
    part = f" An option of a part is written as PART.{key}." if "Known" in found else ""
    return f"There is no configuration key '{key}'.{found}{part}"


#: Groups of the root that an override of null empties.
GROUPS = ("reward", "termination")


def at(raw: Any, path: str) -> Any:
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
    own = {k: v for k, v in options.items() if k not in extra}
    schema = getattr(component.factory, "Options", None)
    checked: Any
    if schema is not None:
        checked = make_options(schema, own, where)
    else:  # a function's options are its keyword-only parameters; a class without Options has none
        checked = checked_options(component.options, own, where) or None
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
