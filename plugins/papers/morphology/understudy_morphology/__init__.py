"""A walker whose links' lengths and radii are parameters (thesis, section 6.4.1)."""

#: Plugins that this one builds on.
REQUIRES = ("curricula", "networks", "tensors", "terms", "mujoco", "motion", "characters", "ppo")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "scene": {
        "morphology/walker": ("scene:WalkerScene", "a walker of twelve scales"),
    },
    "fields": {
        "morphology/guidance": ("assistance:Guidance", "how stiff the help is, the target speed"),
        "morphology/gait": ("walking:Gait", "how the walker moves"),
        "morphology/worth": ("walking:Worth", "the reward of a step"),
    },
    "actuation": {
        "morphology/helped_torques": ("assistance:HelpedTorques", "torques, and the hand of God"),
    },
    "memory": {
        "morphology/speed": ("walking:Speed", "how much too slow the walker has been"),
    },
    "measure": {
        "morphology/normalised": ("walking:normalised", "eq. 6.4, to be summed"),
    },
    "termination": {
        "morphology/fallen": ("walking:fallen", "low, leaning or turned away"),
    },
    "encoder": {
        "morphology/body": ("walking:Body", "what the walker feels"),
    },
    "initial_states": {
        "morphology/standing": ("walking:Standing", "standing, a little disturbed"),
    },
    "curriculum": {
        "morphology/lessons": ("lessons:Lessons", "less help when the return allows it"),
    },
}

#: Tasks, ``conf/task/NAME.yaml``, and what is learned in each.
TASKS = {
    "morphology/walk": "walk fast with little torque, whatever the limbs",
}

#: How to cite what is implemented here.
CITATIONS = {
    "yu2018symmetric": "Yu, Turk, Liu. Learning symmetric and low-energy locomotion. ACM TOG 37(4), 2018.",
}
