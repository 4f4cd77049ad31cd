"""MuJoCo on the CPU: all worlds stepped in C threads by ``mujoco.batch.Batch``."""

import os
import sys
from pathlib import Path

from understudy import hookimpl
from understudy.registry import Registrar

if sys.platform == "linux":
    # MuJoCo chooses its renderer when it is imported; EGL needs no display.
    os.environ.setdefault("MUJOCO_GL", "egl")


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
