"""Standing upright."""

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "reward": {
        "balance/upright": ("terms:upright", "the trunk is upright"),
        "balance/head": ("head:HeadHeight", "the head is high"),
    },
    "termination": {
        "balance/leaning": ("terms:leaning", "the trunk leans too far"),
    },
    "encoder": {
        "balance/posture": ("posture:Posture", "joints and trunk"),
    },
    "actuation": {
        "balance/smooth_targets": ("smooth_targets:SmoothTargets", "targets that change slowly"),
    },
    "memory": {
        "balance/upright_time": ("upright_time:UprightTime", "how long it has stood upright"),
    },
    "initial_states": {
        "balance/standing": ("standing:Standing", "standing, pushed"),
    },
    "report_section": {
        "balance/standing": ("section:StandingSection", "how long it stood"),
    },
}

#: Tasks, ``conf/task/NAME.yaml``, and what is learned in each.
TASKS = {
    "balance/stand": "stand upright after a push",
}
