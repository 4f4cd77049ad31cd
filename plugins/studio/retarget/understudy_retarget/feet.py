"""Feet on the floor: when they touch it, and where they then have to be.

The sole of a foot is judged by two points, heel and toe; each comes into contact and leaves it by
itself, so that a foot rolls over its toe. In contact a point rests at one place of the floor. What
that corrects is carried over to the frames between contacts smoothly (Kovar, Schreiner and Gleicher,
"Footskate Cleanup for Motion Capture Editing", SCA 2002). F frames.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from torch import Tensor

from understudy_characters.contacts import latched
from understudy_tensors import rotations

LOW, SLOW = 0.025, 0.3
"""m above the floor and m/s below which a heel or a toe comes into contact."""
HIGH, FAST = 0.035, 0.5
"""m above the floor and m/s beyond which it loses contact."""
SHORTEST = 0.06
"""s: a contact, or a gap between two, that is shorter is none."""
STEEPEST = 0.03
"""m per m: the largest slope of a floor that is meant to be level."""
STEADY = 0.1
"""m: how far apart places must be to tell a slope."""
EASE = 0.12
"""s: how long a correction takes to fade away from a contact."""

_FLAT = 0.01
"""m: how much higher than the lowest point of the sole a point of heel or toe may be."""
_EDGE = 0.01
"""m: how far behind the foremost point of the sole its front edge begins."""
_SHORTEST_SOLE = 0.03
"""m: a foot on a shorter one rests on a point, and turns as it likes."""


_PLAIN, _ALIKE = 0.15, 0.985
"""Of a foot's surface what its sole is at least; and the cosine between the normals of what is one plane."""
_TURNED = 0.35
"""rad that a foot is pitched, rolled or turned by at least where its zero pose is none to stand in."""
_LONG = 1.5
"""How many times longer than wide a sole is that says where the foot points."""


def flattening(points: np.ndarray, shin: np.ndarray) -> Rotation | None:
    """The turn that puts a foot of these `points` (P, 3) flat on the floor and has it point ahead; None if it does so, or
    if it cannot be told, as of round feet. `points` and `shin` (3,), up to the knee, are forward, left and up."""
    if len(points) < 4 or np.ptp(points, axis=0).min() < 1e-6:
        return None
    hull = ConvexHull(points, qhull_options="QJ")
    corners = points[hull.simplices]
    areas = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    normals = hull.equations[:, :3]
    alike = normals @ normals.T > _ALIKE
    planes = np.where(normals @ shin < -0.3 * np.linalg.norm(shin), alike @ areas, 0.0)
    best = int(planes.argmax())
    down = (areas * alike[best]) @ normals
    down = down / np.linalg.norm(down)
    turn = Rotation.identity()
    if planes[best] > _PLAIN * areas.sum() and np.arccos(-down[2].clip(-1.0, 1.0)) > _TURNED:
        turn = Rotation.align_vectors([0.0, 0.0, -1.0], down)[0]
    flat = turn.apply(points)
    sole = flat[flat[:, 2] < flat[:, 2].min() + _FLAT, :2]
    _, spread, axes = np.linalg.svd(sole - sole.mean(axis=0), full_matrices=False)
    if len(sole) > 2 and spread[0] > _LONG * spread[1]:
        along = axes[0] * (1.0 if axes[0] @ (sole.max(axis=0) + sole.min(axis=0)) > 0.0 else -1.0)
        yaw = float(np.arctan2(along[1], along[0]))
        if _TURNED < abs(yaw) < 0.5 * np.pi:
            turn = Rotation.from_rotvec([0.0, 0.0, -yaw]) * turn
    return turn if turn.magnitude() > 0.0 else None


