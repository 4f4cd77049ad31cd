"""What one training leaves to another: trained policies as parts, and states to begin in."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.kind("skill", "a trained policy that comes with a plugin")
    add = register.component
    add("initial_states", "bank", "understudy_skills.banks:Bank", "where other episodes ended")
    add("job", "harvest", "understudy_skills.harvest:Harvest", "keeps states of ended episodes")
    add("job", "settle", "understudy_skills.settle:Settle", "keeps starts that came to rest")
    add("job", "judge", "understudy_skills.judge:Judge", "judges what another run learned")
    add(
        "actuation", "controllers", "understudy_skills.controllers:Controllers",
        "switches between other runs' controllers and gives them a goal",
    )  # fmt: skip


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
