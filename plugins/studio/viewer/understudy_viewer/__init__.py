"""The motion page: clips and runs in the browser."""

#: Plugins that this one builds on.
REQUIRES = ("skills", "tensors", "characters", "doctor", "motion", "mujoco")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "command": {
        "motion view": ("command:View", "show a clip, or a run and its reference, in the browser"),
    },
}
