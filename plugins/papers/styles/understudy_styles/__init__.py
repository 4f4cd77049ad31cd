"""Styles of motion: energy, volume and the Gram-matrix reward (thesis, section 3.3.3)."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("networks", "skills", "tensors", "terms", "characters", "motion", "spacetime")

_HERE = "understudy_styles"


@hookimpl
def understudy_register(register: Registrar) -> None:
    add = register.component
    add("fields", "styles/energy", f"{_HERE}.energy:KineticEnergy", "kinetic energy about the com")
    add("fields", "styles/volume", f"{_HERE}.volume:HullVolume", "volume of the convex hull")
    add(
        "fields",
        "styles/accelerations",
        f"{_HERE}.regularity:Accelerations",
        "of links, and of joints",
    )
    add("fields", "styles/features", f"{_HERE}.features:MotionFeatures", "a frame of a motion")
    add(
        "fields",
        "styles/gram",
        f"{_HERE}.gram:GramDistance",
        "how far a cycle's style is from a clip's",
    )
    add("reward", "styles/low_energy", f"{_HERE}.rewards:low_energy", "less kinetic energy")
    add("reward", "styles/high_energy", f"{_HERE}.rewards:high_energy", "more kinetic energy")
    add("reward", "styles/small_volume", f"{_HERE}.rewards:small_volume", "a small convex hull")
    add("reward", "styles/large_volume", f"{_HERE}.rewards:large_volume", "a large convex hull")
    add("reward", "styles/near", f"{_HERE}.rewards:near", "the style of a clip")
    add("reward", "styles/regularity", f"{_HERE}.regularity:Regularity", "calm links and joints")
    add("job", "styles/autoencoder", f"{_HERE}.autoencoder:LearnFeatures", "features of motions")
    register.citation(
        "styles",
        "Holden, Saito, Komura 2016. A deep learning framework for character motion synthesis and "
        "editing. ACM Transactions on Graphics 35(4).",
    )


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
