"""understudy: simulated characters learn physical skills, from parts that plugins provide."""

import os
from importlib.metadata import version

from understudy.setup.plugins import hookimpl

# Torch's OpenMP reads it when torch is imported, later than this. Threads that helped with a
# network would spin on cores that simulators, or other programs, need.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

__version__ = version("understudy")
__all__ = ["__version__", "hookimpl"]
