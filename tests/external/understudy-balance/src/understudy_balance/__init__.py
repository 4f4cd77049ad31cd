"""Standing upright."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "reward": {
        "balance/upright": ("terms:upright", "the trunk is upright"),
    },
    "termination": {
        "balance/leaning": ("terms:leaning", "the trunk leans too far"),
    },
    "encoder": {
        "balance/posture": ("posture:Posture", "joints and trunk"),
    },
    "actuation": {
        "balance/smooth_targets": ("smooth_targets:SmoothTargets", "targets that change slowly"),
    },
    "memory": {
        "balance/upright_time": ("upright_time:UprightTime", "how long it has stood upright"),
    },
    "initial_states": {
        "balance/standing": ("standing:Standing", "standing, pushed"),
    },
    "report_section": {
        "balance/standing": ("section:StandingSection", "how long it stood"),
    },
}


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.parts(__name__, PARTS)
    register.task("balance/stand", "stand upright after a push")


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
