"""Standing upright."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

_HERE = "understudy_balance"


@hookimpl
def understudy_register(register: Registrar) -> None:
    add = register.component
    add("reward", "balance.upright", f"{_HERE}.rewards:upright", "the trunk is upright")
    add("encoder", "balance.posture", f"{_HERE}.posture:Posture", "joints and trunk")
    add("initial_states", "balance.standing", f"{_HERE}.standing:Standing", "standing still")
    register.task("balance.stand", "stand upright and do not fall")


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
