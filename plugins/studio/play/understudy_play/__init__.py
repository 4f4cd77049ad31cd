"""Trained skills that come with the package, live in the browser."""

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("skills", "characters", "motion", "mujoco", "report", "credits", "viewer")


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.component(
        "command",
        "play",
        "understudy_play.command:Play",
        "watch a trained policy live in the browser and push it, or as a video",
    )
