"""Characters: any articulated figure that an MJCF model describes, as a part of tasks. Knows no
particular one."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("tensors", "mujoco", "motion")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "scene": {
        "character": ("scene:CharacterScene", "a character on a floor"),
    },
    "fields": {
        "characters/kinematics": ("parts:Kinematics", "links, joints, end-effectors"),
        "characters/reference": ("parts:Reference", "the clip's state at this time"),
    },
    "actuation": {
        "characters/joint_targets": ("parts:JointTargets", "PD targets of all joints"),
    },
    "initial_states": {
        "characters/reference_states": ("initial_states:ReferenceStates", "any time of the clip"),
    },
    "termination": {
        "characters/fall": ("parts:Fall", "trunk or head touch the floor where the clip's do not"),
        "characters/floor_contact": ("parts:FloorContact", "trunk or head touch the floor"),
        "characters/motion_end": ("parts:motion_end", "the clip is over"),
    },
}


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.kind("character", "makes the MJCF model specification of a character")
    register.kind("overlay", "what is drawn over the recorded motion of a run")
    register.parts(__name__, PARTS)


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
