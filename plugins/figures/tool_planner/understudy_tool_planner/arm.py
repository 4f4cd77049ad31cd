"""Inverse kinematics of the arm, in closed form: seven hinges, so one turn, the swivel, is free.

The elbow follows from how far the wrist is from the shoulder. The swivel turns the elbow about the line between
them; for each the shoulder's and the wrist's three angles are those of two rotations (Tolani and Badler 1996, whom
the thesis follows in section 5.6). m, rad.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy_hand.table import ARM

__all__ = ["Solved", "forward", "solve", "swivel_of"]

#: m: the shoulder in the world; of each half of the arm; from the wrist to the palm.
SHOULDER, HALF, PALM = (0.0, -0.45, 0.4), 0.3, 0.034
#: The base's turn: -90° about x.
_BASE = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0))
#: (7, 2) rad.
RANGES = tuple(hinge.range for link in ARM for hinge in link.hinges)


@dataclass(frozen=True)
class Solved:
    """Arms, one for each swivel that was asked for."""

    pose: Tensor  #: (…, 7) rad
    #: (…) rad from the end of the nearest hinge's range; below 0 beyond it, and minus infinity out of reach.
    inside: Tensor


def forward(pose: Tensor) -> tuple[Tensor, Tensor]:
    """Where the palm is at the angles `pose` (…, 7): (…, 3) m, and (…, 3, 3)."""
    a, b, c, elbow, d, e, f = pose.unbind(-1)
    base = pose.new_tensor(_BASE)
    upper = base @ _about(a, 0) @ _about(b, 2) @ _about(-c, 1)
    fore = upper @ _about(elbow, 0)
    hand = fore @ _about(d, 0) @ _about(e, 1) @ _about(f, 2)
    wrist = pose.new_tensor(SHOULDER) + HALF * upper[..., 1] + HALF * fore[..., 2]
    return wrist + PALM * hand[..., 2], hand


def swivel_of(pose: Tensor) -> Tensor:
    """(…) rad, of the arm `pose` (…, 7)."""
    base = pose.new_tensor(_BASE)
    a, b, c = pose[..., 0], pose[..., 1], pose[..., 2]
    upper = base @ _about(a, 0) @ _about(b, 2) @ _about(-c, 1)
    fore = upper @ _about(pose[..., 3], 0)
    elbow = HALF * upper[..., 1]
    out = elbow + HALF * fore[..., 2]
    _, side, up = _frame(out)
    return torch.atan2((elbow * side).sum(-1), (elbow * up).sum(-1))


def solve(palm: Tensor, turn: Tensor, swivel: Tensor) -> Solved:
    """Arms whose palms are at `palm` (…, 3) m, turned by `turn` (…, 3, 3).

    *Limits:* this arm's sizes alone, straight or bent one way. The hinges' ranges are not
    kept; the result says by how much they are.

    Parameters
    ----------
    swivel
        (…) rad, of the elbow about the line from shoulder to wrist; 0 has it hang straight down.
    """
    wrist = palm - PALM * turn[..., 2]
    out = wrist - palm.new_tensor(SHOULDER)
    square = out.square().sum(-1)
    # |upper + fore|² = 2 HALF² (1 - sin elbow)
    sine = 1.0 - square / (2.0 * HALF * HALF)
    reached = (sine > -1.0) & (sine < 1.0)
    elbow = torch.asin(sine.clamp(-1.0 + 1e-9, 1.0 - 1e-9))
    away, side, up = _frame(out)
    distance = square.sqrt()
    # The elbow is half way out, and this far beside the line.
    beside = (HALF * HALF - 0.25 * square).clamp(min=0.0).sqrt()
    bend = swivel.cos()[..., None] * up + swivel.sin()[..., None] * side
    first = (0.5 * distance[..., None] * away + beside[..., None] * bend) / HALF  # upper arm's y
    second = (0.5 * distance[..., None] * away - beside[..., None] * bend) / HALF  # forearm's z
    # Both halves are in the plane of y and z of the upper arm; the hinge of the elbow is its x.
    across = torch.linalg.cross(first, second, dim=-1)
    x = across / across.square().sum(-1, keepdim=True).clamp(min=1e-18).sqrt()
    # at an elbow of 0 the forearm is along the upper arm's z: x = y × z
    upper = torch.stack([x, first, torch.linalg.cross(x, first, dim=-1)], dim=-1)
    base = palm.new_tensor(_BASE)
    a, b, c = _xzy(base.T @ upper)
    fore = upper @ _about(elbow, 0)
    d, e, f = _xyz(fore.transpose(-1, -2) @ turn)
    # the last hinge's range is from -π to 0
    f = torch.where(f > 0.5 * math.pi, f - 2.0 * math.pi, f)
    pose = torch.stack([a, b, -c, elbow.expand_as(a), d, e, f], dim=-1)
    low, high = palm.new_tensor(RANGES).T
    inside = torch.minimum(pose - low, high - pose).amin(-1)
    return Solved(pose, torch.where(reached, inside, -torch.inf))


def _frame(out: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Unit vectors: along `out` (…, 3); level and across it; and across both, downwards."""
    away = out / out.square().sum(-1, keepdim=True).sqrt()
    down = out.new_tensor((0.0, 0.0, -1.0)).expand_as(out)
    up = down - (down * away).sum(-1, keepdim=True) * away
    up = up / up.square().sum(-1, keepdim=True).clamp(min=1e-18).sqrt()
    return away, torch.linalg.cross(up, away, dim=-1), up


def _about(angle: Tensor, axis: int) -> Tensor:
    """(…, 3, 3): a turn by `angle` (…) about a coordinate axis."""
    sine, cosine = angle.sin(), angle.cos()
    matrix = torch.zeros(*angle.shape, 3, 3, dtype=angle.dtype)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    matrix[..., axis, axis] = 1.0
    matrix[..., j, j] = matrix[..., k, k] = cosine
    matrix[..., j, k], matrix[..., k, j] = -sine, sine
    return matrix


def _xyz(m: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Angles of the turns Rx Ry Rz that `m` (…, 3, 3) is."""
    return (
        torch.atan2(-m[..., 1, 2], m[..., 2, 2]),
        torch.asin(m[..., 0, 2].clamp(-1.0, 1.0)),
        torch.atan2(-m[..., 0, 1], m[..., 0, 0]),
    )


def _xzy(m: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Angles of the turns Rx Rz Ry that `m` (…, 3, 3) is."""
    return (
        torch.atan2(m[..., 2, 1], m[..., 1, 1]),
        torch.asin((-m[..., 0, 1]).clamp(-1.0, 1.0)),
        torch.atan2(m[..., 0, 2], m[..., 0, 0]),
    )
