"""Outer loops over whole runs: the command ``sweep``, its journal, executors, and the plain grid."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("motion", "report")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "command": {
        "sweep": ("command:Sweep", "run an outer loop over trainings: ablation=… or search=…"),
        "compare": ("compare:Compare", "show runs beside one another and what differs, as a page"),
    },
    "outer_loop": {
        "grid": ("grid:Grid", "variants × seeds"),
        "chain": ("chain:Chain", "trainings that build on one another"),
    },
    "executor": {
        "in_process": ("in_process:InProcess", "one trial after another"),
        "processes": ("processes:Processes", "trials in processes of this machine"),
    },
}


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.kind("sweep_page", "a page of a finished sweep beside its own")
    register.parts(__name__, PARTS)


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
