"""Spacetime bounds m(t, sigma) around a reference m(t) (thesis, section 3.3.2, eq. 3.2).

Each term is true for the worlds that left its bound, and says how much of the way to it is used up
(``used``). Default sizes are those of section 3.5.1. A size is a number, or a function of phase given as knots ``[[phase, size], …]``, linear in between.
Where a curriculum provides ``bound_scales`` (:mod:`understudy_spacetime.adaptive`), sizes are times these.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.errors import ConfigError, suggestion
from understudy.task import Context
from understudy_characters.scene import CharacterScene
from understudy_tensors.knots import Knots
from understudy_tensors.limits import ANGLE, in_degrees
from understudy_tensors.rotations import angle_between

Size = float | list[list[float]]

#: A bound of size 0 lets nothing be told apart; this share of a unit does.
_LEAST = 1e-3
#: And nothing is ever beyond this, in m or rad.
_MOST = 1e3


class BoundSize:
    """The size sigma of a bound, a function of phase.

    Raises
    ------
    ConfigError
        it is negative, or no knots with phases in [0, 1], or of an `angle` more than a whole turn; names the term `who`.
    """

    def __init__(
        self,
        size: Size,
        who: str,
        device: torch.device,
        dtype: torch.dtype = torch.float32,
        *,
        angle: bool = False,
    ) -> None:
        knots = [[0.0, size]] if isinstance(size, (int, float)) else size
        if not knots or any(len(knot) != 2 for knot in knots):
            raise ConfigError(
                f"{who}: size={size} is not possible: a number or [[phase, size], …]."
            )
        if not all(0.0 <= value <= _MOST for _, value in knots):
            raise ConfigError(
                f"{who}: size={size} is not possible: sizes are 0 or more, and at most {_MOST:g}."
            )
        if angle and (most := max(value for _, value in knots)) > ANGLE[1]:
            raise ConfigError(f"{who}: size={size} is not possible: {in_degrees(most)}")
        if any(not 0.0 <= phase <= 1.0 for phase, _ in knots):
            raise ConfigError(f"{who}: size={size} is not possible: phases go from 0 to 1.")
        self._knots = Knots(sorted((phase, value) for phase, value in knots), device, dtype)

    def at(self, phase: Tensor, scales: Tensor | None = None) -> Tensor:
        """The knots interpolated at `phase` (N,): (N,), or () if the size is the same always.

        `scales` (N, n) are factors by segment of the motion, if the bounds' sizes adapt.
        """
        if scales is not None:
            segment = (phase * scales.shape[1]).long().clamp(0, scales.shape[1] - 1)
            return self.at(phase) * scales.gather(1, segment.unsqueeze(1)).squeeze(1)
        return self._knots.at(phase)

    def left(self, distances: Tensor, phase: Tensor, scales: Tensor | None) -> Tensor:
        """(N,) bool: whether any of the `distances` (N, K) is further than the size at `phase` (N,)."""
        return distances.amax(dim=1) > self.at(phase, scales)

    def share(self, distances: Tensor, phase: Tensor, scales: Tensor | None) -> Tensor:
        """(N, K): the `distances` (N, K) as shares of the size at `phase` (N,)."""
        return distances / self.at(phase, scales).clamp(min=_LEAST).view(-1, 1)


class ComBound:
    """Centre of mass further than `size` m from the reference along x, y or z of the world."""

    @dataclass(frozen=True)
    class Options:
        size: Size = 0.2  #: greatest distance, m, from 0, or [[phase, m], …] (section 3.5.1)

    def __init__(self, options: Options, context: Context) -> None:
        self._size = BoundSize(options.size, "spacetime/com_bound", context.device)

    def __call__(
        self,
        com_position: Tensor,
        reference_com_position: Tensor,
        phase: Tensor,
        bound_scales: Tensor | None = None,
    ) -> Tensor:
        distances = self._distances(com_position, reference_com_position)
        return self._size.left(distances, phase, bound_scales)

    def used(self, phase: Tensor, bound_scales: Tensor | None = None, **fields: Tensor) -> Tensor:
        return self._size.share(self._distances(**fields), phase, bound_scales)

    def _distances(self, com_position: Tensor, reference_com_position: Tensor) -> Tensor:
        """(N, 3) m"""
        return (com_position - reference_com_position).abs()


class RootBound:
    """Root rotated more than `size` rad away from the reference, in the world frame."""

    @dataclass(frozen=True)
    class Options:
        size: Size = 0.7  #: greatest angle, rad, from 0, or [[phase, rad], …] (section 3.5.1)

    def __init__(self, options: Options, context: Context) -> None:
        self._size = BoundSize(options.size, "spacetime/root_bound", context.device, angle=True)

    def __call__(
        self,
        root_rotation: Tensor,
        reference_root_rotation: Tensor,
        phase: Tensor,
        bound_scales: Tensor | None = None,
    ) -> Tensor:
        distances = self._distances(root_rotation, reference_root_rotation)
        return self._size.left(distances, phase, bound_scales)

    def used(self, phase: Tensor, bound_scales: Tensor | None = None, **fields: Tensor) -> Tensor:
        return self._size.share(self._distances(**fields), phase, bound_scales)

    def _distances(self, root_rotation: Tensor, reference_root_rotation: Tensor) -> Tensor:
        """(N, 1) rad"""
        return angle_between(root_rotation, reference_root_rotation).unsqueeze(1)


class JointBound:
    """Any bounded joint rotated more than `size` rad from the reference, in its local frame."""

    @dataclass(frozen=True)
    class Options:
        size: Size = 0.7  #: greatest angle, rad, from 0, or [[phase, rad], …] (section 3.5.1)
        joints: tuple[str, ...] = ()  #: bounded joints; empty bounds all

    def __init__(self, options: Options, context: Context) -> None:
        who = "spacetime/joint_bound"
        names = context.need_scene(CharacterScene, who).layout.joint_names
        for name in options.joints:
            if name not in names:
                raise ConfigError(
                    f"{who} needs '{name}': no joint '{name}'.{suggestion(name, names)}"
                )
        self._size = BoundSize(options.size, who, context.device, angle=True)
        chosen = [names.index(name) for name in options.joints or names]
        self._chosen = (
            None if len(chosen) == len(names) else torch.tensor(chosen, device=context.device)
        )

    def __call__(
        self,
        joint_rotations: Tensor,
        reference_joint_rotations: Tensor,
        phase: Tensor,
        bound_scales: Tensor | None = None,
    ) -> Tensor:
        distances = self._distances(joint_rotations, reference_joint_rotations)
        return self._size.left(distances, phase, bound_scales)

    def used(self, phase: Tensor, bound_scales: Tensor | None = None, **fields: Tensor) -> Tensor:
        return self._size.share(self._distances(**fields), phase, bound_scales)

    def _distances(self, joint_rotations: Tensor, reference_joint_rotations: Tensor) -> Tensor:
        """(N, J) rad"""
        if self._chosen is None:
            return angle_between(joint_rotations, reference_joint_rotations)
        own, reference = (r[:, self._chosen] for r in (joint_rotations, reference_joint_rotations))
        return angle_between(own, reference)


class EndEffectorBound:
    """Any end-effector further than `size` m from the reference, relative to the roots, in the
    direction-invariant frame of :mod:`understudy_spacetime.alignment`."""

    @dataclass(frozen=True)
    class Options:
        size: Size = 0.5  #: greatest distance, m, from 0, or [[phase, m], …] (section 3.5.1)

    def __init__(self, options: Options, context: Context) -> None:
        self._size = BoundSize(options.size, "spacetime/end_effector_bound", context.device)

    def __call__(
        self,
        aligned_end_effector_positions: Tensor,
        reference_end_effector_positions: Tensor,
        phase: Tensor,
        bound_scales: Tensor | None = None,
    ) -> Tensor:
        distances = self._distances(
            aligned_end_effector_positions, reference_end_effector_positions
        )
        return self._size.left(distances, phase, bound_scales)

    def used(self, phase: Tensor, bound_scales: Tensor | None = None, **fields: Tensor) -> Tensor:
        return self._size.share(self._distances(**fields), phase, bound_scales)

    def _distances(
        self, aligned_end_effector_positions: Tensor, reference_end_effector_positions: Tensor
    ) -> Tensor:
        """(N, E) m"""
        return (aligned_end_effector_positions - reference_end_effector_positions).norm(dim=2)
