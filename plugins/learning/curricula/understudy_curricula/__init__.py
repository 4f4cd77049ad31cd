"""Curricula of a difficulty, worlds out of step, and what curricula make of the episodes that end."""

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
