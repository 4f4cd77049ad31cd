"""Motion clips: reading, checking, sampling. Nothing here knows a particular character."""

from understudy import hookimpl
from understudy.registry import Registrar

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.kind("clip", "a generated motion clip")
    register.kind("clip_reader", "reads a format of motion clips")
    register.kind("clip_writer", "writes a format of motion clips")
    register.component(
        "clip_reader",
        "deepmimic",
        "understudy_motion.readers.deepmimic:DeepMimicReader",
        "DeepMimic's JSON",
    )
    register.section(
        "motion", "understudy_motion.section:MotionOptions", "understudy_motion.section:Motion"
    )
