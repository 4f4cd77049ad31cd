"""The motion page: clips and runs in the browser."""

from understudy import hookimpl
from understudy.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ('characters',)


@hookimpl
def understudy_register(register: Registrar) -> None:
    pass
