"""The binary survival reward (thesis, section 3.5), and measures of how near a motion stays."""

from torch import Tensor

from understudy_tensors.rotations import angle_between


def survival(failed: Tensor) -> Tensor:
    """1 in worlds within all bounds, 0 where one is violated (and the episode ends)."""
    return (~failed).float()


def within_all_bounds(violated: Tensor) -> Tensor:
    """1 while no termination term holds, whether it ends the episode or is only reported, else 0."""
    return (~violated).float()


def com_deviation(com_position: Tensor, reference_com_position: Tensor) -> Tensor:
    """(N,) m between the centres of mass."""
    return (com_position - reference_com_position).norm(dim=1)


def joint_deviation(joint_rotations: Tensor, reference_joint_rotations: Tensor) -> Tensor:
    """(N,) rad by which the joint that is farthest from its reference is away from it."""
    return angle_between(joint_rotations, reference_joint_rotations).amax(dim=1)
