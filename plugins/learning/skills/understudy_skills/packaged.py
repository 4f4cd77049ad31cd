"""How a plugin registers its packed skills."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

__all__ = ["skills_beside"]


def skills_beside(module: str) -> Callable[[Registrar], None]:
    """The hook of a plugin whose packed skills (``understudy play RUN --pack FILE``) are in the folder ``skills``
    beside its module: ``walk.json`` of the plugin ``mine`` is the skill ``mine/walk``, for ``understudy play`` and
    ``actuation.runs``. The plugin's module says ``understudy_register = skills_beside(__file__)``."""

    @hookimpl
    def understudy_register(register: Registrar) -> None:
        for file in sorted((Path(module).parent / "skills").glob("*.json")):
            name = f"{register.plugin}/{file.stem}"
            register.component("skill", name, _place(file), "a trained policy, packed")

    return understudy_register


def _place(file: Path) -> Callable[[], Path]:
    def place() -> Path:
        """Where the packed skill is, without its suffixes."""
        return file.with_suffix("")

    return place
