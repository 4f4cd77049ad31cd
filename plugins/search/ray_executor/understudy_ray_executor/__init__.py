"""Trials as actors of a Ray cluster, of one machine or of many."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("sweeps",)


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.component(
        "executor", "ray", "understudy_ray_executor.executor:RayExecutor", "trials on a Ray cluster"
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
