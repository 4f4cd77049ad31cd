"""How the gripper takes an object: the lower stick's orientation, of 2 000 (thesis, section 5.6.1).

The thesis learns two networks: which orientations grasp a shape well, and which the arm reaches; and says itself
that inverse kinematics could replace the second. Here both are computed: the quality that the first network's
data are made of, and closed-form kinematics of the arm. The score is quality × reached × continuity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy_tensors import rotations
from understudy_tool_planner import arm
from understudy_tool_planner.clearance import of_rods
from understudy_tool_planner.gripper import ROOM, Jaws, normal, width
from understudy_tool_planner.objects import Shape, Things, upright

__all__ = ["NoPlan"]

#: Elevations of the sticks (rad), azimuths and turns about their axis: 10 × 20 × 10, in the object's frame.
ELEVATION, COUNTS = (0.45, 1.5), (10, 20, 10)
#: 1/rad: what a tip line beside the surface's normal costs; and a turn away from the present one (ξ).
_ALIGNED, _CONTINUOUS = 5.0, 5.0
#: So many of the best scores go on to the arm (n_c; the thesis has 10, the release 50).
BEST = 64
#: Swivels of the arm that are tried, rad; and how far a hinge stays from its ends.
SWIVELS = torch.linspace(-2.0, 2.0, 24, dtype=torch.float64)
INSIDE = 0.03


@dataclass(frozen=True)
class Holder:
    """A hand that holds a gripper: where it is in its palm, and what the hand must keep off the table."""

    jaws: Jaws
    least: float  #: rad, by which the gripper is closed when it is open
    most: float  #: rad, by which it closes at most
    place: Tensor  #: (3,) m, of the lower part in the palm's frame
    turn: Tensor  #: (3, 3)
    points: Tensor  #: (P, 3) m, of the hand's shapes, in the palm's frame
    radii: Tensor  #: (P,) m

    def palm(self, place: Tensor, matrix: Tensor) -> tuple[Tensor, Tensor]:
        """(…, 3) m and (…, 3, 3): the palm that holds a lower stick at `place`, turned by `matrix`."""
        turn = matrix @ self.turn.T
        return place - torch.einsum("...ij,j->...i", turn, self.place), turn

    def clearance(self, palm: Tensor, turn: Tensor) -> Tensor:
        """(…) m: of the hand from the table."""
        heights = palm[..., None, 2] + turn[..., 2, :] @ self.points.T
        return (heights - self.radii).amin(-1)


@dataclass(frozen=True)
class Configurations:
    """C ways to take an object and to put it down, the best first."""

    turn: Tensor  #: (C, 4) of the lower stick when it takes
    end: Tensor  #: (C, 4) … when it puts down
    closed: Tensor  #: (C,) rad
    open: Tensor  #: (C,) rad, before it takes
    score: Tensor  #: (C,)


class NoPlan(ConfigError):
    """A goal that no plan reaches: which phase, and by how much."""


def orientations() -> Tensor:
    """(2000, 4): the lower stick's, x from the tip to its end; at a turn of 0 the tips are level."""
    low, high = ELEVATION
    up, around, about = COUNTS
    elevation = torch.linspace(low, high, up, dtype=torch.float64)
    azimuth = torch.arange(around, dtype=torch.float64) * (2.0 * math.pi / around)
    roll = torch.arange(about, dtype=torch.float64) * (2.0 * math.pi / about)
    e, a, r = (g.flatten() for g in torch.meshgrid(elevation, azimuth, roll, indexing="ij"))
    axes = torch.eye(3, dtype=torch.float64)
    tilted = rotations.multiply(rotations.from_heading(a), rotations.from_axis_angle(-axes[1], e))
    return rotations.multiply(tilted, rotations.from_axis_angle(axes[0], r))


_ORIENTATIONS = orientations()


