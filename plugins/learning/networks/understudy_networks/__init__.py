"""Networks, the policies made of them, and what every learner has in common."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "policy": {
        "mlp": ("policies:MLPPolicy", "MLP actor and critic"),
        "cnn": ("policies:CNNPolicy", "image and flat observation"),
    },
}


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.parts(__name__, PARTS)


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
