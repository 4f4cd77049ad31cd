"""Curricula of a difficulty, and what curricula make of the episodes that end."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()


@hookimpl
def understudy_register(register: Registrar) -> None:
    add = register.component
    add("curriculum", "linear", "understudy_curricula.curricula:Linear", "difficulty by samples")
    add(
        "curriculum", "adaptive", "understudy_curricula.curricula:Adaptive", "difficulty by success"
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