@dataclass(frozen=True)
class Sole:
    """The underside of a foot: points from its ankle, along the frame of the joint that turns it, m."""

    joint: int
    ankle: Tensor  #: (3,) in the joint's frame
    points: Tensor  #: (P, 3), of which one is always the lowest
    heel: Tensor  #: (3,) middle of the rear edge
    toe: Tensor  #: (3,) middle of the front edge
    up: Tensor  #: (3,) up, of the foot that is flat on the floor

    @staticmethod
    def of(joint: int, ankle: Tensor, points: Tensor, axes: np.ndarray) -> Sole:
        """The sole of a foot that consists of `points` (P, 3), in the joint's frame, where `axes` are forward, left and
        up of a foot that is flat."""
        body = torch.from_numpy(axes)
        low = (points - ankle) @ body  # forward, left, up
        bottom = low[:, 2].min()
        low = low[low[:, 2] < bottom + _FLAT]
        ends = []
        for ahead in (-low[:, 0], low[:, 0]):
            edge = low[ahead > ahead.max() - _EDGE]
            middle = 0.5 * (edge.amin(dim=0) + edge.amax(dim=0))
            middle[2] = bottom
            ends.append(body @ middle)
        return Sole(joint, ankle, points - ankle, ends[0], ends[1], body[:, 2])

    @staticmethod
    def point(joint: int, points: Tensor, axes: np.ndarray) -> Sole:
        """The sole of a foot without an ankle: the lowest of its `points` (P, 3)."""
        lowest = points[(points @ torch.from_numpy(axes))[:, 2].argmin()]
        here = torch.zeros(3, dtype=torch.float64)
        return Sole(joint, lowest, points - lowest, here, here, torch.from_numpy(axes[:, 2].copy()))

    @property
    def length(self) -> float:
        return float(torch.linalg.vector_norm(self.toe - self.heel))

    def lowest(self, ankle: Tensor, turn: Tensor) -> Tensor:
        """(F,) m: height of the lowest point, of an ankle (F, 3) and a foot's rotation (F, 4)."""
        down = rotations.to_matrix(turn)[:, 2]
        return ankle[:, 2] + (down @ self.points.T).amin(dim=1)


@dataclass(frozen=True)
class Contacts:
    """When heel and toe of a foot are in contact, (F,) bool each."""

    heel: Tensor
    toe: Tensor

    @property
    def any(self) -> Tensor:
        return self.heel | self.toe


@dataclass(frozen=True)
class Floor:
    """A floor that is nearly level, as recordings have it: off by a few cm over a few m."""

    height: float  #: m, at the centre
    centre: Tensor  #: (2,) m
    slope: Tensor  #: (2,) m per m, along x and y

    def at(self, places: Tensor) -> Tensor:
        """(F,) m: its height at the places (F, 2 or more)."""
        return self.height + (places[:, :2] - self.centre) @ self.slope


def find_floor(times: Tensor, feet: Sequence[tuple[Tensor, Tensor, Sole]]) -> Floor:
    """The floor on which the feet rest: their ankles (F, 3), rotations (F, 4), soles.

    Of the heights at which feet rest the lowest are the floor's; others are steps and chairs. What
    the slope is worth is what it explains: it stays at zero where feet rest at one place only.
    """
    places, resting = [], []
    for ankle, turn, sole in feet:
        lowest = sole.lowest(ankle, turn)
        places.append(torch.cat((ankle[:, :2], lowest[:, None]), dim=1))
        speeds = [
            torch.linalg.vector_norm(_velocity(times, _point(ankle, turn, point)), dim=-1)
            for point in (sole.heel, sole.toe)
        ]
        resting.append(torch.minimum(*speeds) < SLOW)
    spots, rests = torch.cat(places), torch.cat(resting)
    centre, slope = spots[:, :2].mean(dim=0), torch.zeros(2, dtype=torch.float64)
    if rests.sum() < 3:
        return Floor(float(spots[:, 2].quantile(0.01)), centre, slope)
    spots = spots[rests]
    floor = Floor(float(spots[:, 2].quantile(0.05)) + LOW, centre, slope)
    for _ in range(10):
        near = spots[(spots[:, 2] - floor.at(spots)).abs() < 2.0 * LOW]
        if len(near) < 3:
            break
        centre, mean = near[:, :2].mean(dim=0), near[:, 2].mean()
        across = near[:, :2] - centre
        spread = across.T @ across / len(near) + STEADY**2 * torch.eye(2, dtype=torch.float64)
        slope = torch.linalg.solve(spread, across.T @ (near[:, 2] - mean) / len(near))
        slope = slope * (STEEPEST / torch.linalg.vector_norm(slope).clamp(min=1e-9)).clamp(max=1.0)
        floor = Floor(float((near[:, 2] - across @ slope).median()), centre, slope)
    return floor


