"""Proximal policy optimisation."""

#: Plugins that this one builds on.
REQUIRES = ("networks", "reinforcement")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "learner": {
        "ppo": ("learner:PPO", "PPO: clipped, KL penalty, or both"),
    },
}

#: How to cite what is implemented here.
CITATIONS = {
    "ppo": "Schulman et al. 2017. Proximal policy optimization algorithms. arXiv:1707.06347.",
}
