"""A pose auto-encoder as action space (thesis, section 4.4.2)."""

#: Plugins that this one builds on.
REQUIRES = (
    "networks", "skills", "tensors", "characters", "judging", "motion", "report", "reinforcement",
)  # fmt: skip

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "job": {
        "pose_vae/autoencoder": ("job:LearnPoses", "a pose auto-encoder of clips"),
    },
    "actuation": {
        "pose_vae/offset": ("actuation:PoseOffset", "decoded pose plus offset"),
    },
    "reward": {
        "pose_vae/naturalness": ("terms:naturalness", "the offsets are small"),
    },
    "measure": {
        "pose_vae/distance": ("terms:PoseDistance", "degrees to the nearest pose of a run's clips"),
    },
    "memory": {
        "pose_vae/jerk": ("terms:Jerk", "mean jerk of a character's links"),
    },
    "command": {
        "pose_vae naturalness": ("natural:Naturalness", "how near runs are to captured poses"),
    },
    "report_section": {
        "pose_vae/poses": ("report:PosesSection", "poses that an auto-encoder makes"),
    },
}

#: How to cite what is implemented here.
CITATIONS = {
    "pose_vae": (
        "Yin, Yang, van de Panne, Yin 2021. Discovering diverse athletic jumping strategies. "
        "ACM Transactions on Graphics 40(4) (SIGGRAPH)."
    ),
}
