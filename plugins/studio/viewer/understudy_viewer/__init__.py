"""The motion page: clips and runs in the browser."""

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("tensors", "characters", "doctor", "motion", "mujoco")


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.component(
        "command",
        "motion view",
        "understudy_viewer.command:View",
        "show a clip, or a run beside its reference, in the browser",
    )
