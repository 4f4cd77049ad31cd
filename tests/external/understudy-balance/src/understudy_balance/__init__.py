"""Standing upright."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

_HERE = "understudy_balance"


@hookimpl
def understudy_register(register: Registrar) -> None:
    add = register.component
    add("reward", "balance/upright", f"{_HERE}.terms:upright", "the trunk is upright")
    add("termination", "balance/leaning", f"{_HERE}.terms:leaning", "the trunk leans too far")
    add("encoder", "balance/posture", f"{_HERE}.posture:Posture", "joints and trunk")
    add("actuation", "balance/smooth_targets", f"{_HERE}.smooth_targets:SmoothTargets")
    add("memory", "balance/upright_time", f"{_HERE}.upright_time:UprightTime")
    add("initial_states", "balance/standing", f"{_HERE}.standing:Standing", "standing, pushed")
    add("report_section", "balance/standing", f"{_HERE}.section:StandingSection")
    register.task("balance/stand", "stand upright after a push")


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
