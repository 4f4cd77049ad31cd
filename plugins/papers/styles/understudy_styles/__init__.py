"""Styles of motion: energy, volume and the Gram-matrix reward (thesis, section 3.3.3)."""

#: Plugins that this one builds on.
REQUIRES = (
    "networks", "skills", "tensors", "terms", "characters", "motion", "spacetime", "reinforcement",
)  # fmt: skip

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "fields": {
        "styles/energy": ("energy:KineticEnergy", "kinetic energy about the com"),
        "styles/volume": ("volume:HullVolume", "volume of the convex hull"),
        "styles/accelerations": ("regularity:Accelerations", "accelerations of links and joints"),
        "styles/features": ("features:MotionFeatures", "a frame of a motion"),
        "styles/gram": ("gram:GramDistance", "how far a cycle's style is from a clip's"),
    },
    "reward": {
        "styles/low_energy": ("rewards:low_energy", "less kinetic energy"),
        "styles/high_energy": ("rewards:high_energy", "more kinetic energy"),
        "styles/small_volume": ("rewards:small_volume", "a small convex hull"),
        "styles/large_volume": ("rewards:large_volume", "a large convex hull"),
        "styles/near": ("rewards:near", "the style of a clip"),
        "styles/regularity": ("regularity:Regularity", "calm links and joints"),
    },
    "job": {
        "styles/autoencoder": ("autoencoder:LearnFeatures", "features of motions"),
    },
}

#: How to cite what is implemented here.
CITATIONS = {
    "styles": (
        "Holden, Saito, Komura 2016. A deep learning framework for character motion synthesis and "
        "editing. ACM Transactions on Graphics 35(4)."
    ),
}
