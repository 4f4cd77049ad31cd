"""The clip doctor: what is wrong with a clip, and what repairs it."""

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("tensors", "characters", "motion", "report")


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.component(
        "command", "motion check", "understudy_doctor.command:Check", "examine and repair a clip"
    )
