"""Trust region policy optimisation."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("networks",)

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "learner": {
        "trpo": ("learner:TRPO", "natural gradient within a KL limit"),
    },
}


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.parts(__name__, PARTS)
    register.citation(
        "trpo", "Schulman et al. 2015. Trust region policy optimization. arXiv:1502.05477."
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
