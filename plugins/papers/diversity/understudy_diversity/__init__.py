"""Diversity searches: Bayesian, random, MAP-Elites, novel policies; and a gallery of what they found."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("networks", "tensors", "terms", "bayes", "ppo", "report", "sweeps")

#: By module and kind: the component's name, its class or function, and what it is.
_PARTS = {
    ("search", "outer_loop"): {
        "diversity/bayesian": ("DiversitySearch", "Bayesian diversity search"),
        "diversity/random": ("RandomDiversity", "strategies at points drawn uniformly"),
    },
    ("map_elites", "outer_loop"): {
        "diversity/map_elites": ("MapElites", "MAP-Elites, through pyribs"),
    },
    ("novel_policies", "outer_loop"): {
        "diversity/novel_policies": ("NovelPolicies", "other policies from strategies found"),
    },
    ("novelty", "reward"): {"diversity/novelty": ("Novelty", "unlike the strategies known")},
    ("count", "command"): {
        "diversity count": ("Count", "how many different strategies searches found")
    },
    ("gallery", "sweep_page"): {"diversity/gallery": ("Gallery", "the strategies of a search")},
    ("vault", "scene"): {"diversity/vault": ("VaultScene", "a jumper and a bar, in the plane")},
    ("vault", "simulator"): {"diversity/vault": ("Vault", "a body that tucks and turns in flight")},
    ("vault", "initial_states"): {"diversity/take_off": ("TakeOff", "spin, climb and lean")},
    ("vault", "fields"): {"diversity/bar": ("Bar", "how high above the bar the body is")},
    ("vault", "encoder"): {"diversity/body_state": ("BodyState", "the body in flight")},
    ("vault", "actuation"): {"diversity/limbs": ("Limbs", "how tucked to be, how hard to turn")},
    ("vault", "reward"): {
        "diversity/passing": ("passing", "passed the bar, the higher the better")
    },
    ("vault", "termination"): {
        "diversity/knocked": ("knocked", "passed the bar too low"),
        "diversity/landed": ("landed", "on the mat behind the bar"),
    },
}


@hookimpl
def understudy_register(register: Registrar) -> None:
    for (module, kind), parts in _PARTS.items():
        for name, (target, summary) in parts.items():
            register.component(kind, name, f"understudy_diversity.{module}:{target}", summary)
    register.task("diversity/vault", "a body passes over a bar in one way or another")
    register.citation(
        "diversity",
        "Yin, Yang, van de Panne, Yin 2021. Discovering diverse athletic jumping strategies. "
        "ACM Transactions on Graphics 40(4) (SIGGRAPH).",
    )
    register.citation(
        "map_elites",
        "Mouret, Clune 2015. Illuminating search spaces by mapping elites. arXiv:1504.04909. "
        "Through pyribs: Tjanaka et al. 2023, GECCO.",
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
