"""Motion clips: reading, checking, sampling. Nothing here knows a particular character."""

from understudy import hookimpl
from understudy.registry import Registrar

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.kind("clip", "a generated motion clip")
    register.section(
        "motion", "understudy_motion.section:MotionOptions", "understudy_motion.section:Motion"
    )
