"""The way of the gripper through free space (thesis, equation 5.8), batched over ways and starts.

Positions are a cubic Bézier curve, of whose four control points the inner two are free; orientations are
interpolated spherically, the angle between the sticks linearly. What is minimised is the length and a clamped
log barrier on clearance. B ways, n frames, K things; m, rad.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy_gripping.descent import minimise
from understudy_gripping.distances import clamped_log
from understudy_tensors import rotations
from understudy_tool_planner import gripper
from understudy_tool_planner.clearance import of_sticks, to_points
from understudy_tool_planner.objects import Things

#: m: z0 of eq. 5.8, and what is added to it, so that frames between those looked at are clear too.
BARRIER, MARGIN = 1e-3, 5e-4
#: Of the barrier, and of the depth of what is carried in the table, beside the length in m.
_CLEAR, _SUNK = 300.0, 200.0
#: Frames that are looked at; rounds of the search for nearest points there.
_FRAMES, _ROUNDS = 32, 3
_ITERATIONS = 24
#: m: how high the inner control points are lifted at first.
_LIFT = 0.03


@dataclass(frozen=True)
class Pose:
    """A gripper."""

    place: Tensor  #: (3,) m of the lower stick
    turn: Tensor  #: (4,) its rotation
    angle: Tensor  #: () rad, between the sticks


@dataclass(frozen=True)
class Way:
    """From one pose to another among things, with or without an object between the tips."""

    start: Pose
    end: Pose
    things: Things
    #: m: of the sphere around what is carried; None carries nothing.
    carried: float | None = None


@dataclass(frozen=True)
class Frames:
    """Grippers over time."""

    place: Tensor  #: (…, n, 3)
    turn: Tensor  #: (…, n, 4)
    angle: Tensor  #: (…, n)


def along(way: Way, inner: Tensor, shares: Tensor) -> Frames:
    """The gripper at `shares` (n,) of the way in [0, 1], by the inner control points `inner` (2, 3)."""
    points = torch.cat([way.start.place[None], inner, way.end.place[None]])
    angle = way.start.angle + shares * (way.end.angle - way.start.angle)
    count = (len(shares), 4)
    turn = rotations.slerp(way.start.turn.expand(count), way.end.turn.expand(count), shares)
    return Frames(_weights(shares) @ points, turn, angle)


def clearance(frames: Frames, things: Things | None, carried: float | None = None, rounds: int = 24) -> Tensor:
    """(…, n) m: of the sticks, and of what is carried, from the table and from `things`."""
    matrix = rotations.to_matrix(frames.turn)
    middles = gripper.middles(frames.place, matrix, frames.angle)
    table, others = of_sticks(middles, gripper.axes(matrix, frames.angle), things, rounds)
    least = [table.amin(-1), others.flatten(-2).amin(-1)] if others.numel() else [table.amin(-1)]
    if carried is not None and things is not None and len(things.places):
        held = _tips(frames.place, matrix, frames.angle)
        least.append((to_points(held[..., None, :], things) - carried).amin(-1))
    return torch.stack(least).amin(0)


def find(ways: Sequence[Way], starts: int = 2, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Inner control points (B, starts, 2, 3) of all `ways`, and the values (B, starts) of eq. 5.8 there.

    Ways with fewer things than others are filled with one far away.
    """
    shares = torch.linspace(0.0, 1.0, _FRAMES, dtype=torch.float64)
    inner = torch.stack([_first(way) for way in ways])  # (B, 2, 3)
    spread = torch.Generator().manual_seed(seed)
    other = 0.04 * torch.randn(len(ways), starts - 1, 2, 3, generator=spread, dtype=inner.dtype)
    other[..., 2] = other[..., 2].abs()
    begin = torch.cat([inner[:, None], inner[:, None] + other], dim=1).flatten(0, 1)  # (B s, 2, 3)
    cost = _Cost([way for way in ways for _ in range(starts)], shares)
    count = len(begin)
    flat = begin.reshape(count, 6)
    bound = torch.full((6,), 2.0, dtype=flat.dtype)
    found = minimise(cost, flat, -bound, bound, _ITERATIONS, memory=8, tolerance=1e-4)
    return found.points.view(len(ways), starts, 2, 3), found.values.view(len(ways), starts)


def _first(way: Way) -> Tensor:
    """(2, 3): a third of the way each, lifted."""
    start, end = way.start.place, way.end.place
    lift = start.new_tensor((0.0, 0.0, _LIFT))
    return torch.stack([start + (end - start) / 3.0 + lift, start + 2.0 * (end - start) / 3.0 + lift])


