"""Hydra's composing from files of options, less its own settings and its reading the same file twice.

Hydra's compose API adds thirteen files for launchers, sweepers and logging to the seven that a
composition needs, and throws them away.
"""

from __future__ import annotations

import copy
import functools
import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from stat import S_ISREG
from typing import Any

import yaml
from hydra import version
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.config_repository import ConfigRepository
from hydra._internal.config_search_path_impl import ConfigSearchPathImpl
from hydra._internal.core_plugins.file_config_source import FileConfigSource
from hydra._internal.defaults_list import DefaultsList, create_defaults_list
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.plugins.config_source import ConfigResult, ConfigSource
from omegaconf import DictConfig, OmegaConf
from omegaconf._utils import get_yaml_loader

from understudy.options import Typed, as_yaml

__all__ = ["OptionFiles", "choices", "compose", "parsed"]

#: A file's path, time of change, size and number.
State = tuple[str | int, ...]
_read: dict[State, ConfigResult | None] = {}
#: What files alone compose, by their folders and what chose them, and which files these were.
_composed: dict[tuple[str, ...], tuple[dict[str, State | None], DictConfig]] = {}
_MOST = 100  #: such compositions that are kept


@functools.lru_cache(1024)
def parsed(override: str) -> Override:
    """What Hydra reads in it; a HydraException or RecursionError if it can read nothing."""
    return OverridesParser.create().parse_overrides([override])[0]


#: While Hydra composes, which takes YAML's values alone, the value and the text of a number as it
#: was typed are a text: its mark.
_MARK = re.compile("\ue000(.*?)\ue001([^\ue002]*)\ue002")


def marked(value: Any, text: str) -> Any:
    """`value`,
    or its mark where it is a number or a truth value and does not say that `text` was typed."""
    if type(value) not in (bool, int, float) or as_yaml(value) == text:
        return value
    return f"\ue000{json.dumps(value)}\ue001{text}\ue002"


def unmarked(text: str) -> str:
    """`text` with what was typed in place of marks."""
    return _MARK.sub(r"\2", text)


def typed(value: Any) -> Any:
    """The nested `value` with a :class:`Typed` in place of every mark;
    in keys and in texts what was typed."""
    if isinstance(value, Mapping):
        return {unmarked(str(key)): typed(item) for key, item in value.items()}
    if isinstance(value, str):
        mark, text = _MARK.fullmatch(value), unmarked(value)
        return Typed(json.loads(mark[1]), text) if mark else text
    return list(map(typed, value)) if isinstance(value, list) else value


class _Loader(get_yaml_loader()):
    """OmegaConf's, of plain scalars as they are typed."""

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        value = super().construct_object(node, deep)
        scalar = isinstance(node, yaml.ScalarNode) and node.style is None
        return marked(value, node.value) if scalar else value


class OptionFiles(ConfigRepository):
    """The files in `folders`, for one composition; one that has not changed is not parsed anew."""

    def __init__(self, folders: Iterable[Path]) -> None:
        self.sources = [FileConfigSource("understudy", f"file://{folder}") for folder in folders]
        self.states: dict[str, State | None] = {}  #: of what was asked for
        self._loaded: dict[str, ConfigResult | None] = {}

    def group_exists(self, config_path: str) -> bool:
        return any(os.path.isdir(os.path.join(s.path, config_path)) for s in self.sources)

    def load_config(self, config_path: str) -> ConfigResult | None:
        if config_path not in self._loaded:
            state = self.states[config_path] = self.state(config_path)
            if state and state not in _read:
                text = Path(str(state[0])).read_text(encoding="utf-8")
                config = OmegaConf.create(_Loader(text).get_single_data() or {})
                header = ConfigSource._get_header_dict(text[:512])
                _read[state] = found = ConfigResult("understudy", str(state[0]), config, header)
                found.is_schema_source = True  # for which Hydra seeks no schema
                defaults = self._extract_defaults_list(config_path, config)
                found.defaults_list = self._create_defaults_list(config_path, defaults)
            kept = _read[state] if state else None
            self._loaded[config_path] = copy.deepcopy(kept)  # Hydra changes what it is given
        return self._loaded[config_path]

    def state(self, config_path: str) -> State | None:
        """The first file of that name, and what changes when its content does."""
        name = f"{config_path.removesuffix('.yaml')}.yaml"
        for source in self.sources:
            file = os.path.join(source.path, name)
            try:
                state = os.stat(file)
            except (OSError, ValueError):
                continue
            if S_ISREG(state.st_mode):
                return (file, state.st_mtime_ns, state.st_size, state.st_ino)
        return None


def choices(files: OptionFiles, overrides: Sequence[str]) -> DefaultsList:
    """The files that ``config.yaml`` and `overrides` choose, and which overrides set values."""
    version.setbase("1.3")
    return create_defaults_list(
        files, "config", [parsed(o) for o in overrides], prepend_hydra=False, skip_missing=False
    )


def compose(folders: Iterable[Path], overrides: Sequence[str]) -> DictConfig:
    """What Hydra composes from the files in `folders`, whatever its errors."""
    files = OptionFiles(folders)
    choosing = [o for o in overrides if not _sets(parsed(o), files)]
    config = _of_files(files, choosing)
    values = [parsed(o) for o in overrides if _sets(parsed(o), files)]
    ConfigLoaderImpl._apply_overrides_to_config(values, config)
    return config


def _sets(override: Override, files: OptionFiles) -> bool:
    """Whether it sets a value; else Hydra takes it for a choice of files, or for nothing."""
    if override.is_sweep_override():
        return False
    return isinstance(override.value(), dict) or not files.group_exists(override.key_or_group)


def _of_files(files: OptionFiles, overrides: Sequence[str]) -> DictConfig:
    """What the files have that `overrides` choose, composed anew only if one of them has changed."""
    key = (*(source.path for source in files.sources), *overrides)
    states, config = _composed.get(key, ({}, None))
    if config is None or any(files.state(path) != state for path, state in states.items()):
        defaults = choices(files, overrides).defaults
        loader = ConfigLoaderImpl(ConfigSearchPathImpl())
        config = loader._compose_config_from_defaults_list(defaults, files)
        OmegaConf.set_struct(config, True)
        if len(_composed) >= _MOST:
            _composed.clear()
        _composed[key] = (files.states, config)
    return copy.deepcopy(config)
