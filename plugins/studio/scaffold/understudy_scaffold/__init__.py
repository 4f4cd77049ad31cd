"""``understudy new``: a package of one's own to begin with."""

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "command": {
        "new plugin": ("new:NewPlugin", "write a package with one term"),
        "new paper": ("new:NewPaper", "the same, with an experiment, page and table"),
    },
}


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.parts(__name__, PARTS)
