"""Hydra's composing from files of options, less its own settings and its reading the same file twice.

Hydra chooses the files. What they say is merged here, with numbers as they were typed beside their
values. Its compose API knows values alone, and adds thirteen files for launchers, sweepers and
logging to the seven that a composition needs, and throws them away.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import os
import pickle
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from stat import S_ISREG
from typing import Any

import yaml
from hydra import version
from hydra._internal import defaults_list as defaults
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.config_repository import ConfigRepository
from hydra._internal.core_plugins.file_config_source import FileConfigSource
from hydra.core.default_element import ResultDefault
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.plugins.config_source import ConfigResult, ConfigSource
from omegaconf import DictConfig, OmegaConf
from omegaconf._utils import get_yaml_loader

from understudy.errors import ConfigError
from understudy.options import as_typed, each, plain

__all__ = ["OptionFiles", "choices", "compose", "parsed"]

#: A file's path, time of change, size and number.
State = tuple[str, int, int, int]
#: What was read: which files a file builds on, pickled, and what else it says.
_read: dict[State, tuple[bytes, dict[str, Any]]] = {}
#: What was merged, by folders, overrides that choose files and groups of their own: the files that
#: were asked for, and it, pickled, since a copy is slower by far.
_merged: dict[tuple[str | None, ...], tuple[dict[str, State | None], bytes]] = {}
#: Stands before a number in a word of the command line, whose text is to be kept beside its value.
MARK = "\ue000"
_gather = defaults._create_interpolation_map  # for ``${…}``; Hydra does so for every file
defaults._create_interpolation_map = lambda overrides, chosen, own: (
    _gather(overrides, chosen, own) if "${" in str([*map(vars, chosen)]) else None
)


@functools.lru_cache(1024)
def parsed(override: str) -> Override:
    """What Hydra reads in it; a HydraException or RecursionError if it can read nothing."""
    return OverridesParser.create().parse_overrides([override])[0]


class _Loader(get_yaml_loader()):
    """OmegaConf's, with numbers as they are typed, and keys that are text."""

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        value = super().construct_object(node, deep)
        scalar = isinstance(node, yaml.ScalarNode) and node.style is None
        return as_typed(value, node.value) if scalar else value

    def construct_mapping(self, node: yaml.Node, deep: bool = False) -> dict[str, Any]:
        return {str(key): value for key, value in super().construct_mapping(node, deep).items()}


class OptionFiles(ConfigRepository):
    """The files in `folders`, for one composition; one that has not changed is not parsed anew."""

    def __init__(self, folders: Iterable[Path]) -> None:
        self.sources = [FileConfigSource("understudy", f"file://{folder}") for folder in folders]
        self.folders = {source.path: {*os.listdir(source.path)} for source in self.sources}
        self.states: dict[str, State | None] = {}  #: by name, of all files that were asked for

    def group_exists(self, config_path: str) -> bool:
        return any(os.path.isdir(os.path.join(f, config_path)) for f in self._with(config_path))

    def _with(self, config_path: str) -> list[str]:  # to ask every folder takes long
        first = config_path.partition("/")[0]
        file, odd = f"{first}.yaml", not first.isidentifier()
        return [f for f, has in self.folders.items() if first in has or file in has or odd]

    def load_config(self, config_path: str) -> ConfigResult | None:
        found = self._found(config_path)
        return found and pickle.loads(found[0])  # Hydra changes what it is given

    def content(self, default: ResultDefault) -> dict[str, Any]:
        """What the file of that choice says, at the place where it is put."""
        _, content = self._found(default.config_path or "") or (None, {})
        for key in reversed((default.package or "").split(".")):
            content = {key: content} if key not in ("", "_global_") else content
        return content

    def _found(self, config_path: str) -> tuple[bytes, dict[str, Any]] | None:
        state = self.states[config_path] = self.states.get(config_path) or self._state(config_path)
        if state and state not in _read:
            text = Path(state[0]).read_text(encoding="utf-8-sig")
            try:
                content = _Loader(text).get_single_data() or {}
            except yaml.YAMLError as error:
                said = " ".join(str(error).split())[:300]
                raise ConfigError(f"{state[0]} cannot be read: {said}. Correct it.") from error
            if not isinstance(content, dict):
                raise ConfigError(f"{state[0]} is no mapping of keys to values. Write KEY: VALUE.")
            chosen = OmegaConf.create({"defaults": plain(content.pop("defaults", []))})
            named: Any = self._extract_defaults_list(config_path, chosen)
            named = self._create_defaults_list(config_path, named)
            header = ConfigSource._get_header_dict(text[:512])
            found = ConfigResult("understudy", state[0], chosen, header, named)
            _read[state] = pickle.dumps(found), content
        return _read[state] if state else None

    def _state(self, config_path: str) -> State | None:
        """The first file of that name, and what changes when its content does."""
        for folder in self._with(config_path):
            file = os.path.join(folder, f"{config_path.removesuffix('.yaml')}.yaml")
            with contextlib.suppress(OSError, ValueError):  # no file, or what none can be named
                found = os.stat(file)
                if S_ISREG(found.st_mode):
                    return (file, found.st_mtime_ns, found.st_size, found.st_ino)
        return None


