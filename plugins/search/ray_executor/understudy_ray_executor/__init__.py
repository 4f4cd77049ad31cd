"""Trials as actors of a Ray cluster, of one machine or of many."""

#: Plugins that this one builds on.
REQUIRES = ("sweeps",)

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "executor": {
        "ray": ("executor:RayExecutor", "trials on a Ray cluster"),
    },
}
