"""One command for every table of a paper, and the card that it leaves."""

#: Plugins that this one builds on.
REQUIRES = ("report", "sweeps", "training")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "command": {
        "reproduce": ("command:Reproduce", "run what a paper's table compares, beside its numbers"),
    },
}
