"""Validation: from a composed configuration to one in which every part is found and checked.

A configuration is data. It names components, never Python code: keys by which Hydra would call
code (such as ``_target_``) are refused wherever they are.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from typing import Any

from understudy.errors import ConfigError, suggestion
from understudy.options import (
    Option,
    as_yaml,
    at,
    checked_options,
    filled,
    items,
    make_options,
    options_of,
)
from understudy.setup.config import Chosen, Experiment
from understudy.setup.registry import Registry, Slot
from understudy.setup.root import KEYS, Root
from understudy.task.terms import Outcome, Reduction

__all__ = ["EXTRAS", "refuse_code", "root_keys", "validate"]

#: By kind, what a component takes beside its own options: renamed fields, and how a term counts.
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
    """Find every component that `raw` names, and check every option. A ConfigError names the key
    path of an unknown key or component, or of a missing or wrong value."""
    refuse_code(raw)
    known = root_keys(registry)
    for key in raw:
        if key not in known:
            raise ConfigError(unknown_key(str(key), registry) + registry.absent())
    given = {k: v for k, v in raw.items() if k in KEYS and not (v is None and k in GROUPS)}
    root = make_options(Root, given, "")
    choices = {
        slot.name: tuple(_chosen(slot, at(raw, slot.name), registry))
        for slot in registry.slots.values()
    }
    sections = {}
    for name, section in registry.sections.items():
        if raw.get(name) is not None:
            with section.options.guarded("has options that cannot be read"):
                sections[name] = make_options(section.options.factory, raw[name], name)
    experiment = Experiment(root, choices, sections, registry)
    if root.evaluation.objective != "success_rate":
        experiment.need_measure(root.evaluation.objective, "evaluation.objective")
    _ = experiment.failures
    if root.reward.combine == "product":
        for term in experiment.many("reward.terms"):
            with term.component.guarded("has a range that is none"):
                low, high = getattr(term.component.factory, "range", (0.0, math.inf))
                if low < 0:
                    raise ConfigError(
                        f"{term.where}: '{term.component.name}' lies between {low:g} and {high:g}, "
                        "and reward.combine=product takes no negative terms. Use reward.combine=sum, "
                        "or another term."
                    )
    return experiment


def root_keys(registry: Registry) -> set[str]:
    """The keys at the top level of a configuration."""
    return {slot for slot in registry.slots if "." not in slot}.union(KEYS, registry.sections)


def unknown_key(key: str, registry: Registry) -> str:
    """The error for an unknown key of the root, perhaps typed without what comes before its dot."""
    groups = [o for o in options_of(Root).values() if dataclasses.is_dataclass(o.annotation)]
    meant = [f"{o.name}.{key}" for o in groups if key in options_of(o.annotation)]
    if key == "experiment":  # the content of an experiment's file, put at its own place
        return (
            "An experiment's file, with all that it sets, begins with '# @package _global_', and "
            "this one does not."
        )
    found = suggestion(key, meant or root_keys(registry) | {"experiment"})
    part = f" An option of a part is written as PART.{key}." if "Known" in found else ""
    return f"There is no configuration key '{key}'.{found}{part}"


#: Groups of the root that are emptied by null.
GROUPS = ("reward", "termination")


def _chosen(slot: Slot, value: Any, registry: Registry) -> Iterator[Chosen]:
    """The components that the configuration chooses for `slot`."""
    if value is None:
        return
    if not slot.many:
        yield _choice(slot, slot.name, value, slot.name, registry)
        return
    if not isinstance(value, Mapping):
        raise ConfigError(
            f"{slot.name} must be {{NAME: {{name: COMPONENT, …}}, …}}, not {as_yaml(value)}."
        )
    there = [name for name, item in value.items() if _named_part(item)]
    for name, item in value.items():
        near = "" if _named_part(item) else suggestion(str(name), there)
        if isinstance(item, Mapping) and "Did you mean" in near:
            raise ConfigError(
                f"{slot.name} has no '{name}'.{near} A new one is written "
                f"'{slot.name}.{name}={{name: COMPONENT, …}}'."
            )
        if item is not None:
            yield _choice(slot, str(name), item, f"{slot.name}.{name}", registry)


def _choice(slot: Slot, name: str, value: Any, where: str, registry: Registry) -> Chosen:
    component_name, options = _named(value, where)
    component = registry.find(slot.kind, component_name, where)
    extra = EXTRAS.get(slot.kind, {})
    checked: Any = checked_options({**component.options, **extra}, options, where)
    extras = {key: checked.pop(key) for key in extra}
    with component.guarded("has options that cannot be read"):
        if (schema := getattr(component.factory, "Options", None)) is not None:
            checked = filled(schema, checked, where)
        elif (limits := getattr(component.factory, "limits", None)) is not None:
            filled(limits, checked, where)
    # A function has keyword-only parameters for options; a class without Options has none.
    return Chosen(name, component, checked or None, where, extras)


def _named_part(value: Any) -> bool:
    """Whether `value` names a component."""
    return isinstance(value, str) or (isinstance(value, Mapping) and "name" in value)


def _named(value: Any, where: str) -> tuple[str, dict[str, Any]]:
    if isinstance(value, str):
        return value, {}
    if not isinstance(value, Mapping) or not isinstance(value.get("name"), str):
        raise ConfigError(
            f"{where} must be {{name: COMPONENT, option: value, …}}, not {as_yaml(value)}."
        )
    options = dict(value)
    return options.pop("name"), options


#: Keys by which Hydra's instantiate calls code.
CODE_KEYS = frozenset({"_target_", "_partial_", "_args_", "_recursive_", "_convert_"})


def refuse_code(value: Any) -> None:
    """Raise :class:`ConfigError` if any key in the nested `value` could name code."""
    for path, _ in items(value):
        if path.rpartition(".")[2] in CODE_KEYS:
            raise ConfigError(
                f"{path}: configurations name registered components (name: …) and never Python code. "
                "Remove the key; `understudy plugins` lists what can be named."
            )
