"""Cloth by position-based dynamics in small steps, in Warp, N worlds at once."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on: pictures are drawn with the renderer that `mujoco` has chosen.
REQUIRES = ("mujoco", "warp_torch")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "simulator": {
        "cloth": ("simulator:ClothSimulator", "a garment and bodies, by XPBD in small steps"),
    },
    "command": {
        "garment check": ("garment_command:Check", "whether a garment's files can be used"),
    },
}


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.parts(__name__, PARTS)
    register.citation(
        "cloth",
        "Macklin, Storey, Lu, Terdiman, Chentanez, Jeschke, Müller 2019. Small steps in physics simulation. "
        "ACM SIGGRAPH/Eurographics Symposium on Computer Animation.",
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
