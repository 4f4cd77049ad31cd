"""Outer loops over whole runs: the command ``sweep``, its journal, executors, and the plain grid."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("motion", "report")


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.kind("sweep_page", "a page of a finished sweep beside its own")
    register.component(
        "command",
        "sweep",
        "understudy_sweeps.command:Sweep",
        "run an outer loop over trainings: understudy sweep ablation=… or search=…",
    )
    register.component(
        "command",
        "compare",
        "understudy_sweeps.compare:Compare",
        "show runs beside one another and what differs, as a page: understudy compare RUN RUN",
    )
    for name, target, summary in (
        ("grid", "grid:Grid", "variants × seeds"),
        ("chain", "chain:Chain", "trainings that build on one another"),
    ):
        register.component("outer_loop", name, f"understudy_sweeps.{target}", summary)
    for name, target, summary in (
        ("in_process", "in_process:InProcess", "one trial after another"),
        ("processes", "processes:Processes", "trials in processes of this machine"),
    ):
        register.component("executor", name, f"understudy_sweeps.{target}", summary)


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
