"""The plain outer loop: every variant with every seed, one after another."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.component("outer_loop", "grid", "understudy_grid.grid:Grid", "variants × seeds")
    register.component(
        "executor", "in_process", "understudy_grid.in_process:InProcess", "one trial after another"
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
