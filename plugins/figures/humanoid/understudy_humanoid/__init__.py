"""The 34-DoF humanoid and the jumper, and motions made for them. Knows no paper."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("mujoco", "motion", "characters")

_HERE = "understudy_humanoid"
_CLIPS = {
    "walk": "a generated walk, straight or along an arc",
    "run": "a generated run",
    "hop": "generated hops, on both legs or one",
    "turn_left": "a generated turn to the left in place",
    "turn_right": "a generated turn to the right in place",
    "sit": "generated sitting down on a chair",
    "stand": "generated standing up from a chair",
    "cartwheel": "a generated cartwheel to the left",
    "backflip": "a generated backflip",
}


@hookimpl
def understudy_register(register: Registrar) -> None:
    add = register.component
    add("character", "humanoid", f"{_HERE}.character:build_humanoid", "the humanoid, 45 kg")
    add("character", "jumper", f"{_HERE}.jumper:build_jumper", "a stronger humanoid, 60 kg")
    for name, summary in _CLIPS.items():
        add("clip", name, f"{_HERE}.clips:generated_{name}", summary)


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
