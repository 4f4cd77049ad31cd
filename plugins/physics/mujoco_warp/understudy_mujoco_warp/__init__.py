"""MuJoCo Warp: the same scenes as MuJoCo on the CPU, with all worlds on one GPU."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

REQUIRES = ("mujoco", "warp_torch")


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.component(
        "simulator",
        "mujoco_warp",
        "understudy_mujoco_warp.simulator:MujocoWarpSimulator",
        "MuJoCo Warp on one GPU",
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
