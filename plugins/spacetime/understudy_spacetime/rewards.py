"""The binary survival reward (thesis, section 3.5)."""

from torch import Tensor


def survival(failed: Tensor) -> Tensor:
    """1 in worlds within all bounds, 0 where one is violated (and the episode ends)."""
    return (~failed).float()
