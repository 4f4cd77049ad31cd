"""Configurations composed by Hydra from the options of the kernel and of all plugins."""

from __future__ import annotations

import contextlib
import dataclasses
import re
import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.plugins import Plugins as HydraPlugins
from hydra.errors import HydraException
from hydra.plugins.search_path_plugin import SearchPathPlugin
from omegaconf import MISSING, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException

from understudy.errors import ConfigError, suggestion
from understudy.setup.config import GROUPS, Experiment, Root, at, refuse_code, validate
from understudy.setup.plugins import Plugins, installed, kernel_conf

_active = threading.local()


class UnderstudySearchPath(SearchPathPlugin):
    """Adds every plugin's config directory to Hydra's search path."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        plugins: Plugins | None = getattr(_active, "plugins", None)
        if plugins is not None:
            for name, directory in plugins.config_directories():
                search_path.append(provider=f"understudy plugin {name}", path=f"file://{directory}")


@contextlib.contextmanager
def hydra_session(plugins: Plugins, overrides: Sequence[str]) -> Iterator[None]:
    """Inside, Hydra composes from the options of the kernel and of `plugins`; its errors become ours."""
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
        folders = [folder / group for folder in option_directories(plugins)]
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


def option_directories(plugins: Plugins) -> list[Path]:
    """The directories of config options: the kernel's, then each plugin's."""
    return [kernel_conf(), *(directory for _, directory in plugins.config_directories())]


#: Root keys that are values, not groups of options.
_VALUES = frozenset(f.name for f in dataclasses.fields(Root)) - {"task", "reward", "termination"}


def settable(override: str) -> str:
    """Let ``a.b=value`` set an option that no file mentions; validation knows which ones exist."""
    key, equals, value = override.partition("=")
    plain = bool(equals and key) and key[0] not in "+~"
    sets = "." in key or value.startswith("{") or key in _VALUES
    return f"++{override}" if plain and sets else override


def without_emptied(overrides: Sequence[str], plugins: Plugins) -> tuple[list[str], dict[str, str]]:
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
    return {*GROUPS, *(name for name in plugins.registry.slots if "." not in name)}


def words(overrides: Sequence[str], plugins: Plugins) -> set[str]:
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
        component = at(raw, key)
        if isinstance(component, dict):
            for option in component.keys() - options:
                del component[option]
    return raw


def compose_raw(overrides: Sequence[str], plugins: Plugins | None = None) -> dict[str, Any]:
    """The composed configuration as plain data.

    A part that an override chooses (``policy=mlp``) is as its file has it, and as other overrides
    set it: what the task or experiment says of its own choice is not mixed in.

    Raises:
        ConfigError: if Hydra cannot compose it, or it contains a key that names code.
    """
    plugins = plugins or installed()
    kept, emptied = without_emptied(overrides, plugins)
    with hydra_session(plugins, overrides):
        config = compose("config", overrides=[settable(o) for o in kept])
        chosen = words(kept, plugins)
        if chosen:  # what task and experiment say of other choices does not hold for these
            alone = compose("config", overrides=[settable(o) for o in _alone(kept, chosen)])
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
