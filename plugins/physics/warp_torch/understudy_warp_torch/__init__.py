"""Warp's kernels among torch's operations: what simulators written in Warp build on.

It registers nothing; ``understudy_warp_torch.kernels`` and ``simulator`` are for other plugins.
"""

#: Plugins that this one builds on.
REQUIRES = ("tensors",)
