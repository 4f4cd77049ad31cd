"""Where the values of a configuration come from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.types import RunMode

from understudy.setup.composition import (
    hydra_session,
    option_directories,
    settable,
    without_emptied,
    words,
)
from understudy.setup.plugins import Plugins, installed


def origins(overrides: Sequence[str], plugins: Plugins | None = None) -> dict[str, str]:
    """For each key path of the composed configuration, the file (or override) that set it."""
    plugins = plugins or installed()
    origin: dict[str, str] = {}
    overrides, emptied = without_emptied(overrides, plugins)
    with hydra_session(plugins, overrides):
        loader = GlobalHydra.instance().config_loader()
        defaults = loader.compute_defaults_list(
            "config", [settable(o) for o in overrides], RunMode.RUN
        )
        sources, chosen = option_directories(plugins), words(overrides, plugins)
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
                        group = key.partition(".")[0]
                        if group not in chosen or path.startswith(f"{group}/"):
                            origin[key] = _shorten(file)
        for override in OverridesParser.create().parse_overrides(list(overrides)):
            for key in _paths(override.value(), override.key_or_group):
                if not any(k.startswith(f"{key}.") for k in origin):  # else it chose a file
                    origin[key] = f"command line: {override.input_line}"
    for name, override in emptied.items():
        origin = {k: v for k, v in origin.items() if k != name and not k.startswith(f"{name}.")}
        origin[name] = f"command line: {override}"
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
