"""The commands train and resume: a run from its beginning to its last evaluation."""

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "command": {
        "train": ("commands:Train", "train an experiment"),
        "resume": ("commands:Resume", "continue a training"),
    },
}
