"""A hand on an arm, of any number of fingers and size, with sticks or tongs, at a table. Knows no paper."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("mujoco", "tensors")


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.component(
        "scene", "hand", "understudy_hand.scene:HandScene", "a hand on an arm, with a tool"
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
