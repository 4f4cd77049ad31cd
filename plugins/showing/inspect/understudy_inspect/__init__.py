"""Commands that show what there is, and judge and draw what was trained."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from understudy import hookimpl
from understudy.setup.registry import Registrar

if TYPE_CHECKING:
    from understudy.records.observer import RunObserver

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()

_HERE = "understudy_inspect"


@hookimpl
def understudy_register(register: Registrar) -> None:
    def add(name: str, target: str, summary: str) -> None:
        register.component("command", name, f"{_HERE}.{target}", summary)

    add("experiments", "commands:ListExperiments", "list what can be trained")
    add("tasks", "commands:ListTasks", "list the tasks")
    add("plugins", "commands:ListPlugins", "list the plugins and what they provide")
    add("describe", "commands:Describe", "print a part's options: understudy describe learner/ppo")
    add(
        "config",
        "commands:ShowConfiguration",
        "print every value of a configuration and where it is from",
    )
    add("evaluate", "judging:Evaluate", "evaluate a trained run")
    add("render", "judging:Render", "evaluate a run while recording, and make its report anew")
    add("replay", "commands:Replay", "repeat the step in which a run's numbers went wrong")
    add("completion", "completion:Completion", "print the completion of bash, zsh or fish")


@hookimpl
def understudy_run_observers() -> Iterable[RunObserver]:
    from understudy_inspect.code import RecordCode
    from understudy_inspect.origins import RecordOrigins

    return [RecordOrigins(), RecordCode()]
