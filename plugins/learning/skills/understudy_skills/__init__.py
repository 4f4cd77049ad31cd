"""What one training leaves to another: trained policies as parts, and states to begin in."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()

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
    },
}


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.kind("skill", "a trained policy that comes with a plugin")
    register.parts(__name__, PARTS)


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
