"""One command for every table of a paper, and the card that it leaves."""

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("report", "sweeps")


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.component(
        "command",
        "reproduce",
        "understudy_reproduce.command:Reproduce",
        "run what a paper's table compares, and put its numbers beside ours",
    )
