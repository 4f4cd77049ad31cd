"""The commands ``evaluate`` and ``render``, which judge a run again on starts that no training drew, and draw it."""

#: Plugins that this one builds on.
REQUIRES = ("reinforcement", "skills", "training")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "command": {
        "evaluate": ("commands:Evaluate", "evaluate a trained run"),
        "render": ("commands:Render", "evaluate a run while recording, and make its report anew"),
    },
}
