"""DeepMimic (Peng et al. 2018; thesis sections 3.5 and 6.4.2): imitate a clip, term by term."""

#: Plugins that this one builds on.
REQUIRES = ("curricula", "networks", "tensors", "characters", "humanoid", "motion", "mujoco", "ppo")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "reward": {
        "deepmimic/pose": ("rewards:pose", "joint orientations"),
        "deepmimic/velocity": ("rewards:Velocity", "joint angular velocities"),
        "deepmimic/end_effectors": ("rewards:end_effectors", "hands and feet"),
        "deepmimic/com": ("rewards:com", "centre of mass"),
        "deepmimic/imitation": ("rewards:Imitation", "all four, weighted"),
    },
    "encoder": {
        "deepmimic/state": ("encoders:StateEncoder", "links and phase"),
    },
    "curriculum": {
        "deepmimic/adaptive": ("curricula:Adaptive", "episodes get longer while few fail"),
        "deepmimic/annealed": ("curricula:Annealed", "episodes get longer by samples"),
    },
    "termination": {
        "deepmimic/horizon": ("horizon:Horizon", "T(z) is over"),
    },
    "measure": {
        "deepmimic/normalised_return": ("horizon:NormalisedReturn", "the return over T(z)"),
    },
}

#: Tasks, ``conf/task/NAME.yaml``, and what is learned in each.
TASKS = {
    "deepmimic/walk": "imitate a clip: pose, velocity, end-effectors, centre of mass",
}

#: How to cite what is implemented here.
CITATIONS = {
    "deepmimic": (
        "Peng, Abbeel, Levine, van de Panne 2018. DeepMimic: Example-guided deep reinforcement "
        "learning of physics-based character skills. ACM Transactions on Graphics 37(4). "
        "arXiv:1804.02717."
    ),
}
