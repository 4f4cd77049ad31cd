"""MuJoCo Warp: the same scenes as MuJoCo on the CPU, with all worlds on one GPU."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

REQUIRES = ("mujoco", "warp_torch")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "simulator": {
        "mujoco_warp": ("simulator:MujocoWarpSimulator", "MuJoCo Warp on one GPU"),
    },
}


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.parts(__name__, PARTS)


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
