"""Spacetime bounds m(t, sigma) around a reference m(t) (thesis, section 3.3.2, eq. 3.2).

Each term is true for the worlds that left its bound. Default sizes are those of section 3.5.1. A
size is a number, or a function of phase given as knots ``[[phase, size], …]``, linear in between.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field

import torch
from torch import Tensor

from understudy.errors import ConfigError, suggestion
from understudy.rotations import angle_between
from understudy.task import Context
from understudy_humanoid.scene import HumanoidScene

Size = float | list[list[float]]


def size_at(size: Size, phase: Tensor) -> Tensor | float:
    """The bound's size sigma at `phase` (N,): the number itself, or its knots interpolated, (N,)."""
    if isinstance(size, (int, float)):
        if size < 0:
            raise ConfigError(f"A bound's size is {size}; it cannot be negative.")
        return size
    if not size or any(len(knot) != 2 for knot in size):
        raise ConfigError(f"A bound's size is a number or knots [[phase, size], …], not {size}.")
    knots = _knots(tuple(sorted((at, value) for at, value in size)), phase.dtype, phase.device)
    at, value = knots[:, 0].contiguous(), knots[:, 1]
    if len(at) == 1:
        return value.expand_as(phase)
    right = torch.searchsorted(at, phase.contiguous()).clamp(1, len(at) - 1)
    left = right - 1
    share = ((phase - at[left]) / (at[right] - at[left]).clamp(min=1e-9)).clamp(0.0, 1.0)
    return value[left] + share * (value[right] - value[left])


@functools.cache
def _knots(
    knots: tuple[tuple[float, float], ...], dtype: torch.dtype, device: torch.device
) -> Tensor:
    """(K, 2), made once: a copy to the device in every step would wait for it."""
    return torch.tensor(knots, dtype=dtype, device=device)


def com_bound(
    com_position: Tensor, reference_com_position: Tensor, phase: Tensor, *, size: Size = 0.2
) -> Tensor:
    """Centre of mass further than `size` m from the reference along x, y or z of the world."""
    distance = (com_position - reference_com_position).abs().amax(dim=1)
    return distance > size_at(size, phase)


def root_bound(
    root_rotation: Tensor, reference_root_rotation: Tensor, phase: Tensor, *, size: Size = 0.7
) -> Tensor:
    """Root rotated more than `size` rad away from the reference, in the world frame."""
    return angle_between(root_rotation, reference_root_rotation) > size_at(size, phase)


class JointBound:
    """Any bounded joint rotated more than `size` rad from the reference, in its local frame."""

    @dataclass(frozen=True)
    class Options:
        size: Size = 0.7
        joints: tuple[str, ...] = field(default=())  #: bounded joints; empty bounds all

    def __init__(self, options: Options, context: Context) -> None:
        names = context.need_scene(HumanoidScene, "spacetime.joint_bound").layout.joint_names
        for name in options.joints:
            if name not in names:
                raise ConfigError(
                    f"spacetime.joint_bound: no joint '{name}'.{suggestion(name, names)}"
                )
        chosen = [names.index(name) for name in options.joints or names]
        self._size = options.size
        self._chosen = (
            None if len(chosen) == len(names) else torch.tensor(chosen, device=context.device)
        )

    def __call__(
        self, joint_rotations: Tensor, reference_joint_rotations: Tensor, phase: Tensor
    ) -> Tensor:
        if self._chosen is not None:
            joint_rotations = joint_rotations[:, self._chosen]
            reference_joint_rotations = reference_joint_rotations[:, self._chosen]
        angles = angle_between(joint_rotations, reference_joint_rotations)
        return angles.amax(dim=1) > size_at(self._size, phase)


def end_effector_bound(
    aligned_end_effector_positions: Tensor,
    reference_end_effector_positions: Tensor,
    phase: Tensor,
    *,
    size: Size = 0.5,
) -> Tensor:
    """Any end-effector further than `size` m from the reference, relative to the roots, in the
    direction-invariant frame of :mod:`understudy_spacetime.alignment`."""
    offset = aligned_end_effector_positions - reference_end_effector_positions
    return offset.norm(dim=2).amax(dim=1) > size_at(size, phase)
