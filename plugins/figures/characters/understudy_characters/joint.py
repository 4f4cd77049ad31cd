"""A joint of a figure: a ball, or up to three hinges, and the angles at which these turn as asked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from understudy.errors import ConfigError
from understudy_tensors import rotations

__all__ = ["Joint"]


@dataclass(frozen=True)
class Joint:
    """One joint of the figure: a body and the hinges, or the ball, between it and its parent."""

    name: str
    body: int  #: id in the model
    parent: int  #: row of the parent joint, -1 for the root
    addresses: tuple[int, ...]  #: first ``qpos`` address of each of its MuJoCo joints
    #: (K, 3) of its hinges, in the body's frame; empty for a ball and for the root
    axes: np.ndarray
    ranges: np.ndarray  #: (K, 2) rad of its hinges, infinite where unlimited
    apart: np.ndarray  #: (K, 3) m, from its first hinge to each, in the body's frame

    def angles(self, turned: Tensor) -> Tensor:
        """(F, K) rad: the angles at which its hinges turn by `turned` (F, 4), in the body's frame, or come
        closest to it.

        Of equivalent angles, those within the hinges' ranges; without ranges, those closest to the frame
        before.

        Raises
        ------
        ConfigError
            there are three hinges, and two in a row are not at right angles.
        """
        axes = torch.from_numpy(self.axes)
        if len(axes) == 1:
            angles = rotations.twist_angle(turned, axes[0])[:, None].numpy()
        elif len(axes) == 2:
            angles = _two_angles(turned, axes[0], axes[1])
        else:
            angles = self._three_angles(turned)
        unlimited = ~np.isfinite(self.ranges[:, 0])
        angles[:, unlimited] = np.unwrap(angles[:, unlimited], axis=0)
        return torch.from_numpy(self._near_ranges(angles))

    def _three_angles(self, turned: Tensor) -> np.ndarray:
        first, second, third = self.axes
        if abs(first @ second) > 1e-6 or abs(second @ third) > 1e-6:
            raise ConfigError(
                f"The hinges of body '{self.name}' are not at right angles to one another; a clip "
                "cannot be mapped on them."
            )
        turn = Rotation.from_quat(turned.numpy(), scalar_first=True)
        angles = turn.as_davenport(self.axes, "intrinsic")
        # Half a turn about the first and the third axis is half a turn about the second, mirrored.
        between = np.arctan2(np.cross(first, third) @ second, first @ third)
        other = np.stack(
            (angles[:, 0] + np.pi, -angles[:, 1] - 2.0 * between, angles[:, 2] + np.pi), axis=1
        )
        better = self._excess(other) < self._excess(angles) - 1e-9
        return np.where(better[:, None], other, angles)

    def _near_ranges(self, angles: np.ndarray) -> np.ndarray:
        """The angles with whole turns added, so that each is as near as possible to the middle of its range."""
        limited = np.isfinite(self.ranges[:, 0])
        middle = np.where(limited[:, None], self.ranges, 0.0).mean(axis=1)
        turns = np.round((angles - middle) / (2.0 * np.pi))
        return np.where(limited, angles - 2.0 * np.pi * turns, angles)

    def _excess(self, angles: np.ndarray) -> np.ndarray:
        """(F,) rad: the sum of how far the angles are outside their ranges."""
        near = self._near_ranges(angles)
        beyond = np.maximum(self.ranges[:, 0] - near, near - self.ranges[:, 1])
        return np.clip(beyond, 0.0, None).sum(axis=1)


def _two_angles(turned: Tensor, first: Tensor, second: Tensor) -> np.ndarray:
    """(F, 2) rad: of two hinges, from where `turned` takes the second axis; exact if they can turn so."""
    moved = rotations.rotate(turned, second)
    level = moved - (moved @ first)[:, None] * first
    across = torch.linalg.cross(first, second)
    angle = torch.atan2(level @ across, level @ second - (second @ first) * (level @ first))
    undone = rotations.multiply(rotations.from_axis_angle(first, -angle), turned)
    return torch.stack((angle, rotations.twist_angle(undone, second)), dim=1).numpy()
