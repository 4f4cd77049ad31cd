"""Generic parts that papers share, each of a few lines: policies, and what learners have in common;
terms and memories of any field, curricula of a difficulty, banks of states, controllers of other runs."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.kind("skill", "a trained policy that comes with a plugin")
    add = register.component
    add("policy", "mlp", "understudy_basics.policies:MLPPolicy", "MLP actor and critic")
    add("policy", "cnn", "understudy_basics.policies:CNNPolicy", "image and flat observation")
    for kind in ("measure", "reward"):
        add(kind, "value", "understudy_basics.terms:value", "a field itself")
    add(
        "measure",
        "value_where",
        "understudy_basics.terms:value_where",
        "a field where another is not 0",
    )
    add("termination", "reached", "understudy_basics.terms:reached", "a field is small enough")
    add("termination", "beyond", "understudy_basics.terms:beyond", "a field is too large")
    memories = "understudy_basics.memories"
    add("memory", "timer", f"{memories}:Timer", "how long a condition has held")
    add("memory", "latch", f"{memories}:Latch", "a field as it was when a condition first held")
    add("memory", "running_mean", f"{memories}:RunningMean", "a field's mean over the episode")
    add("memory", "extremes", f"{memories}:Extremes", "the least and the most that a field was")
    add("memory", "redrawn_target", f"{memories}:RedrawnTarget", "a random point in a box")
    add("memory", "history", f"{memories}:History", "a field's last values")
    add("curriculum", "linear", "understudy_basics.curricula:Linear", "difficulty by samples")
    add("curriculum", "adaptive", "understudy_basics.curricula:Adaptive", "difficulty by success")
    add("initial_states", "bank", "understudy_basics.banks:Bank", "where other episodes ended")
    add("job", "harvest", "understudy_basics.harvest:Harvest", "keeps states of ended episodes")
    add("job", "judge", "understudy_basics.judge:Judge", "judges what another run learned")
    add(
        "actuation", "controllers", "understudy_basics.controllers:Controllers",
        "switches between other runs' controllers and gives them a goal",
    )  # fmt: skip


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
