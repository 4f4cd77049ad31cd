"""Networks, the policies made of them, and what every learner has in common."""

from pathlib import Path

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()


@hookimpl
def understudy_register(register: Registrar) -> None:
    add = register.component
    add("policy", "mlp", "understudy_networks.policies:MLPPolicy", "MLP actor and critic")
    add("policy", "cnn", "understudy_networks.policies:CNNPolicy", "image and flat observation")


@hookimpl
def understudy_config_directory() -> Path:
    return Path(__file__).parent / "conf"
