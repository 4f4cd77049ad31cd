"""Whom a run is owed to, and on what terms: commands ``cite`` and ``licence``."""

#: Plugins that this one builds on.
REQUIRES = ("reinforcement", "report", "skills")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "command": {
        "cite": ("commands:Cite", "print what to cite for a run, as BibTeX: understudy cite RUN"),
        "licence": ("commands:Licence", "say on what terms a run may be used: RUN --for USE"),
    },
}
