"""Position-based dynamics of particles in Warp, N worlds at once."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on: pictures are drawn with the renderer that `mujoco` has chosen.
REQUIRES = ("mujoco", "warp_torch")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "simulator": {
        "pbd": ("simulator:ParticleSimulator", "particles, springs and tools, position-based"),
    },
}


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.parts(__name__, PARTS)


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
