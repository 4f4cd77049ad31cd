"""Standing upright."""

from pathlib import Path

from understudy import hookimpl
from understudy.registry import Registrar


@hookimpl
def understudy_register(register: Registrar) -> None:
    add = register.component
    add("reward", "balance.upright", "understudy_balance.rewards:upright", "the trunk is upright")
    add(
        "initial_states",
        "balance.standing",
        "understudy_balance.standing:Standing",
        "standing still",
    )
    add("encoder", "balance.posture", "understudy_balance.posture:Posture", "joints and trunk")
    register.task("balance.stand", "stand upright and do not fall")


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