def choices(files: OptionFiles, overrides: Sequence[str]) -> defaults.DefaultsList:
    """The files that ``config.yaml`` and `overrides` choose, and which overrides set values."""
    version.setbase("1.3")
    return defaults.create_defaults_list(
        files, "config", [parsed(o) for o in overrides], prepend_hydra=False, skip_missing=False
    )


def compose(
    folders: Iterable[Path], overrides: Sequence[str], own: Collection[str] = ()
) -> DictConfig:
    """What Hydra composes from the files in `folders`, whatever its errors; a number of which its
    value does not say how it was typed is a :class:`understudy.options.Typed`.

    Of the groups `own` nothing is taken but what their own files say. A component that an override
    names (``policy={name: …}``) takes the place of what stands there, which Hydra would merge.
    """
    files = OptionFiles(folders)
    read = [parsed(override) for override in overrides]
    values = defaults.Overrides(files, read).config_overrides
    chosen = (o.input_line for o in read if o not in values)
    key = (*(s.path for s in files.sources), None, *chosen, None, *sorted(own))
    states, merged = _merged.get(key, ({}, b""))
    if not merged or any(files._state(name) != state for name, state in states.items()):
        content: dict[str, Any] = {}
        for default in choices(files, overrides).defaults:
            others = {key for key in own if not str(default.config_path).startswith(f"{key}/")}
            said = files.content(default)
            content = _laid(content, {k: v for k, v in said.items() if k not in others})
        config = OmegaConf.create(content, flags={"allow_objects": True, "struct": True})
        _merged[key] = files.states, (merged := pickle.dumps(config))
    config = pickle.loads(merged)
    for override in values:
        value = each(override.value(), _number)
        if isinstance(value, Mapping) and "name" in value and not override.is_delete():
            OmegaConf.update(config, override.key_or_group, {}, merge=False, force_add=True)
        override = dataclasses.replace(override, _value=value)
        ConfigLoaderImpl._apply_overrides_to_config([override], config)
    return config


def _laid(old: Any, new: Any) -> Any:
    """`new` laid over `old`: mappings are merged, and all else is replaced."""
    if not (isinstance(old, Mapping) and isinstance(new, Mapping)):
        return new
    return {**old, **{key: _laid(old.get(key), item) for key, item in new.items()}}


def _number(value: Any) -> Any:
    """The number that :data:`MARK` stands before, as it was typed; any other `value` itself."""
    if not (isinstance(value, str) and value.startswith(MARK)):
        return value
    text = value.removeprefix(MARK)
    return as_typed(parsed(f"x={text}").value(), text)
