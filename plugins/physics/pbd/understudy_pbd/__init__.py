"""Position-based dynamics of particles in Warp, N worlds at once."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on: pictures are drawn with the renderer that `mujoco` has chosen.
REQUIRES = ("mujoco", "warp_torch")


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.component(
        "simulator",
        "pbd",
        "understudy_pbd.simulator:ParticleSimulator",
        "particles, springs and tools by position-based dynamics",
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
