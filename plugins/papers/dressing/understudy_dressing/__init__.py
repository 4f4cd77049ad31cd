"""Learning to dress (Clegg et al. 2018): a person, a sleeve, and what the two have to do with each other."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = (
    "cloth", "composite", "mujoco", "networks", "ppo", "report", "tensors", "terms", "warp_torch",
)  # fmt: skip

_HERE = "understudy_dressing"


@hookimpl
def understudy_register(register: Registrar) -> None:
    add = register.component
    add(
        "scene",
        "dressing/person",
        f"{_HERE}.person:PersonScene",
        "a torso with arms, and a gripper",
    )
    add("scene", "dressing/sleeve", f"{_HERE}.sleeve:SleeveScene", "a sleeve that a gripper holds")
    add(
        "fields",
        "dressing/sleeve_state",
        f"{_HERE}.state:SleeveState",
        "touch and limb in a sleeve",
    )
    add("encoder", "dressing/sleeve", f"{_HERE}.parts:SleeveObservation", "equations 2 to 7")
    add("actuation", "dressing/torques", f"{_HERE}.parts:Torques", "the joints' torques")
    add("initial_states", "dressing/track", f"{_HERE}.initial_states:Track", "a sleeve on its way")
    for name, function, summary in (
        ("deformation", "deformation", "equation 13: stretched cloth"),
        ("geodesic", "geodesic", "equation 15: touched near the opening, along the cloth"),
        ("along_task_vector", "along_task_vector", "equation 16: the fingertip's way"),
        ("target_pose", "TargetPose", "equation 17: distance from a pose"),
        ("upright", "Upright", "the torso's and the head's lean"),
    ):
        add("reward", f"dressing/{name}", f"{_HERE}.terms:{function}", summary)
    register.citation(
        "dressing",
        "Clegg, Yu, Tan, Liu, Turk 2018. Learning to dress: synthesizing human dressing motion via deep "
        "reinforcement learning. ACM Transactions on Graphics 37(6), 179.",
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
