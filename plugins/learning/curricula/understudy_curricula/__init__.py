"""Curricula of a difficulty, and what curricula make of the episodes that end."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "curriculum": {
        "linear": ("curricula:Linear", "difficulty by samples"),
        "adaptive": ("curricula:Adaptive", "difficulty by success"),
    },
}


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.parts(__name__, PARTS)


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
