"""Trained skills that come with the package, live in the browser."""

#: Plugins that this one builds on.
REQUIRES = (
    "skills",
    "characters",
    "motion",
    "mujoco",
    "report",
    "credits",
    "viewer",
    "reinforcement",
)

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "command": {
        "play": ("command:Play", "watch a trained policy live in the browser and push it"),
    },
}
