"""The binary survival reward (thesis, section 3.5)."""

from torch import Tensor


def survival(failed: Tensor) -> Tensor:
    """1 in worlds within all bounds, 0 where one is violated (and the episode ends)."""
    return (~failed).float()


def within_all_bounds(violated: Tensor) -> Tensor:
    """1 while no termination term holds, whether it ends the episode or is only reported, else 0."""
    return (~violated).float()
