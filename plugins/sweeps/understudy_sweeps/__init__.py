"""Outer loops over whole runs: the command ``sweep``, its journal, and the plain grid."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.component(
        "command",
        "sweep",
        "understudy_sweeps.command:Sweep",
        "run an outer loop over trainings: understudy sweep ablation=…",
    )
    register.component("outer_loop", "grid", "understudy_sweeps.grid:Grid", "variants × seeds")
    register.component(
        "executor",
        "in_process",
        "understudy_sweeps.in_process:InProcess",
        "one trial after another",
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
