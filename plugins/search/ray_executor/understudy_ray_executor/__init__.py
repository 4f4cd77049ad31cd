"""Trials as actors of a Ray cluster, of one machine or of many."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("sweeps",)

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "executor": {
        "ray": ("executor:RayExecutor", "trials on a Ray cluster"),
    },
}


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.parts(__name__, PARTS)


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
