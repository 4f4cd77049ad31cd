"""Plans how two sticks take an object and put it elsewhere. Knows no task and no policy."""

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("gripping", "hand", "mujoco", "tensors")


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.citation(
        "tolani1996arm",
        "Tolani, Badler. Real-time inverse kinematics of the human arm. Presence: Teleoperators and Virtual "
        "Environments 5(4), 1996.",
    )
