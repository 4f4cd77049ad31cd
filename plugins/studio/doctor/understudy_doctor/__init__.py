"""The clip doctor: what is wrong with a clip, and what repairs it."""

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("tensors", "characters", "motion", "report")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "command": {
        "motion check": ("command:Check", "examine and repair a clip"),
    },
}


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.parts(__name__, PARTS)
