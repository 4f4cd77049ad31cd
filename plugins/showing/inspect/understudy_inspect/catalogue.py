"""What there is to train and to choose, with a line on each."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from understudy.setup.plugins import Plugins


@dataclass(frozen=True)
class Offer:
    """A file of options: what ``GROUP=NAME`` chooses."""

    name: str
    plugin: str  #: "" if it is the kernel's own
    file: Path

    @property
    def text(self) -> str:
        return self.file.read_text(encoding="utf-8")

    @property
    def summary(self) -> str:
        """The first sentence of the comment that the file begins with."""
        lines = []
        for line in self.text.splitlines():
            if line.startswith("# @package"):
                continue
            if not line.startswith("#"):
                break
            lines.append(line.lstrip("# ").rstrip())
        return re.split(r"\.\s+(?=[A-Z])", " ".join(lines))[0].rstrip(".")


def offers(plugins: Plugins, group: str) -> Iterator[Offer]:
    """The files of `group`, the kernel's first and then plugin by plugin."""
    for plugin, folder in plugins.folders():
        for file in sorted((folder / group).rglob("[!_]*.yaml")):
            name = file.relative_to(folder / group).with_suffix("").as_posix()
            yield Offer(name, plugin, file)
