"""Curriculum-based multi-fidelity Bayesian optimisation (thesis, chapter 6)."""

#: Plugins that this one builds on.
REQUIRES = ("bayes", "reinforcement", "sweeps")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "outer_loop": {
        "cmfbo": ("cmfbo:CMFBO", "search by difficulty, easy tasks first"),
    },
}

#: How to cite what is implemented here.
CITATIONS = {
    "cmfbo": (
        "Yang 2023. Acquiring stylized motor skills for physics-based characters. PhD thesis, Simon "
        "Fraser University, chapter 6."
    ),
}
