"""Composing files of options: Hydra chooses the files, and their content is merged here.

Hydra's own compose API would lose how numbers were typed. It would also read thirteen files about
launchers, sweepers and logging beside the seven that a composition needs, only to drop them.
"""

from __future__ import annotations

import contextlib
import copy
import functools
import os
import re
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
from omegaconf import OmegaConf
from omegaconf._utils import get_yaml_loader

from understudy.errors import ConfigError
from understudy.options import as_typed, each, items, plain

__all__ = ["OptionFiles", "choices", "compose", "parsed"]

#: A version of a file: its path, time of change, size and inode.
Version = tuple[str, int, int, int]
#: What was read of each: which files it builds on, and its other content.
_read: dict[Version, tuple[ConfigResult, dict[str, Any]]] = {}
#: What was merged, by folders, overrides that choose files, and groups that stand alone: the
#: versions of all files that were asked for, the result, and whether it refers to itself (``${…}``).
_merged: dict[tuple[str | None, ...], tuple[dict[str, Version | None], dict[str, Any], bool]] = {}
#: Words that refer to others or to nothing, and keys with an index or an empty name.
_UNUSUAL = re.compile(r"\$\{|\?{3}|^[^=]*(\[|\.\.|\.=|^\+*\.)")
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
        return found and replace(found, defaults_list=[*map(copy.copy, found.defaults_list or ())])

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
) -> dict[str, Any]:
    """What Hydra composes from the files in `folders`, as plain data, with Hydra's errors; a number
    whose value loses how it was typed is a :class:`understudy.options.Typed` of its own.

    Of the groups `own`, only their own files count. A component that an override names
    (``policy={name: …}``) replaces what is there; Hydra would merge the two.
    """
    files = OptionFiles(folders)
    read = [parsed(override) for override in overrides]
    values = Overrides(files, read).config_overrides
    chosen = (o.input_line for o in read if o not in values)
    key = (*(s.path for s in files.sources), None, *chosen, None, *sorted(own))
    versions, content, refers = _merged.get(key, ({}, None, False))
    if content is None or any(files.version(name) != old for name, old in versions.items()):
        content = {}
        for default in choices(files, overrides).defaults:
            others = {key for key in own if not str(default.config_path).startswith(f"{key}/")}
            said = files.content(default)
            content = _laid(content, {k: v for k, v in said.items() if k not in others})
        refers = any(isinstance(value, str) and "${" in value for _, value in items(content))
        _merged[key] = files.versions, content, refers
    values = [replace(o, _value=each(o.value(), _number)) for o in values]
    found = each(content, copy.copy)
    if refers or not all(_sets(override, found) for override in values):  # OmegaConf takes longer
        config = OmegaConf.create(content, flags={"allow_objects": True, "struct": True})
        for override in values:
            if _named(override.value()) and not override.is_delete():
                OmegaConf.update(config, override.key_or_group, {}, merge=False, force_add=True)
            ConfigLoaderImpl._apply_overrides_to_config([override], config)
        resolved = OmegaConf.to_container(config, resolve=True, throw_on_missing=False)
        found = each(
            resolved, copy.copy
        )  # two keys that share a leaf (``${…}``) may differ in type
    return found


def _named(value: Any) -> bool:
    return isinstance(value, Mapping) and "name" in value


def _sets(override: Override, within: dict[str, Any]) -> bool:
    """Set `within` plain data what the override sets; False if that is for OmegaConf to do or refuse."""
    *above, last = (override.key_or_group or "").split(".")
    new, forced, said = override.value(), override.is_force_add(), str(override.input_line)
    if override.is_add() or override.is_delete() or override.package or _UNUSUAL.search(said):
        return False
    for key in above:
        if forced and not isinstance(within.get(key), (dict, list)):
            within[key] = {}
        if not isinstance(inside := within.get(key), dict):
            return False
        within = inside
    merges = isinstance(new, dict) or isinstance(within.get(last), dict)
    if able := (forced or last in within) and (_named(new) or not merges):
        within[last] = new
    return able


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
