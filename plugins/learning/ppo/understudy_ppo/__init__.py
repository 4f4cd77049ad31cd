"""Proximal policy optimisation."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("networks",)

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "learner": {
        "ppo": ("learner:PPO", "PPO: clipped, KL penalty, or both"),
    },
}


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.parts(__name__, PARTS)
    register.citation(
        "ppo", "Schulman et al. 2017. Proximal policy optimization algorithms. arXiv:1707.06347."
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
