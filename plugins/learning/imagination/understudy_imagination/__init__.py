"""Learning by derivatives of a learned model of what the character does."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("networks", "tensors", "mujoco")


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.component(
        "learner",
        "imagination",
        "understudy_imagination.learner:Imagination",
        "gradients of the task through a learned model, at real states",
    )
    register.citation(
        "heess2015",
        "Heess et al. 2015. Learning continuous control policies by stochastic value gradients. "
        "arXiv:1510.09142.",
    )
    register.citation(
        "imagination",
        "Fussell, Bergamin, Holden 2021. SuperTrack: motion tracking for physically simulated "
        "characters using supervised learning. ACM Transactions on Graphics 40(6), 197.",
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
