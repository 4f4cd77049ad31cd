"""Rotations of joints as targets of a character's servos, batched on any device.

The character's joints take rotations by name, as clips are mapped on it. Rotations that a joint's hinges
cannot make are brought to the nearest they can, or near to it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from understudy.errors import ConfigError, suggestion
from understudy_characters.character import Character
from understudy_characters.joint import Joint
from understudy_tensors import rotations


class _Group(NamedTuple):
    """The G joints of one kind."""

    rows: Tensor  #: (G,) rows of the joints
    axes: Tensor  #: (K, G, 3) of their hinges; K is 0 for balls
    middle: Tensor  #: (G, K) rad, of their hinges' ranges; 0 without


class ServoTargets:
    """Maps rotations of J joints, in the order of `names`, to the targets of a character's U servos:
    angles of hinges, exponential maps of balls.

    Raises
    ------
    ConfigError
        if a joint of the character is none of `names`; `source` says whose they are.
    """

    def __init__(
        self, character: Character, names: Sequence[str], source: str, device: torch.device
    ) -> None:
        joints, model = character.joints[1:], character.model
        for joint in joints:
            if joint.name not in names:
                raise ConfigError(
                    f"{source} makes poses without a joint '{joint.name}', which {character.name} needs."
                    f"{suggestion(joint.name, names)}"
                )
        self._order = torch.tensor([names.index(joint.name) for joint in joints], device=device)
        rests = character.rest_rotations.as_quat(scalar_first=True)[1:]
        self._rests = torch.from_numpy(rests).float().to(device)
        groups, place = [], {}
        column = 0
        for count in range(4):
            of = [row for row, joint in enumerate(joints) if len(joint.axes) == count]
            if not of:
                continue
            groups.append(_group([joints[row] for row in of], of, device))
            for row in of:
                for k in range(count or 3):
                    place[row, k] = column
                    column += 1
        self._groups = groups
        bodies = [joint.body for joint in joints]
        columns = []
        for servo in range(model.nu):
            driven = int(model.actuator_trnid[servo, 0])
            row = bodies.index(int(model.jnt_bodyid[driven]))
            hinge = len(joints[row].axes) > 0
            first = int(model.body_jntadr[joints[row].body])
            k = driven - first if hinge else int(abs(model.actuator_gear[servo, :3]).argmax())
            columns.append(place[row, k])
        self._columns = torch.tensor(columns, device=device)

    def __call__(self, local: Tensor) -> Tensor:
        """(N, U) rad, of the rotations `local` (N, J, 4) relative to the joints' parents."""
        local, rests = local[:, self._order], self._rests
        turned = rotations.multiply(rotations.multiply(rotations.conjugate(rests), local), rests)
        values = [_values(turned[:, group.rows], group) for group in self._groups]
        return torch.cat(values, dim=1)[:, self._columns]


def _group(joints: Sequence[Joint], rows: Sequence[int], device: torch.device) -> _Group:
    count = len(joints[0].axes)
    axes = torch.tensor([joint.axes.tolist() for joint in joints]).reshape(len(joints), count, 3)
    ranges = torch.tensor([joint.ranges.tolist() for joint in joints]).reshape(
        len(joints), count, 2
    )
    middle = ranges.mean(-1)
    return _Group(
        torch.tensor(rows, device=device),
        axes.transpose(0, 1).contiguous().to(device),
        torch.where(middle.isfinite(), middle, 0.0).to(device),
    )


def _values(turned: Tensor, group: _Group) -> Tensor:
    """(N, G max(K, 1) or 3 G), joint by joint, of rotations (N, G, 4) in the bodies' frames."""
    if len(group.axes) == 0:
        return rotations.to_exponential_map(turned).flatten(1)
    if len(group.axes) == 1:
        angles = rotations.twist_angle(turned, group.axes[0]).unsqueeze(-1)
    elif len(group.axes) == 2:
        angles = _two(turned, *group.axes)
    else:
        angles = _three(turned, group)
    return _near(angles, group.middle).flatten(1)


def _near(angles: Tensor, middle: Tensor) -> Tensor:
    """`angles` (N, G, K), whole turns added so that they are nearest to the middle of their ranges."""
    return angles - 2 * math.pi * torch.round((angles - middle) / (2 * math.pi))


def _two(turned: Tensor, first: Tensor, second: Tensor) -> Tensor:
    """(N, G, 2): of two hinges, from where the second axis gets to; exact where they can turn so."""
    along = (first * second).sum(-1)
    moved = rotations.rotate(turned, second)
    level = moved - (moved * first).sum(-1, keepdim=True) * first
    across = torch.linalg.cross(first, second)
    angle = torch.atan2(
        (level * across).sum(-1), (level * (second - along[:, None] * first)).sum(-1)
    )
    undone = rotations.multiply(rotations.from_axis_angle(first, -angle), turned)
    return torch.stack([angle, rotations.twist_angle(undone, second)], dim=-1)


def _three(turned: Tensor, group: _Group) -> Tensor:
    """(N, G, 3): of three hinges at right angles one to the next, of the two ways to turn so the one
    nearer to the middle of their ranges."""
    first, second, third = group.axes
    moved = rotations.rotate(turned, third)  # by the first two hinges alone
    across = torch.linalg.cross(first, second)
    angle = torch.atan2(-(moved * second).sum(-1), (moved * across).sum(-1))
    ways = []
    for a in (angle, angle + math.pi):
        undone = rotations.multiply(rotations.from_axis_angle(first, -a), turned)
        level = rotations.rotate(undone, third)  # at a right angle to the second axis
        b = torch.atan2(
            (torch.linalg.cross(third.expand_as(level), level) * second).sum(-1),
            (level * third).sum(-1),
        )
        undone = rotations.multiply(rotations.from_axis_angle(second, -b), undone)
        c = rotations.twist_angle(undone, third)
        ways.append(_near(torch.stack([a, b, c], dim=-1), group.middle))
    far = [(way - group.middle).abs().sum(-1, keepdim=True) for way in ways]
    return torch.where(far[0] <= far[1], *ways)
