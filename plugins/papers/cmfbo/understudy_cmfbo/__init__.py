"""Curriculum-based multi-fidelity Bayesian optimisation (thesis, chapter 6)."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("bayes", "sweeps")


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.component(
        "outer_loop",
        "cmfbo",
        "understudy_cmfbo.cmfbo:CMFBO",
        "search by difficulty, easy tasks first",
    )
    register.citation(
        "cmfbo",
        "Yang 2023. Acquiring stylized motor skills for physics-based characters. PhD thesis, Simon "
        "Fraser University, chapter 6.",
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
