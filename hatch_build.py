"""The bundled plugins, found in the tree: each is a folder ``plugins/WING/NAME`` with a package
``understudy_NAME``. Nothing else lists them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface


def bundled(root: Path) -> dict[str, Path]:
    """By name: the folder of each plugin, from `root`."""
    found = sorted((root / "plugins").glob("*/*/understudy_*/__init__.py"))
    packages = [file.parent for file in found]
    return {
        package.parent.name: package.parent.relative_to(root)
        for package in packages
        if package.name == f"understudy_{package.parent.name}"
    }


class EntryPoints(MetadataHookInterface):
    """The bundled plugins use the same entry points as anybody's."""

    def update(self, metadata: dict[str, Any]) -> None:
        names = bundled(Path(self.root))
        metadata["entry-points"] = {"understudy": {name: f"understudy_{name}" for name in names}}


class Packages(BuildHookInterface):
    """The plugins' packages in a wheel, and their folders on the path of an editable installation."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if self.target_name != "wheel":
            return
        folders = bundled(Path(self.root))
        if version == "editable":  # conf/ is found beside kernel/ in a source tree
            self.build_config.dev_mode_dirs.extend(["kernel", *map(str, folders.values())])
            return
        build_data["force_include"]["conf"] = "understudy/conf"
        for name, folder in folders.items():
            package = f"understudy_{name}"
            build_data["force_include"][f"{folder}/{package}"] = package
