"""Trust region policy optimisation."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("networks",)


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.component(
        "learner", "trpo", "understudy_trpo.learner:TRPO", "natural gradient within a KL limit"
    )
    register.citation(
        "trpo", "Schulman et al. 2015. Trust region policy optimization. arXiv:1502.05477."
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
