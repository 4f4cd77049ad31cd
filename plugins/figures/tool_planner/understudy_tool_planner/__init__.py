"""Plans how two sticks take an object and put it elsewhere. Knows no task and no policy."""

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("gripping", "hand", "mujoco", "tensors")


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.citation(
        "todorov2018analytic",
        "Todorov. Goal directed dynamics. IEEE International Conference on Robotics and Automation, 2018.",
    )
