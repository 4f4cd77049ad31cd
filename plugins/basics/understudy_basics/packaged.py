"""How a plugin offers its skills."""

from __future__ import annotations

from pathlib import Path

from understudy.setup.registry import Registrar


def register_skills(register: Registrar, folder: Path) -> None:
    """Offer the packed skills in `folder` (``understudy play RUN --pack FILE``): ``walk.json`` of the plugin
    ``mine`` is the skill ``mine/walk``, for ``understudy play`` and ``actuation.runs``."""
    for file in sorted(folder.glob("*.json")):
        path = file.with_suffix("")
        name = f"{register.plugin}/{path.name}"
        register.component("skill", name, lambda path=path: path, "a trained policy, packed")
