"""Learning by derivatives of a learned model of what the character does."""

#: Plugins that this one builds on.
REQUIRES = ("networks", "tensors", "mujoco", "reinforcement")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "learner": {
        "imagination": ("learner:Imagination", "gradients through a learned model, at real states"),
    },
}

#: How to cite what is implemented here.
CITATIONS = {
    "heess2015": (
        "Heess et al. 2015. Learning continuous control policies by stochastic value gradients. "
        "arXiv:1510.09142."
    ),
    "imagination": (
        "Fussell, Bergamin, Holden 2021. SuperTrack: motion tracking for physically simulated "
        "characters using supervised learning. ACM Transactions on Graphics 40(6), 197."
    ),
}
