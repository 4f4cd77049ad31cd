"""Learning to dress (Clegg et al. 2018): a person, garments, and how each touches the other."""

from understudy_skills.packaged import skills_beside

#: Plugins that this one builds on.
REQUIRES = (
    "characters", "cloth", "composite", "mujoco", "networks", "ppo", "reinforcement", "report", "skills", "tensors", "terms", "warp_torch",
)  # fmt: skip

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "scene": {
        "dressing/person": ("person:PersonScene", "a torso with arms, and a gripper"),
        "dressing/sleeve": ("sleeve:SleeveScene", "a sleeve that a gripper holds"),
        "dressing/gown": ("gown:GownScene", "a gown from a file, held beside a sleeve"),
        "dressing/shirt": ("shirt:ShirtScene", "a T-shirt whose hem hands can hold"),
        "dressing/jacket": ("jacket:JacketScene", "a jacket that hangs from a hand"),
        "dressing/skirt": ("skirt:SkirtScene", "a skirt that a character wears"),
    },
    "coupling": {
        "dressing/worn": ("skirt:Worn", "a skirt that its wearer moves"),
    },
    "fields": {
        "dressing/limb_progress": ("state:LimbProgress", "how far a limb is in a sleeve"),
        "dressing/sleeve_state": ("state:SleeveState", "touch and limb in a sleeve"),
        "dressing/shirt_state": ("shirt_state:ShirtState", "hem, collar, and arm under the hem"),
    },
    "encoder": {
        "dressing/sleeve": ("parts:SleeveObservation", "equations 2 to 7"),
        "dressing/body": ("parts:BodyObservation", "pose, velocity, and what is felt"),
        "dressing/reach": ("parts:Reach", "where a hand is to grip"),
        "dressing/gripper": ("gripper:GripperObservation", "the person's pose and the gripper's"),
    },
    "actuation": {
        "dressing/torques": ("parts:Torques", "the joints' torques"),
        "dressing/gripper": ("gripper:GripperForces", "a gripper's forces; a run leads the person"),
    },
    "measure": {
        "dressing/pose_error": ("terms:PoseError", "the distance from the neutral pose"),
        "dressing/on_the_way": ("terms:on_the_way", "1 until the limb was in far enough"),
    },
    "initial_states": {
        "dressing/track": ("initial_states:Track", "a sleeve on its way"),
        "dressing/worn_shirt": ("initial_states:WornShirt", "a shirt on the shoulders"),
        "dressing/held_jacket": ("initial_states:HeldJacket", "a jacket hangs from the left hand"),
    },
    "job": {
        "dressing/lead": ("lead:Lead", "leads arms from under the hem into the sleeve"),
        "dressing/lead_grip": ("lead_grip:LeadGrip", "leads a dressed arm's hand to the hem"),
        "dressing/lead_rest": ("lead_rest:LeadRest", "leads a dressed person to the neutral pose"),
    },
    "reward": {
        "dressing/along_way": ("terms:AlongWay", "how near the pose is to one that was led"),
        "dressing/deformation": ("terms:deformation", "equation 13: stretched cloth"),
        "dressing/geodesic": ("terms:geodesic", "equation 15: touched near the sleeve's opening"),
        "dressing/along_task_vector": ("terms:along_task_vector", "eq. 16: the fingertip's way"),
        "dressing/target_pose": ("terms:TargetPose", "equation 17: distance from a pose"),
        "dressing/upright": ("terms:Upright", "the torso's and the head's lean"),
    },
}

#: How to cite what is implemented here.
CITATIONS = {
    "dressing": (
        "Clegg, Yu, Tan, Liu, Turk 2018. Learning to dress: synthesizing human dressing motion via deep "
        "reinforcement learning. ACM Transactions on Graphics 37(6), 179."
    ),
}

understudy_register = skills_beside(__file__)
