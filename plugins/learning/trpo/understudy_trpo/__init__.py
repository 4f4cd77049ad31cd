"""Trust region policy optimisation."""

#: Plugins that this one builds on.
REQUIRES = ("networks", "reinforcement")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "learner": {
        "trpo": ("learner:TRPO", "natural gradient within a KL limit"),
    },
}

#: How to cite what is implemented here.
CITATIONS = {
    "trpo": "Schulman et al. 2015. Trust region policy optimization. arXiv:1502.05477.",
}
