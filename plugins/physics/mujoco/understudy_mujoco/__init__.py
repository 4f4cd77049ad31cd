"""MuJoCo on the CPU: all worlds stepped in C threads by ``mujoco.batch.Batch``."""

import os
from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar
from understudy_mujoco import opengl

#: Plugins that this one builds on.
REQUIRES = ("tensors",)


def _wait_asleep() -> None:
    """OpenMP reads it when torch is imported, which is later than plugins are.

    The threads that helped with a network would spin for some ten ms on cores that the simulator needs.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


opengl.choose()
_wait_asleep()


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.component(
        "simulator",
        "mujoco",
        "understudy_mujoco.simulator:MujocoSimulator",
        "MuJoCo on CPU threads",
    )
    register.component(
        "fields",
        "mujoco/distances",
        "understudy_mujoco.distances:Distances",
        "how far groups of geoms are apart",
    )
    register.component(
        "scene", "mjcf", "understudy_mujoco.scene:MjcfFile", "a scene read from an MJCF file"
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
