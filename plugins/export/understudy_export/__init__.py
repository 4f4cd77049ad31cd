"""Animation out: runs and clips as BVH, glTF and USD."""

from understudy import hookimpl
from understudy.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ('characters',)


@hookimpl
def understudy_register(register: Registrar) -> None:
    pass
