"""A pose auto-encoder as action space (thesis, section 4.4.2)."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("networks", "skills", "tensors", "characters", "inspect", "motion", "report")

_HERE = "understudy_pose_vae"


@hookimpl
def understudy_register(register: Registrar) -> None:
    add = register.component
    add("job", "pose_vae/autoencoder", f"{_HERE}.job:LearnPoses", "a pose auto-encoder of clips")
    add("actuation", "pose_vae/offset", f"{_HERE}.actuation:PoseOffset", "decoded pose plus offset")
    add("reward", "pose_vae/naturalness", f"{_HERE}.terms:naturalness", "with small offsets")
    add(
        "measure",
        "pose_vae/distance",
        f"{_HERE}.terms:PoseDistance",
        "degrees to the nearest pose of a run's clips",
    )
    add("memory", "pose_vae/jerk", f"{_HERE}.terms:Jerk", "mean jerk of a character's links")
    add(
        "command",
        "pose_vae naturalness",
        f"{_HERE}.natural:Naturalness",
        "how near runs are to captured poses, and their jerk",
    )
    add("report_section", "pose_vae/poses", f"{_HERE}.report:PosesSection", "poses that it makes")
    register.citation(
        "pose_vae",
        "Yin, Yang, van de Panne, Yin 2021. Discovering diverse athletic jumping strategies. "
        "ACM Transactions on Graphics 40(4) (SIGGRAPH).",
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
