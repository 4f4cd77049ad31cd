"""The 34-DoF humanoid, its kinematics, and its reference motions. Knows no paper."""

from pathlib import Path

from understudy import hookimpl
from understudy.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("mujoco", "motion")

_HERE = "understudy_humanoid"


@hookimpl
def understudy_register(register: Registrar) -> None:
    add = register.component
    add("scene", "humanoid", f"{_HERE}.scene:HumanoidScene", "a 34-DoF humanoid on a floor")
    add(
        "fields", "humanoid.kinematics", f"{_HERE}.parts:Kinematics", "links, joints, end-effectors"
    )
    add("fields", "humanoid.reference", f"{_HERE}.parts:Reference", "the clip's state at this time")
    add(
        "actuation",
        "humanoid.joint_targets",
        f"{_HERE}.parts:JointTargets",
        "PD targets of all joints",
    )
    add(
        "termination",
        "humanoid.fall",
        f"{_HERE}.parts:Fall",
        "a body that must not touches the floor",
    )
    add("clip", "walk", f"{_HERE}.generated:generated_walk", "a generated walk")


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
