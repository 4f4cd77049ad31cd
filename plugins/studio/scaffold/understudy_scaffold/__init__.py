"""``understudy new``: a package of your own to begin with."""

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "command": {
        "new plugin": ("new:NewPlugin", "write a package with rewards, an observation, or both"),
        "new paper": ("new:NewPaper", "write a package for a paper, with page and table"),
    },
}
