"""DeepMimic (Peng et al. 2018; thesis sections 3.5 and 6.4.2): imitate a clip, term by term."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("curricula", "networks", "tensors", "characters", "humanoid", "motion", "mujoco", "ppo")

_HERE = "understudy_deepmimic"


@hookimpl
def understudy_register(register: Registrar) -> None:
    add = register.component
    add("reward", "deepmimic/pose", f"{_HERE}.rewards:pose", "joint orientations")
    add("reward", "deepmimic/velocity", f"{_HERE}.rewards:Velocity", "joint angular velocities")
    add("reward", "deepmimic/end_effectors", f"{_HERE}.rewards:end_effectors", "hands and feet")
    add("reward", "deepmimic/com", f"{_HERE}.rewards:com", "centre of mass")
    add("reward", "deepmimic/imitation", f"{_HERE}.rewards:Imitation", "all four, weighted")
    add("encoder", "deepmimic/state", f"{_HERE}.encoders:StateEncoder", "links and phase")
    add(
        "curriculum",
        "deepmimic/adaptive",
        f"{_HERE}.curricula:Adaptive",
        "episodes get longer while few fail",
    )
    add(
        "curriculum",
        "deepmimic/annealed",
        f"{_HERE}.curricula:Annealed",
        "episodes get longer by samples",
    )
    add("termination", "deepmimic/horizon", f"{_HERE}.horizon:Horizon", "T(z) is over")
    add(
        "measure",
        "deepmimic/normalised_return",
        f"{_HERE}.horizon:NormalisedReturn",
        "the episode's return over T(z)",
    )
    register.task("deepmimic/walk", "imitate a clip: pose, velocity, end-effectors, centre of mass")
    register.citation(
        "deepmimic",
        "Peng, Abbeel, Levine, van de Panne 2018. DeepMimic: Example-guided deep reinforcement "
        "learning of physics-based character skills. ACM Transactions on Graphics 37(4). "
        "arXiv:1804.02717.",
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
