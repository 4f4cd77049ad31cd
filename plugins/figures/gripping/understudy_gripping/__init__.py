"""Grips: how a hand holds two sticks: styles, poses by inverse kinematics, forces that balance. Knows no task."""

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("hand", "mujoco", "tensors")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "grip": {
        "standard": ("grip:standard", "the style 11120"),
    },
    "command": {
        "grip": ("command:FindGrip", "find how a hand holds two sticks"),
    },
}


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.kind("grip", "how a hand holds two sticks: a function that gives the file's path")
    register.parts(__name__, PARTS)
    register.section(
        "grip", "understudy_gripping.grip:GripOptions", "understudy_gripping.grip:build_grips"
    )
