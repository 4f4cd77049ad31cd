"""What a build finds out by itself: the version, and the bundled plugins.

Each plugin is a folder ``plugins/WING/NAME`` with a package ``understudy_NAME``. Nothing else lists them.
"""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

#: Of a release: ``v0.2.0``.
_TAG = re.compile(r"v(\d+(?:\.\d+)*)(?:-(\d+)-(g[0-9a-f]+))?")


def version(root: Path = Path(__file__).parent) -> str:
    """That of the tag ``vX.Y.Z``; behind it with so many commits, ``X.Y.Z+N.gHASH``. Without tags, or without
    git, it is what a source distribution says of itself, else the number in ``CITATION.cff``.

    Raises
    ------
    ValueError
        if the tag and ``CITATION.cff`` name two versions.
    """
    built = root / "PKG-INFO"
    if built.is_file() and (
        found := re.search(r"^Version: (\S+)$", built.read_text("utf-8"), re.M)
    ):
        return found[1]
    cited = re.search(r"^version: (\S+)$", (root / "CITATION.cff").read_text("utf-8"), re.M)
    if cited is None:
        raise ValueError("CITATION.cff names no version.")
    tag = _TAG.fullmatch(_described(root))
    if tag is None:
        return cited[1]
    number, commits, commit = tag.groups()
    if commits is None and number != cited[1]:
        raise ValueError(f"The tag is v{number}, and CITATION.cff says {cited[1]}. Make them one.")
    return number if commits is None else f"{number}+{commits}.{commit}"


def _described(root: Path) -> str:
    """The nearest tag of a version, as git describes where `root` is; empty where there is none."""
    if not (root / ".git").exists():  # a folder within another repository is not that one
        return ""
    command = ["git", "describe", "--tags", "--match", "v[0-9]*"]
    try:
        done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    except OSError:  # no git
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""


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
