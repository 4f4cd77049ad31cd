"""Hydra's composing from files of options, less its own settings and its reading the same file twice.

Hydra chooses the files. What they say is merged here, with numbers as they were typed beside their
values. Its compose API knows values alone, and adds thirteen files for launchers, sweepers and
logging to the seven that a composition needs, and throws them away.
"""

from __future__ import annotations

import contextlib
import copy
import functools
import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from stat import S_ISREG
from typing import Any

import yaml
from hydra import version
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.config_repository import ConfigRepository
from hydra._internal.core_plugins.file_config_source import FileConfigSource
from hydra._internal.defaults_list import DefaultsList, Overrides, create_defaults_list
from hydra.core.default_element import ResultDefault
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from hydra.plugins.config_source import ConfigResult, ConfigSource
from omegaconf import DictConfig, OmegaConf
from omegaconf._utils import get_yaml_loader

from understudy.errors import ConfigError
from understudy.options import as_typed, each, plain

__all__ = ["OptionFiles", "choices", "compose", "parsed"]

#: A file's path, time of change, size and number.
State = tuple[str, int, int, int]
#: What was read: which files a file builds on, and what else it says.
_read: dict[State, tuple[ConfigResult, dict[str, Any]]] = {}
#: The files asked for and what was merged, by folders, overrides that choose files, own groups.
_merged: dict[tuple[str | None, ...], tuple[dict[str, State | None], DictConfig]] = {}
#: Stands before a number in a word of the command line, whose text is to be kept beside its value.
MARK = "\ue000"


@functools.lru_cache(1024)
def parsed(override: str) -> Override:
    """What Hydra reads in it; a HydraException or RecursionError if it can read nothing."""
    try:
        return OverridesParser.create().parse_overrides([override])[0]
    except ValueError as error:  # of a number with more digits than Python reads
        raise HydraException(str(error)) from error


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
        self.states: dict[str, State | None] = {}  #: by name, of all files that were asked for

    def group_exists(self, config_path: str) -> bool:
        return any(os.path.isdir(os.path.join(s.path, config_path)) for s in self.sources)

    def load_config(self, config_path: str) -> ConfigResult | None:
        found, _ = self._found(config_path) or (None, {})  # Hydra changes the list of it
        return found and replace(found, defaults_list=copy.deepcopy(found.defaults_list))

    def content(self, default: ResultDefault) -> dict[str, Any]:
        """What the file of that choice says, at the place where it is put."""
        _, content = self._found(default.config_path or "") or (None, {})
        for key in reversed((default.package or "").split(".")):
            content = {key: content} if key not in ("", "_global_") else content
        return content

    def _found(self, config_path: str) -> tuple[ConfigResult, dict[str, Any]] | None:
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
            named = self._extract_defaults_list(config_path, chosen)
            defaults = self._create_defaults_list(config_path, named)
            header = ConfigSource._get_header_dict(text[:512])
            _read[state] = ConfigResult("understudy", state[0], chosen, header, defaults), content
        return _read[state] if state else None

    def _state(self, config_path: str) -> State | None:
        """The first file of that name, and what changes when its content does."""
        name = f"/{config_path.removesuffix('.yaml')}.yaml"
        with contextlib.suppress(OSError, ValueError):  # it just went, or no file can be named so
            for file in (source.path + name for source in self.sources):
                if os.access(file, os.F_OK) and S_ISREG((found := os.stat(file)).st_mode):
                    return (file, found.st_mtime_ns, found.st_size, found.st_ino)
        return None


def choices(files: OptionFiles, overrides: Sequence[str]) -> DefaultsList:
    """The files that ``config.yaml`` and `overrides` choose, and which overrides set values."""
    version.setbase("1.3")
    return create_defaults_list(
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
    values = Overrides(files, read).config_overrides
    chosen = (o.input_line for o in read if o not in values)
    key = (*(s.path for s in files.sources), None, *chosen, None, *sorted(own))
    states, config = _merged.get(key, ({}, None))
    if not config or any(files._state(name) != state for name, state in states.items()):
        content: dict[str, Any] = {}
        for default in choices(files, overrides).defaults:
            others = {key for key in own if not str(default.config_path).startswith(f"{key}/")}
            said = files.content(default)
            content = _laid(content, {k: v for k, v in said.items() if k not in others})
        config = OmegaConf.create(content, flags={"allow_objects": True, "struct": True})
        _merged[key] = files.states, config
    config = copy.deepcopy(config)
    for override in values:
        value = each(override.value(), _number)
        if isinstance(value, Mapping) and "name" in value and not override.is_delete():
            OmegaConf.update(config, override.key_or_group, {}, merge=False, force_add=True)
        override = replace(override, _value=value)
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
