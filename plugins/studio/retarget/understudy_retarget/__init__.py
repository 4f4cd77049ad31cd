"""Retargeting: the motion of any skeleton on any character."""

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("tensors", "characters", "doctor", "motion")


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.component(
        "command",
        "motion retarget",
        "understudy_retarget.command:Retarget",
        "put the motion of any skeleton on a character",
    )
