"""Position-based dynamics of particles in Warp, N worlds at once."""

#: Plugins that this one builds on: pictures are drawn with the renderer that `mujoco` has chosen.
REQUIRES = ("mujoco", "tensors", "warp_torch")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "simulator": {
        "pbd": ("simulator:ParticleSimulator", "particles, springs and tools, position-based"),
    },
    "encoder": {
        "pbd/touch": ("touch:Touch", "forces on a tool, and on which of its faces"),
    },
}
