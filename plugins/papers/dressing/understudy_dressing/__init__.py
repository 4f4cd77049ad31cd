"""Learning to dress (Clegg et al. 2018): a person, a sleeve, and what the two have to do with each other."""

#: Plugins that this one builds on.
REQUIRES = (
    "cloth", "composite", "mujoco", "networks", "ppo", "report", "tensors", "terms", "warp_torch",
)  # fmt: skip

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "scene": {
        "dressing/person": ("person:PersonScene", "a torso with arms, and a gripper"),
        "dressing/sleeve": ("sleeve:SleeveScene", "a sleeve that a gripper holds"),
    },
    "fields": {
        "dressing/sleeve_state": ("state:SleeveState", "touch and limb in a sleeve"),
    },
    "encoder": {
        "dressing/sleeve": ("parts:SleeveObservation", "equations 2 to 7"),
    },
    "actuation": {
        "dressing/torques": ("parts:Torques", "the joints' torques"),
    },
    "initial_states": {
        "dressing/track": ("initial_states:Track", "a sleeve on its way"),
    },
    "reward": {
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
