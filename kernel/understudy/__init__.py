"""understudy: simulated characters learn physical skills, from parts that plugins provide."""

from importlib.metadata import version

from understudy.setup.plugins import hookimpl

__version__ = version("understudy")
__all__ = ["__version__", "hookimpl"]