def choose(
    shape: Shape,
    start: Tensor,
    heading: Tensor,
    goal: Tensor,
    goal_heading: Tensor,
    now: Tensor,
    others: Things,
    holder: Holder,
) -> Configurations:
    """The ways to take `shape` at `start` and put it down at `goal`.

    Parameters
    ----------
    start, goal
        (3,) m, of its middle.
    heading, goal_heading
        () rad.
    now
        (4,) the lower stick's present rotation, for continuity.
    others
        what is not moved.

    Raises
    ------
    NoPlan
        there is none; the sentence says in which phase, and by how many millimetres.
    """
    local = _ORIENTATIONS
    matrix = rotations.to_matrix(local)
    jaws = holder.jaws
    least = torch.full((len(local),), holder.least, dtype=torch.float64)
    closed, _, _ = _around(holder, shape, matrix, least)
    closed, wide, ways = _around(holder, shape, matrix, closed)
    off = torch.acos(normal(shape, ways).clamp(-1.0, 1.0))
    wide_as = width(shape, ways)
    narrow = jaws.room(holder.least) - ROOM - wide_as
    thin = wide_as - jaws.room(holder.most)
    first = rotations.multiply(rotations.from_heading(heading), local)
    far = rotations.angle_between(first, now)
    score = torch.exp(-_ALIGNED * off - _CONTINUOUS * far)
    _some(narrow, "taking", "the object is wider than the gripper opens")
    _some(thin, "taking", "the object is thinner than the gripper closes")
    # Open and closed as it takes; closed as it puts down, open with its lower part still there, and gone aside.
    heads = (heading, heading, goal_heading, goal_heading, goal_heading)
    middles = (start, start, goal, goal, goal)
    there, angles = (wide, closed, closed, closed, least), (wide, closed, closed, least, least)
    table = []
    for h, m, at, a in zip(heads, middles, there, angles, strict=True):
        turned = upright(h) @ matrix
        table.append(jaws.rods(jaws.placed(turned, at, m), turned, a).low.amin(-1))
    low = torch.stack(table).amin(0)
    fits = (narrow >= 0) & (thin >= 0)
    _some(torch.where(fits, low, -1.0), "taking", "the gripper is in the table")
    score = torch.where(fits & (low >= 0), score, -1.0)
    kept = score.topk(min(BEST, int((score > 0).sum()))).indices
    # Of those, what the arm reaches and nothing is in the way of.
    turns = torch.stack([upright(h) @ matrix[kept] for h in heads], 1)  # (C, 5, 3, 3)
    at, angle = (torch.stack([a[kept] for a in each], 1) for each in (there, angles))
    place = jaws.placed(turns, at, torch.stack(middles).expand(len(kept), -1, 3))
    palm, hand = holder.palm(place, turns)
    solved = arm.solve(palm[..., None, :], hand[..., None, :, :], SWIVELS)
    inside = solved.inside.amax(-1).amin(1)
    beyond = (
        (palm - arm.PALM * hand[..., 2] - palm.new_tensor(arm.SHOULDER)).square().sum(-1).sqrt()
    )
    reach = 2.0 * arm.HALF - beyond.amax(1)
    _some(reach, "reaching", "the arm is too short")
    if not (inside >= INSIDE).any():
        raise NoPlan(
            "No plan reaches the goal: in the phase 'reaching' the arm's hinges are at their ends, by "
            f"{max(0.0, INSIDE - float(inside.max())):.2f} rad. Choose a goal nearer to the middle of the table."
        )
    ok = inside >= INSIDE
    above = holder.clearance(palm, hand).amin(1)
    _some(torch.where(ok, above, -1.0), "reaching", "the hand is in the table")
    ok &= above >= 0
    if len(others.places):
        _, away = of_rods(jaws.rods(place, turns, angle), others, 8)
        free = away.flatten(2).amin(-1)
        for rows, phase in ((slice(0, 2), "taking"), (slice(2, 5), "releasing")):
            clear = free[:, rows].amin(1)
            _some(torch.where(ok, clear, -1.0), phase, "other objects are in the gripper's way")
            ok &= clear >= 0
    rows = kept[ok]
    ends = rotations.multiply(rotations.from_heading(goal_heading), local[rows])
    return Configurations(first[rows], ends, closed[rows], wide[rows], score[rows])


def _around(
    holder: Holder, shape: Shape, matrix: Tensor, closed: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """(n,) rad, closed around `shape` and open beside it, along the tip lines (n, 3) that `closed` (n,) has."""
    _, across = holder.jaws.tips(closed)
    ways = torch.einsum("nij,nj->ni", matrix, across)
    ways = ways / ways.square().sum(-1, keepdim=True).sqrt()
    return *holder.jaws.angles_for(width(shape, ways), holder.least), ways


def _some(values: Tensor, phase: str, why: str) -> None:
    """Refuse where none of `values` (m) is at least 0."""
    most = float(values.max()) if len(values) else -1.0
    if not most >= 0.0:
        raise NoPlan(
            f"No plan reaches the goal: in the phase '{phase}' {why}, by {-1e3 * most:.1f} mm at the best. "
            "Choose another goal, or move what is in the way."
        )
