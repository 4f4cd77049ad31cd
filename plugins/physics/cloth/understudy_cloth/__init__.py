"""Cloth by position-based dynamics in small steps, in Warp, N worlds at once."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on: pictures are drawn with the renderer that `mujoco` has chosen.
REQUIRES = ("mujoco", "warp_torch")


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.component(
        "simulator",
        "cloth",
        "understudy_cloth.simulator:ClothSimulator",
        "a garment, bodies that it touches and grips, by XPBD in small steps",
    )
    register.component(
        "command",
        "garment check",
        "understudy_cloth.garment_command:Check",
        "whether a garment's files can be used, and what they hold",
    )
    register.citation(
        "cloth",
        "Macklin, Storey, Lu, Terdiman, Chentanez, Jeschke, Müller 2019. Small steps in physics simulation. "
        "ACM SIGGRAPH/Eurographics Symposium on Computer Animation.",
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
