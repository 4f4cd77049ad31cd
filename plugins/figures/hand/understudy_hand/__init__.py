"""A hand on an arm, of any number of fingers and size, with sticks, tongs or a brush, at a table. Knows no paper."""

#: Plugins that this one builds on.
REQUIRES = ("mujoco", "tensors")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "scene": {
        "hand": ("scene:HandScene", "a hand on an arm, with a tool"),
    },
}
