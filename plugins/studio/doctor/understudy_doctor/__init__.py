"""The clip doctor: what is wrong with a clip, and what repairs it."""

#: Plugins that this one builds on.
REQUIRES = ("tensors", "characters", "credits", "motion", "report", "skills")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "command": {
        "motion check": ("command:Check", "examine and repair a clip"),
    },
}