def contacts(times: Tensor, ankle: Tensor, turn: Tensor, sole: Sole, floor: Floor) -> Contacts:
    """When the foot with this ankle (F, 3) and rotation (F, 4) touches the floor."""
    found = []
    for point in (sole.heel, sole.toe):
        track = _point(ankle, turn, point)
        height = track[:, 2] - floor.at(track)
        speed = torch.linalg.vector_norm(_velocity(times, track), dim=-1)
        touches = latched((height < LOW) & (speed < SLOW), (height < HIGH) & (speed < FAST))
        for filled in (~touches, touches):  # gaps first
            for first, last in _intervals(filled):
                inside = first > 0 and last < len(times) - 1
                if inside and times[last] - times[first] < SHORTEST:
                    touches[first : last + 1] = ~touches[first : last + 1]
        found.append(touches)
    return Contacts(*found)


def planted(
    times: Tensor, ankle: Tensor, turn: Tensor, sole: Sole, touching: Contacts
) -> tuple[Tensor, Tensor]:
    """Ankle (F, 3) and rotation (F, 4) of the foot, moved so that it rests where it touches.

    The floor is at z = 0, and no point of the foot is below it.
    """
    turns = sole.length > _SHORTEST_SOLE
    heel, toe = _point(ankle, turn, sole.heel), _point(ankle, turn, sole.toe)
    rests = _resting_places(heel, toe, touching, sole.length if turns else 0.0)
    if turns:
        turn = _aligned(times, turn, heel, toe, rests, touching)
        turn = _flattened(times, turn, sole, touching)
    # Where the ankle has to be for the resting point to rest; the toe, if both do.
    on_toe = touching.toe[:, None]
    lever = torch.where(on_toe, *(rotations.rotate(turn, end) for end in (sole.toe, sole.heel)))
    level = (torch.where(on_toe, rests[1], rests[0]) - lever - ankle)[:, :2]
    raised = -sole.lowest(ankle, turn)[:, None]
    correction = torch.cat(
        (
            _carried(times, level, touching.any, fades=False),
            _carried(times, raised, touching.any, fades=True),
        ),
        dim=1,
    )
    ankle = ankle + correction
    sunk = sole.lowest(ankle, turn).clamp(max=0.0)
    return ankle - torch.nn.functional.pad(sunk[:, None], (2, 0)), turn


def _resting_places(
    heel: Tensor, toe: Tensor, touching: Contacts, length: float
) -> tuple[Tensor, Tensor]:
    """(F, 3) each: where heel and toe rest, valid where they touch, a foot's length apart."""
    spans = [list(_intervals(touching.heel)), list(_intervals(touching.toe))]
    places = [
        [track[first : last + 1].mean(dim=0) for first, last in spans[end]]
        for end, track in ((0, heel), (1, toe))
    ]
    for i, (first, last) in enumerate(spans[0]):
        for j, (begins, ends) in enumerate(spans[1]):
            if begins <= last and first <= ends and length > 0.0:
                along = (places[1][j] - places[0][i]) * torch.tensor([1.0, 1.0, 0.0])
                apart = torch.linalg.vector_norm(along).clamp(min=1e-6)
                half = 0.5 * (length - apart) * along / apart
                places[0][i], places[1][j] = places[0][i] - half, places[1][j] + half
    result = []
    for track, span, place in ((heel, spans[0], places[0]), (toe, spans[1], places[1])):
        rests = track.clone()
        for (first, last), spot in zip(span, place, strict=True):
            rests[first : last + 1] = spot
        rests[:, 2] = 0.0
        result.append(rests)
    return result[0], result[1]


def _aligned(
    times: Tensor,
    turn: Tensor,
    heel: Tensor,
    toe: Tensor,
    rests: tuple[Tensor, Tensor],
    touching: Contacts,
) -> Tensor:
    """The foot's rotation (F, 4), turned about the vertical to lie between its resting places."""
    along, wanted = (toe - heel)[:, :2], (rests[1] - rests[0])[:, :2]
    across = along[:, 0] * wanted[:, 1] - along[:, 1] * wanted[:, 0]
    yaw = torch.atan2(across, (along * wanted).sum(-1))[:, None]
    yaw = _carried(times, yaw, touching.heel & touching.toe, fades=False)[:, 0]
    return rotations.multiply(rotations.from_heading(yaw), turn)


