"""Characters: any articulated figure that an MJCF model describes, as a part of tasks. Knows no
particular one."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("tensors", "mujoco", "motion")

_HERE = "understudy_characters"


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.kind("character", "makes the MJCF model specification of a character")
    register.kind("overlay", "what is drawn over the recorded motion of a run")
    add = register.component
    add("scene", "character", f"{_HERE}.scene:CharacterScene", "a character on a floor")
    add(
        "fields",
        "characters/kinematics",
        f"{_HERE}.parts:Kinematics",
        "links, joints, end-effectors",
    )
    add(
        "fields",
        "characters/reference",
        f"{_HERE}.parts:Reference",
        "the clip's state at this time",
    )
    add(
        "actuation",
        "characters/joint_targets",
        f"{_HERE}.parts:JointTargets",
        "PD targets of all joints",
    )
    add(
        "initial_states",
        "characters/reference_states",
        f"{_HERE}.initial_states:ReferenceStates",
        "the clip's state at a uniformly drawn time",
    )
    add(
        "termination",
        "characters/fall",
        f"{_HERE}.parts:Fall",
        "trunk or head touch the floor where the clip's do not",
    )
    add(
        "termination",
        "characters/floor_contact",
        f"{_HERE}.parts:FloorContact",
        "trunk or head touch the floor",
    )
    add(
        "termination",
        "characters/motion_end",
        f"{_HERE}.parts:motion_end",
        "the clip is over",
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
