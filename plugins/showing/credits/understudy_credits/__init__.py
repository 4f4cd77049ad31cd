"""Whom a run is owed to, and on what terms: commands ``cite`` and ``licence``."""

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("report", "skills")


@hookimpl
def understudy_register(register: Registrar) -> None:
    def add(name: str, target: str, summary: str) -> None:
        register.component("command", name, f"understudy_credits.commands:{target}", summary)

    add("cite", "Cite", "print whom a run is owed to, as BibTeX: understudy cite RUN")
    add(
        "licence",
        "Licence",
        "say on what terms a run may be used: understudy licence RUN --for commercial",
    )
