"""understudy: simulated characters learn physical skills, from parts that plugins provide."""

from understudy.setup.plugins import hookimpl

__version__ = "0.2.0"
__all__ = ["__version__", "hookimpl"]