def _flattened(times: Tensor, turn: Tensor, sole: Sole, touching: Contacts) -> Tensor:
    """The foot's rotation (F, 4), not pitched while heel and toe touch the floor, and not rolled
    about its length while one of them does."""
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    ahead = (sole.toe - sole.heel) / sole.length
    sideways = torch.linalg.cross(sole.up, ahead)
    for which in ("pitch", "roll"):
        along = rotations.rotate(turn, ahead)
        left = torch.linalg.cross(up.expand_as(along), along)  # level, as long as the foot is
        level = torch.linalg.vector_norm(left, dim=-1, keepdim=True)
        if which == "pitch":
            axis, angle = left / level.clamp(min=1e-6), torch.atan2(along[:, 2:], level)
            touches = touching.heel & touching.toe
        else:
            axis, side = along, rotations.rotate(turn, sideways)
            above = torch.linalg.cross(along, left)
            angle = -torch.atan2((side * above).sum(-1, True), (side * left).sum(-1, True))
            angle = angle * (2.0 * level).clamp(max=1.0)  # a foot on its tip has no roll
            touches = touching.any
        undo = _carried(times, angle, touches, fades=True)
        turn = rotations.multiply(rotations.from_exponential_map(undo * axis), turn)
    return turn


def _point(ankle: Tensor, turn: Tensor, point: Tensor) -> Tensor:
    return ankle + rotations.rotate(turn, point)


def _velocity(times: Tensor, track: Tensor) -> Tensor:
    """(F, C) m/s over about 1/30 s, so that jitter does not count."""
    frames = len(times)
    rate = (frames - 1) / float(times[-1] - times[0])
    reach = max(1, round(rate / 60.0))
    after = torch.arange(frames).add(reach).clamp(max=frames - 1)
    before = torch.arange(frames).sub(reach).clamp(min=0)
    return (track[after] - track[before]) / (times[after] - times[before])[:, None]


def _intervals(which: Tensor) -> Iterator[tuple[int, int]]:
    """First and last frame of each run of true frames."""
    padded = torch.nn.functional.pad(which.to(torch.int8), (1, 1))
    change = padded.diff()
    yield from zip(
        (change == 1).nonzero()[:, 0].tolist(), ((change == -1).nonzero()[:, 0] - 1).tolist(),
        strict=True,
    )  # fmt: skip


def _carried(times: Tensor, values: Tensor, known: Tensor, *, fades: bool) -> Tensor:
    """(F, C): `values` where they are `known` (F,), smoothly carried over to the other frames.

    They leave the known frames with the rate of change they have there, and within :data:`EASE` go
    to zero if the correction `fades`, else to a blend between the known frames around.
    """
    if not known.any():
        return torch.zeros_like(values)
    result = torch.where(known[:, None], values, 0.0)
    for first, last in _intervals(~known):
        before, after = first - 1, last + 1
        now = times[first : last + 1, None]
        ends = []
        for end, beyond, sign in ((before, before - 1, 1.0), (after, after + 1, -1.0)):
            if not 0 <= end < len(times):
                ends.append(None)
                continue
            slope = torch.zeros_like(values[0])
            if 0 <= beyond < len(times) and known[beyond]:
                slope = (values[end] - values[beyond]) / (times[end] - times[beyond])
            ends.append((values[end], sign * slope, (now - times[end]).abs()))
        span = float(times[after] - times[before]) if None not in ends else torch.inf
        ease = min(EASE, 0.5 * span)
        parts = []
        for end in ends:
            if end is None:
                continue
            value, slope, since = end
            x = (since / ease).clamp(max=1.0)
            part = slope * ease * x * (1.0 - x) ** 2
            if fades:
                part = part + value * (1.0 - x**2 * (3.0 - 2.0 * x))
            elif span < torch.inf:
                u = (since / span).clamp(max=1.0)
                part = part + value * (1.0 - u**2 * (3.0 - 2.0 * u))
            else:
                part = part + value
            parts.append(part)
        result[first : last + 1] = torch.stack(parts).sum(0)
    return result
