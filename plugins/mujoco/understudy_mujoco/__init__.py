"""MuJoCo on the CPU: all worlds stepped in C threads by ``mujoco.batch.Batch``."""

import ctypes
import os
import sys
from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()


def _choose_renderer() -> None:
    """MuJoCo chooses its renderer when it is imported, and fails to import without that library.

    EGL needs no display; where there is none, training goes on without pictures.
    """
    if sys.platform == "linux" and "MUJOCO_GL" not in os.environ:
        try:
            ctypes.CDLL("libEGL.so.1")
            os.environ["MUJOCO_GL"] = "egl"
        except OSError:
            os.environ["MUJOCO_GL"] = "disable"


def _wait_asleep() -> None:
    """OpenMP reads it when torch is imported, which is later than plugins are.

    The threads that helped with a network would spin for some ten ms on cores that the simulator needs.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


_choose_renderer()
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
        "scene", "mjcf", "understudy_mujoco.scene:MjcfFile", "a scene read from an MJCF file"
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
