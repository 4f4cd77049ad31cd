"""Commands that show what there is: plugins, tasks, and every value of a configuration."""

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()

_HERE = "understudy_inspect.commands"


@hookimpl
def understudy_register(register: Registrar) -> None:
    def add(name: str, target: str, summary: str) -> None:
        register.component("command", name, f"{_HERE}:{target}", summary)

    add("plugins", "ListPlugins", "list the plugins and what they provide")
    add("tasks", "ListTasks", "list the tasks")
    add("config", "ShowConfiguration", "print every value of a configuration and where it is from")
    add("replay", "Replay", "repeat the step in which a run's numbers went wrong")
