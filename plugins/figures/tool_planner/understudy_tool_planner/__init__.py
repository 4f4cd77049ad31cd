"""Plans how two sticks, or tongs, take an object and put it elsewhere. Knows no task and no policy."""

#: Plugins that this one builds on.
REQUIRES = ("gripping", "hand", "mujoco", "tensors")

#: How to cite what is implemented here.
CITATIONS = {
    "tolani1996arm": (
        "Tolani, Badler. Real-time inverse kinematics of the human arm. Presence: Teleoperators and Virtual "
        "Environments 5(4), 1996."
    ),
}
