"""Hydra's composing from files of options, less its own settings and its reading the same file twice.

Hydra's compose API adds thirteen files for launchers, sweepers and logging to the seven that a composition
needs, and throws them away.
"""

from __future__ import annotations

import copy
import functools
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from stat import S_ISREG

from hydra import version
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.config_repository import ConfigRepository
from hydra._internal.config_search_path_impl import ConfigSearchPathImpl
from hydra._internal.core_plugins.file_config_source import FileConfigSource
from hydra._internal.defaults_list import DefaultsList, create_defaults_list
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.plugins.config_source import ConfigResult
from omegaconf import DictConfig, OmegaConf

__all__ = ["OptionFiles", "choices", "compose", "parsed"]

#: What was read, by the file's path, time of change, size and number.
_read: dict[tuple[str | int, ...], ConfigResult | None] = {}


@functools.lru_cache(1024)
def parsed(override: str) -> Override:
    """What Hydra reads in it; a HydraException or RecursionError if it can read nothing."""
    return OverridesParser.create().parse_overrides([override])[0]


class OptionFiles(ConfigRepository):
    """The files in `folders`, for one composition; one that has not changed is not parsed anew."""

    def __init__(self, folders: Iterable[Path]) -> None:
        self.sources = [FileConfigSource("understudy", f"file://{folder}") for folder in folders]
        self._loaded: dict[str, ConfigResult | None] = {}

    def load_config(self, config_path: str) -> ConfigResult | None:
        if config_path not in self._loaded:
            state = self._state(f"{config_path.removesuffix('.yaml')}.yaml")
            if state and state not in _read:
                _read[state] = found = super().load_config(config_path)
                if found:
                    found.is_schema_source = True  # for which Hydra seeks no schema
            kept = _read[state] if state else None
            self._loaded[config_path] = copy.deepcopy(kept)  # Hydra changes what it is given
        return self._loaded[config_path]

    def _state(self, name: str) -> tuple[str | int, ...] | None:
        """The first file of that name, and what changes when its content does."""
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
    chosen = choices(files, overrides)
    loader = ConfigLoaderImpl(ConfigSearchPathImpl())
    config = loader._compose_config_from_defaults_list(chosen.defaults, files)
    OmegaConf.set_struct(config, True)
    loader._apply_overrides_to_config(chosen.config_overrides, config)
    return config
