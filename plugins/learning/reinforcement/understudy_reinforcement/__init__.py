"""Reinforcement learning: the job of a run that names none."""

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "job": {
        "reinforcement": ("job:Reinforcement", "collect, learn, adapt where episodes begin"),
    },
}

#: Sections of a configuration: the options, and what is built of them.
SECTIONS = {
    "resolution": ("resolution:ResolutionOptions", "resolution:section"),
    "start": ("start:StartOptions", "start:section"),
}
