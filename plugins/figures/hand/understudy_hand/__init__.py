"""A hand on an arm, of any number of fingers and size, with sticks or tongs, at a table. Knows no paper."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("mujoco", "tensors")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "scene": {
        "hand": ("scene:HandScene", "a hand on an arm, with a tool"),
    },
}


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.parts(__name__, PARTS)


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
