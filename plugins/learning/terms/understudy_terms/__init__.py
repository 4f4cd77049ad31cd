"""Terms and memories of any field, whatever the task."""

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()


@hookimpl
def understudy_register(register: Registrar) -> None:
    add, terms, memories = register.component, "understudy_terms.terms", "understudy_terms.memories"
    add("measure", "value", f"{terms}:value", "a field itself")
    add("reward", "value", f"{terms}:value", "a field itself")
    add("measure", "value_where", f"{terms}:value_where", "a field where another is not 0")
    add("termination", "reached", f"{terms}:reached", "a field is small enough")
    add("termination", "beyond", f"{terms}:beyond", "a field is too large")
    add("memory", "timer", f"{memories}:Timer", "how long a condition has held")
    add("memory", "latch", f"{memories}:Latch", "a field as it was when a condition first held")
    add("memory", "running_mean", f"{memories}:RunningMean", "a field's mean over the episode")
    add("memory", "extremes", f"{memories}:Extremes", "the least and the most that a field was")
    add("memory", "redrawn_target", f"{memories}:RedrawnTarget", "a random point in a box")
    add("memory", "history", f"{memories}:History", "a field's last values")
