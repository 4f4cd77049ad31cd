"""Warp's kernels among torch's operations: what simulators written in Warp build on.

It registers nothing; ``understudy_warp_torch.kernels`` is for other plugins.
"""

#: Plugins that this one builds on.
REQUIRES: tuple[str, ...] = ()
