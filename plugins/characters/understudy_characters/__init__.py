"""Characters as MJCF models: joint rotations to ``qpos`` and back, shapes. Knows no particular one."""

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("mujoco", "motion")


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.kind("character", "makes the MJCF model specification of a character")
    register.kind("overlay", "what is drawn over the recorded motion of a run")
