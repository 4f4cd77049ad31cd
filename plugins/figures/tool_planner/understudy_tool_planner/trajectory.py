"""The way of the gripper through free space (thesis, equation 5.8), batched over ways and starts.

Positions are a cubic Bézier curve, of whose four control points the inner two are free; orientations are
interpolated spherically, the angle between the sticks linearly. What is minimised is the length and a clamped
log barrier on clearance. B ways, n frames, K things; m, rad.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from understudy_gripping.descent import minimise
from understudy_hand.tools import HALF_LENGTH
from understudy_tensors import rotations
from understudy_tool_planner.clearance import of_rods, to_points
from understudy_tool_planner.gripper import Jaws
from understudy_tool_planner.objects import Things

#: m: z0 of eq. 5.8, and what is added to it, so that frames between those looked at are clear too.
BARRIER, MARGIN = 1e-3, 5e-4
#: m: below this the barrier goes on as a straight line; and where there is nothing.
_LEAST, _FAR = 1e-4, 9.0
#: Of the barrier, and of the depth of what is carried in the table, beside the length in m.
_CLEAR, _SUNK = 300.0, 200.0
#: Frames that are looked at; rounds of the search for nearest points there.
_FRAMES, _ROUNDS = 32, 3
_ITERATIONS, _HALVINGS = 12, 3
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

    jaws: Jaws
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


def clearance(
    jaws: Jaws,
    frames: Frames,
    things: Things | None,
    carried: float | None = None,
    rounds: int = 24,
) -> Tensor:
    """(…, n) m: of the gripper, and of what is carried, from the table and from `things`."""
    matrix = rotations.to_matrix(frames.turn)
    table, others = of_rods(jaws.rods(frames.place, matrix, frames.angle), things, rounds)
    least = [table.amin(-1), others.flatten(-2).amin(-1)] if others.numel() else [table.amin(-1)]
    if carried is not None and things is not None and len(things.places):
        held = tips(jaws, frames.place, matrix, frames.angle)
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
    with torch.enable_grad():
        found = minimise(
            cost, flat, -bound, bound, _ITERATIONS, memory=8, tolerance=1e-3, halvings=_HALVINGS
        )
    return found.points.view(len(ways), starts, 2, 3), found.values.view(len(ways), starts)


def _first(way: Way) -> Tensor:
    """(2, 3): a third of the way each, lifted."""
    start, end = way.start.place, way.end.place
    lift = start.new_tensor((0.0, 0.0, _LIFT))
    return torch.stack(
        [start + (end - start) / 3.0 + lift, start + 2.0 * (end - start) / 3.0 + lift]
    )


class _Cost:
    """Eq. 5.8 of many ways, (B, 6) to (B,), with its gradient in closed form.

    Orientations are given, so everything but the lower stick's place is computed once, in the frames of the things:
    R rods (the gripper's, and the sphere around what is carried as one without length), K things. All ways are of one
    gripper.
    """

    def __init__(self, ways: Sequence[Way], shares: Tensor) -> None:
        self._weights = _weights(shares)
        frames = [along(way, _first(way), shares) for way in ways]
        matrix = rotations.to_matrix(torch.stack([f.turn for f in frames]))
        angle = torch.stack([f.angle for f in frames])
        still = torch.zeros(len(ways), len(shares), 3, dtype=angle.dtype)
        ends = torch.stack([torch.stack([w.start.place, w.end.place]) for w in ways])
        self._fixed = torch.einsum("nc,bci->bni", self._weights[:, [0, 3]], ends)
        jaws = ways[0].jaws
        middle, own = tips(jaws, still, matrix, angle), jaws.rods(still, matrix, angle)
        axes = torch.cat([own.axes, torch.zeros_like(own.axes[:, :, :1])], 2)  # (B, n, R, 3)
        offsets = torch.cat([own.middles, middle[:, :, None]], 2)
        rods = self._fixed[:, :, None] + offsets
        things = _filled([way.things for way in ways])
        #: (3, B, n, R, K) the rods' middles without the inner points, and their axes.
        self._middles = _turned(rods[:, :, :, None] - things.places[:, None, None], things)
        self._along = _turned(
            axes[:, :, :, None].expand(-1, -1, -1, len(things.places[0]), -1), things
        )
        self._turns = things.turns
        self._sizes = things.sizes.movedim(-1, 0)[:, :, None, None]
        carried = [way.carried for way in ways]
        rods_radii = [own.radius] * own.middles.shape[-2]
        radii = [[*rods_radii, -_FAR if c is None else c] for c in carried]
        wide = torch.tensor(radii, dtype=angle.dtype)
        #: (B, 1, R, K) m that are taken off a distance.
        self._off = (wide[:, :, None] + things.rounding[:, None])[:, None] + MARGIN
        #: (B, n, P) m: of the parts' lowest points above the table, without the inner points.
        self._low = self._fixed[..., None, 2] + own.low
        # They stand on it at the ends, with less than the margin.
        self._low = self._low - MARGIN * (4.0 * shares * (1.0 - shares))[:, None]
        tip = middle[..., 2] + self._fixed[..., 2]
        rest = torch.minimum(tip[:, 0], tip[:, -1])
        none = torch.tensor([c is None for c in carried])
        self._lift = torch.where(none[:, None], _FAR, tip - rest[:, None])
        self._dt = 1.0 / len(shares)
        self._last: tuple[Tensor, Tensor, Tensor] | None = None

    def __call__(self, point: Tensor) -> Tensor:
        return _Known.apply(point, self)  # type: ignore[no-any-return, no-untyped-call]

    def known(self, point: Tensor) -> tuple[Tensor, Tensor]:
        """Those at `point`, which the search asks for twice where it takes a step."""
        if self._last is None or not torch.equal(self._last[0], point):
            self._last = point.clone(), *self.both(point)
        return self._last[1], self._last[2]

    def both(self, point: Tensor) -> tuple[Tensor, Tensor]:
        """Values (B,) and gradients (B, 6)."""
        inner, weights = point.view(-1, 2, 3), self._weights[:, 1:3]
        moved = weights @ inner  # (B, n, 3)
        place = self._fixed + moved
        step = place[:, 1:] - place[:, :-1]
        long = (step.square().sum(-1, keepdim=True) + 1e-12).sqrt()
        value, unit = long.sum((1, 2)), step / long
        slope = torch.zeros_like(place)
        slope[:, 1:] += unit
        slope[:, :-1] -= unit
        scale = _CLEAR * self._dt
        # From the table.
        low = self._low + moved[..., 2:]
        barrier, steep = _barrier(low)
        value = value + scale * barrier.sum((1, 2))
        slope[..., 2] += scale * steep.sum(2)
        # What is carried stays above where it lay.
        sunk = (self._lift + moved[..., 2]).clamp(max=0.0)
        value = value + self._dt * (1e5 * sunk.square() - _SUNK * sunk).sum(1)
        slope[..., 2] += self._dt * (2e5 * sunk - _SUNK * (sunk < 0))
        # From things, in their frames.
        local = torch.einsum("bci,bkij->jbck", inner, self._turns)
        middle = self._middles + torch.einsum("nc,jbck->jbnk", weights, local)[:, :, :, None]
        where = (-(middle * self._along).sum(0)).clamp(-HALF_LENGTH, HALF_LENGTH)
        for _ in range(_ROUNDS):
            near = torch.addcmul(middle, where, self._along).clamp(-self._sizes, self._sizes)
            where = ((near - middle) * self._along).sum(0).clamp(-HALF_LENGTH, HALF_LENGTH)
        there = torch.addcmul(middle, where, self._along)
        beyond = there.abs() - self._sizes
        out = beyond.clamp(min=0.0)
        distance = ((out * out).sum(0) + 1e-18).sqrt()
        deep = beyond.amax(0)
        barrier, steep = _barrier(distance + deep.clamp(max=0.0) - self._off)
        value = value + scale * barrier.sum((1, 2, 3))
        inside = (beyond == deep) & (deep < 0.0)
        away = (out / distance + inside) * there.sign() * (scale * steep)
        pushed = torch.einsum("nc,jbnk->jbck", weights, away.sum(3))
        gradient = torch.einsum("nc,bni->bci", weights, slope)
        gradient = gradient + torch.einsum("jbck,bkij->bci", pushed, self._turns)
        return value, gradient.flatten(1)


class _Known(torch.autograd.Function):
    """A cost whose gradient comes with it."""

    @staticmethod
    def forward(ctx: Any, point: Tensor, cost: _Cost) -> Tensor:
        value, gradient = cost.known(point)
        ctx.save_for_backward(gradient)
        return value

    @staticmethod
    def backward(ctx: Any, *given: Tensor) -> tuple[Tensor, None]:
        (gradient,) = ctx.saved_tensors
        return given[0][:, None] * gradient, None


def _barrier(z: Tensor) -> tuple[Tensor, Tensor]:
    """Eq. 5.7 and its derivative, below :data:`_LEAST` as a straight line."""
    inside = z.clamp(_LEAST, BARRIER)
    over, log = inside - BARRIER, (inside / BARRIER).log()
    square = over * over / inside
    slope = -(2.0 * over / inside - square / inside) * log - square / inside
    slope = torch.where(z < BARRIER, slope, 0.0)
    return -square * log + slope * (z - _LEAST).clamp(max=0.0), slope


def _turned(vectors: Tensor, things: Things) -> Tensor:
    """(3, B, n, R, K) in the things' frames, of (B, n, R, K, 3)."""
    return torch.einsum("bnrki,bkij->jbnrk", vectors, things.turns).contiguous()


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


def tips(jaws: Jaws, place: Tensor, matrix: Tensor, angle: Tensor) -> Tensor:
    """(…, 3): the middle between the tips."""
    centre, _ = jaws.tips(angle)
    return place + torch.einsum("...ij,...j->...i", matrix, centre)


def _weights(shares: Tensor) -> Tensor:
    """(n, 4) of a cubic Bézier curve."""
    s, r = shares, 1.0 - shares
    return torch.stack([r**3, 3.0 * s * r**2, 3.0 * s**2 * r, s**3], dim=1)
