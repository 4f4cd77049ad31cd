"""How a plugin offers its skills."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from understudy.setup.registry import Registrar

__all__ = ["register_skills"]


def register_skills(register: Registrar, folder: Path) -> None:
    """Offer the packed skills in `folder` (``understudy play RUN --pack FILE``): ``walk.json`` of the plugin
    ``mine`` is the skill ``mine/walk``, for ``understudy play`` and ``actuation.runs``."""
    for file in sorted(folder.glob("*.json")):
        name = f"{register.plugin}/{file.stem}"
        register.component("skill", name, _place(file), "a trained policy, packed")


def _place(file: Path) -> Callable[[], Path]:
    def place() -> Path:
        """Where the packed skill is, without its suffixes."""
        return file.with_suffix("")

    return place
