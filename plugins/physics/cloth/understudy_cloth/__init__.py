"""Cloth by position-based dynamics in small steps, in Warp, N worlds at once."""

#: Plugins that this one builds on: pictures are drawn with the renderer that `mujoco` has chosen.
REQUIRES = ("mujoco", "tensors", "warp_torch")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "simulator": {
        "cloth": ("simulator:ClothSimulator", "a garment and bodies, by XPBD in small steps"),
    },
    "command": {
        "garment check": ("garment_command:Check", "whether a garment's files can be used"),
    },
}

#: How to cite what is implemented here.
CITATIONS = {
    "cloth": (
        "Macklin, Storey, Lu, Terdiman, Chentanez, Jeschke, Müller 2019. Small steps in physics simulation. "
        "ACM SIGGRAPH/Eurographics Symposium on Computer Animation."
    ),
}
