"""What one training passes on to another: trained policies as parts, and states to begin in."""

#: Plugins that this one builds on.
REQUIRES = ("reinforcement", "training")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "initial_states": {
        "bank": ("banks:Bank", "where other episodes ended"),
    },
    "job": {
        "harvest": ("harvest:Harvest", "keeps states of ended episodes"),
        "settle": ("settle:Settle", "keeps starts that came to rest"),
        "judge": ("judge:Judge", "judges what another run learned"),
    },
    "actuation": {
        "controllers": ("controllers:Controllers", "switches between other runs' controllers"),
        "replay": ("replay:Replay", "plays the actions of an episode open loop"),
    },
}

#: Kinds of parts that this one adds, and what each is.
KINDS = {"skill": "a trained policy that comes with a plugin"}
