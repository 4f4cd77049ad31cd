"""Retargeting: the motion of any skeleton on any character."""

#: Plugins that this one builds on.
REQUIRES = ("tensors", "characters", "doctor", "motion")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "command": {
        "motion retarget": ("command:Retarget", "put the motion of any skeleton on a character"),
    },
}
