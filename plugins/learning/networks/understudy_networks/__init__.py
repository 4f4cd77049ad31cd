"""Networks, the policies made of them, and what learners share."""

#: Plugins that this one builds on.
REQUIRES = ("reinforcement",)

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "policy": {
        "mlp": ("policies:MLPPolicy", "MLP actor and critic"),
        "cnn": ("policies:CNNPolicy", "image and flat observation"),
    },
}
