"""Composing files of options: Hydra chooses the files, and their content is merged here.

Hydra's own compose API would lose how numbers were typed. It would also read thirteen files about
launchers, sweepers and logging beside the seven that a composition needs, only to drop them.
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
from hydra import version as hydra_version
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

#: A version of a file: its path, time of change, size and inode.
Version = tuple[str, int, int, int]
#: What was read of each: which files it builds on, and its other content.
_read: dict[Version, tuple[ConfigResult, dict[str, Any]]] = {}
#: What was merged, by folders, overrides that choose files, and groups that stand alone: the
#: versions of all files that were asked for, and the result.
_merged: dict[tuple[str | None, ...], tuple[dict[str, Version | None], DictConfig]] = {}
#: Marks a number on the command line whose text is kept beside its value.
MARK = "\ue000"


@functools.lru_cache(1024)
def parsed(override: str) -> Override:
    """The override as Hydra reads it; a HydraException or RecursionError if it cannot."""
    try:
        return OverridesParser.create().parse_overrides([override])[0]
    except ValueError as error:  # of a number with more digits than Python reads
        raise HydraException(str(error)) from error


class _Loader(get_yaml_loader()):
    """OmegaConf's loader, but with numbers as they were typed, and keys that are text."""

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        value = super().construct_object(node, deep)
        scalar = isinstance(node, yaml.ScalarNode) and node.style is None
        return as_typed(value, node.value) if scalar else value

    def construct_mapping(self, node: yaml.Node, deep: bool = False) -> dict[str, Any]:
        return {str(key): value for key, value in super().construct_mapping(node, deep).items()}


class OptionFiles(ConfigRepository):
    """The files in `folders`, for one composition. A file is parsed again only if it changed."""

    def __init__(self, folders: Iterable[Path]) -> None:
        self.sources = [FileConfigSource("understudy", f"file://{folder}") for folder in folders]
        self.versions: dict[str, Version | None] = {}  #: by name, of all files that were asked for

    def group_exists(self, config_path: str) -> bool:
        return any(os.path.isdir(os.path.join(s.path, config_path)) for s in self.sources)

    def load_config(self, config_path: str) -> ConfigResult | None:
        found, _ = self._found(config_path) or (None, {})
        return found and replace(found, defaults_list=copy.deepcopy(found.defaults_list))

    def content(self, default: ResultDefault) -> dict[str, Any]:
        """The content of the chosen file, at the place where it goes."""
        _, content = self._found(default.config_path or "") or (None, {})
        for key in reversed((default.package or "").split(".")):
            content = {key: content} if key not in ("", "_global_") else content
        return content

    def _found(self, config_path: str) -> tuple[ConfigResult, dict[str, Any]] | None:
        version = self.versions.get(config_path) or self.version(config_path)
        self.versions[config_path] = version
        if version and version not in _read:
            file = Path(version[0])
            text = file.read_text(encoding="utf-8-sig")
            try:
                content = _Loader(text).get_single_data() or {}
            except yaml.YAMLError as error:
                said = " ".join(str(error).split())[:300]
                raise ConfigError(f"{file} cannot be read: {said}. Correct it.") from error
            if not isinstance(content, dict):
                raise ConfigError(f"{file} is no mapping of keys to values. Write KEY: VALUE.")
            chosen = OmegaConf.create({"defaults": plain(content.pop("defaults", []))})
            named = self._extract_defaults_list(config_path, chosen)
            defaults = self._create_defaults_list(config_path, named)
            header = ConfigSource._get_header_dict(text[:512])
            result = ConfigResult("understudy", str(file), chosen, header, defaults)
            _read[version] = result, content
        return _read[version] if version else None

    def version(self, config_path: str) -> Version | None:
        """That of the first file of this name."""
        name = f"/{config_path.removesuffix('.yaml')}.yaml"
        with contextlib.suppress(OSError, ValueError):  # it is gone, or no file has such a name
            for file in (source.path + name for source in self.sources):
                if os.access(file, os.F_OK) and S_ISREG((found := os.stat(file)).st_mode):
                    return (file, found.st_mtime_ns, found.st_size, found.st_ino)
        return None


def choices(files: OptionFiles, overrides: Sequence[str]) -> DefaultsList:
    """The files that ``config.yaml`` and `overrides` choose, and which overrides set values."""
    hydra_version.setbase("1.3")
    return create_defaults_list(
        files, "config", [parsed(o) for o in overrides], prepend_hydra=False, skip_missing=False
    )


def compose(
    folders: Iterable[Path], overrides: Sequence[str], own: Collection[str] = ()
) -> DictConfig:
    """What Hydra composes from the files in `folders`, with Hydra's errors; a number whose value
    loses how it was typed is a :class:`understudy.options.Typed`.

    Of the groups `own`, only their own files count. A component that an override names
    (``policy={name: …}``) replaces what is there; Hydra would merge the two.
    """
    files = OptionFiles(folders)
    read = [parsed(override) for override in overrides]
    values = Overrides(files, read).config_overrides
    chosen = (o.input_line for o in read if o not in values)
    key = (*(s.path for s in files.sources), None, *chosen, None, *sorted(own))
    versions, config = _merged.get(key, ({}, None))
    if not config or any(files.version(name) != old for name, old in versions.items()):
        content: dict[str, Any] = {}
        for default in choices(files, overrides).defaults:
            others = {key for key in own if not str(default.config_path).startswith(f"{key}/")}
            said = files.content(default)
            content = _laid(content, {k: v for k, v in said.items() if k not in others})
        config = OmegaConf.create(content, flags={"allow_objects": True, "struct": True})
        _merged[key] = files.versions, config
    config = copy.deepcopy(config)
    for override in values:
        value = each(override.value(), _number)
        if isinstance(value, Mapping) and "name" in value and not override.is_delete():
            OmegaConf.update(config, override.key_or_group, {}, merge=False, force_add=True)
        ConfigLoaderImpl._apply_overrides_to_config([replace(override, _value=value)], config)
    return config


def _laid(old: Any, new: Any) -> Any:
    """`new` over `old`: mappings are merged, anything else is replaced."""
    if not (isinstance(old, dict) and isinstance(new, dict)):
        return new
    return {**old, **{key: _laid(old.get(key), item) for key, item in new.items()}}


def _number(value: Any) -> Any:
    """A number marked by :data:`MARK`, as it was typed; any other `value` unchanged."""
    if not (isinstance(value, str) and value.startswith(MARK)):
        return value
    text = value.removeprefix(MARK)
    return as_typed(parsed(f"x={text}").value(), text)
