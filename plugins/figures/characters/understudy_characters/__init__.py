"""Characters: any articulated figure that an MJCF model describes, as a part of tasks."""

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
    "memory": {
        "characters/footing": ("footing:Footing", "how far feet slid on the floor and sank in"),
    },
    "termination": {
        "characters/fall": ("parts:Fall", "trunk or head touch the floor where the clip's do not"),
        "characters/floor_contact": ("parts:FloorContact", "trunk or head touch the floor"),
        "characters/motion_end": ("parts:motion_end", "the clip is over"),
    },
}

#: Kinds of parts that this one adds, and what each is.
KINDS = {
    "character": "makes the MJCF model specification of a character",
    "overlay": "what is drawn over the recorded motion of a run",
}