class _Cost:
    """Eq. 5.8 of many ways, (B, 6) to (B,)."""

    def __init__(self, ways: Sequence[Way], shares: Tensor) -> None:
        self._weights = _weights(shares)
        frames = [along(way, _first(way), shares) for way in ways]
        matrix = rotations.to_matrix(torch.stack([f.turn for f in frames]))
        angle = torch.stack([f.angle for f in frames])
        still = torch.zeros(len(ways), len(shares), 3, dtype=angle.dtype)
        #: (B, n, 2, 3) of the sticks from the lower one's middle; along them; (B, n, 3) of the tips.
        self._offsets = gripper.middles(still, matrix, angle)
        self._axes = gripper.axes(matrix, angle)
        self._tips = _tips(still, matrix, angle)
        self._ends = torch.stack([torch.stack([w.start.place, w.end.place]) for w in ways])
        self._things = _filled([way.things for way in ways])
        carried = [way.carried for way in ways]
        self._carries = torch.tensor([c is not None for c in carried])
        self._carried = torch.tensor([c or 0.0 for c in carried], dtype=angle.dtype)
        tips = self._tips[:, [0, -1], 2] + self._ends[..., 2]
        self._rest = tips.amin(1)  # the lower end of what is carried
        self._dt = 1.0 / len(shares)

    def __call__(self, point: Tensor) -> Tensor:
        inner = point.view(-1, 2, 3)
        points = torch.cat([self._ends[:, :1], inner, self._ends[:, 1:]], dim=1)
        place = torch.einsum("nc,bci->bni", self._weights, points)
        length = ((place[:, 1:] - place[:, :-1]).square().sum(-1) + 1e-12).sqrt().sum(1)
        middles = place[:, :, None] + self._offsets
        table, others = of_sticks(middles, self._axes, self._things, _ROUNDS)
        limit = BARRIER
        barrier = clamped_log(table - MARGIN * (table < 1.0), limit).sum((1, 2))
        barrier = barrier + clamped_log(others - MARGIN, limit).sum((1, 2, 3))
        cost = length + _CLEAR * self._dt * barrier
        if self._carries.any():
            rows = self._carries
            held = place[rows] + self._tips[rows]
            things = Things(*(t[rows] for t in _parts(self._things)))
            away = to_points(held[:, :, None], things) - self._carried[rows, None, None]
            sunk = (self._rest[rows, None] - held[..., 2]).clamp(min=0.0)
            more = _CLEAR * self._dt * clamped_log(away - MARGIN, limit).sum((1, 2))
            more = more + _SUNK * self._dt * sunk.sum(1) + 1e5 * self._dt * sunk.square().sum(1)
            cost = cost.index_add(0, rows.nonzero()[:, 0], more)
        return cost


def _filled(things: Sequence[Things]) -> Things:
    """One of (B, 1, 1, K, …): rows side by side, of as many things each."""
    most = max(1, *(len(t.places) for t in things))
    rows = []
    for each in things:
        missing = most - len(each.places)
        far = each.places.new_tensor((0.0, 0.0, -9.0)).expand(missing, 3)
        turns = torch.eye(3, dtype=each.places.dtype).expand(missing, 3, 3)
        none = each.places.new_zeros(missing, 3)
        rows.append(
            (
                torch.cat([each.places, far]), torch.cat([each.turns, turns]),
                torch.cat([each.sizes, none]), torch.cat([each.rounding, none[:, 0]]),
            )
        )  # fmt: skip
    places, turns, sizes, rounding = (torch.stack(part) for part in zip(*rows, strict=True))
    return Things(places, turns, sizes, rounding)


def _parts(things: Things) -> tuple[Tensor, ...]:
    return things.places, things.turns, things.sizes, things.rounding


def _tips(place: Tensor, matrix: Tensor, angle: Tensor) -> Tensor:
    """(…, 3): the middle between the tips."""
    centre, _ = gripper.tips(angle)
    return place + torch.einsum("...ij,...j->...i", matrix, centre)


def _weights(shares: Tensor) -> Tensor:
    """(n, 4) of a cubic Bézier curve."""
    s, r = shares, 1.0 - shares
    return torch.stack([r**3, 3.0 * s * r**2, 3.0 * s**2 * r, s**3], dim=1)
