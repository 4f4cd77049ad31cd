"""Curricula of a difficulty, worlds that are out of step, and the judging of ended episodes."""

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "curriculum": {
        "linear": ("curricula:Linear", "difficulty by samples"),
        "adaptive": ("curricula:Adaptive", "difficulty by success"),
        "staggered": ("staggered:Staggered", "worlds out of step: first episodes are cut"),
    },
}
