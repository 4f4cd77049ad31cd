"""Batched mathematics for N worlds: rotations as quaternions, and simulators whose state is tensors.

It registers nothing; ``understudy_tensors.rotations`` and ``.simulator`` are for other plugins.
"""

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()
