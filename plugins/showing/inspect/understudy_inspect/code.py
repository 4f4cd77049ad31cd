"""Which code a run was made with, by digest: versions alone do not tell edits in a working tree."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator
from pathlib import Path

from understudy.records.observer import RunObserver
from understudy.records.runs import Run

#: What of a package decides results.
_SUFFIXES = (".py", ".yaml", ".yml")


class RecordCode(RunObserver):
    """Keeps in ``run.json``, as ``code``, the SHA-256 of the kernel's sources and of those of each plugin
    whose parts it uses."""

    def started(self, run: Run) -> None:
        used = {"understudy": "understudy"}
        for part in run.info["components"]:
            factory = run.registry.find(part["kind"], part["name"]).factory
            used[part["plugin"]] = str(getattr(factory, "__module__", "")).partition(".")[0]
        found = {plugin: digest_of(package) for plugin, package in sorted(used.items())}
        run.info["code"] = {plugin: digest for plugin, digest in found.items() if digest}
        run.write_json("run.json", run.info)


def digest_of(package: str) -> str:
    """Of the sources of an imported `package`, names and contents; nothing if it has no files."""
    folders = list(getattr(sys.modules.get(package), "__path__", []))
    found = hashlib.sha256()
    files = [file for folder in folders for file in _sources(Path(folder))]
    for name, path in sorted(files):
        content = path.read_bytes()
        found.update(f"{len(name.encode())} {name} {len(content)} ".encode() + content)
    return found.hexdigest() if files else ""


def _sources(folder: Path) -> Iterator[tuple[str, Path]]:
    for path in folder.rglob("*"):
        if path.suffix in _SUFFIXES and path.is_file():
            yield path.relative_to(folder).as_posix(), path
