"""Curriculum-based multi-fidelity Bayesian optimisation (thesis, chapter 6)."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("bayes", "sweeps")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "outer_loop": {
        "cmfbo": ("cmfbo:CMFBO", "search by difficulty, easy tasks first"),
    },
}


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.parts(__name__, PARTS)
    register.citation(
        "cmfbo",
        "Yang 2023. Acquiring stylized motor skills for physics-based characters. PhD thesis, Simon "
        "Fraser University, chapter 6.",
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
