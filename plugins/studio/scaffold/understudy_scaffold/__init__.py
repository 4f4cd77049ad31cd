"""``understudy new``: a package of one's own to begin with."""

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()


@hookimpl
def understudy_register(register: Registrar) -> None:
    new = "understudy_scaffold.new"
    register.component("command", "new plugin", f"{new}:NewPlugin", "write a package with one term")
    register.component(
        "command", "new paper", f"{new}:NewPaper", "the same, with an experiment, page and table"
    )
