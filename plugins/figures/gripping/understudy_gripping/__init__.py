"""Grips: how a hand holds two sticks: styles, poses by inverse kinematics, forces that balance. Knows no task."""

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("hand", "mujoco", "tensors")

_HERE = "understudy_gripping"


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.kind("grip", "how a hand holds two sticks: a function that gives the file's path")
    register.section("grip", f"{_HERE}.grip:GripOptions", f"{_HERE}.grip:build_grips")
    register.component("grip", "standard", f"{_HERE}.grip:standard", "the style 11120")
    register.component(
        "command", "grip", f"{_HERE}.command:FindGrip", "find how a hand holds two sticks"
    )
