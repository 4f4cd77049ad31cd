"""Styles of motion: energy, volume and the Gram-matrix reward (thesis, section 3.3.3)."""

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()


@hookimpl
def understudy_register(register: Registrar) -> None:
    pass
