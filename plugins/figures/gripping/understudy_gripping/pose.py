"""Gripping poses by inverse kinematics (thesis, section 5.5.3, equations 5.6 and 5.7), batched.

B candidates, F fingers, H hinges of the hand. m, rad; in the palm's frame. A candidate is a style, and a
place along its stick for each finger that touches one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy_gripping.descent import minimise
from understudy_gripping.distances import box_distance, clamped_log
from understudy_gripping.kinematics import HandKinematics, Placed, stick_ends
from understudy_gripping.styles import LOWER, UPPER, Style, check_style
from understudy_hand.scene import HandScene
from understudy_hand.table import FINGERS
from understudy_hand.tools import HALF_LENGTH, RADIUS, upper_pose
from understudy_tensors import rotations
from understudy_tensors.segments import (
    at,
    nearest_places,
    place_on_segment,
    segment_distance,
)

__all__ = ["first_guess", "sides"]

#: m, rad: where the lower stick lies in a human palm, about which it is searched (the release's grip).
_PLACE = (0.0355, -0.0611, 0.0910)
_TURN = (0.558891, 0.529425, 0.499098, 0.397808)
#: m and rad: how far the lower stick may go from there, and the range of the angle of the upper one.
_FAR, _TURNED, ANGLES = 0.04, 0.6, (-0.2, 0.2)
#: Links that bear a stick beside the tips: the stick, and where along it (m from the middle).
SUPPORTS = {
    "index_metacarpal": (LOWER, 0.085),  # the valley
    "thumb_middle": (LOWER, 0.045),
    "index_proximal": (UPPER, 0.065),
}
#: m: z0 of eq. 5.6, and how far apart what touches shall be.
_BARRIER, _GAP = 1e-3, 2e-4
#: Of the cost's parts. Those of eq. 5.6 are 1 for both in the thesis, in units that it does not say.
_CONTACT, _CLEARANCE, _ALONG, _FINGERS_APART = 4e4, 30.0, 2e3, 1e4
_POSE, _STICK_PLACE, _STICK_TURN, _ANGLE = 2e-3, 5.0, 0.2, 0.5
#: rad, of the T-pose: fingers nearly straight, the thumb beside them. Fingers that touch nothing are out of
#: the way: between others straight, behind the last one bent.
_BEND, _IDLE_BEND, _LAST_BEND = 0.35, 0.15, 0.6
_THUMB = {"thumb_spread": 0.6, "thumb_bend": 0.6, "thumb_middle": -0.4, "thumb_distal": -0.2}
#: How far a hinge stays from the ends of its range, where that is wide.
_INSIDE = 1e-4
#: m that count as much as a rad: about how long a finger is.
_ARM = 0.1


@dataclass(frozen=True)
class Candidate:
    """What is to be found a pose for."""

    style: Style
    places: tuple[float, ...]  #: m, by finger that touches, from the thumb on; x of section 5.5.3


@dataclass(frozen=True)
class Poses:
    """What was found."""

    hinges: tuple[str, ...]
    pose: Tensor  #: (B, H) rad
    lower: Tensor  #: (B, 7) the lower stick's position and rotation
    angle: Tensor  #: (B,) rad, between the sticks
    gaps: Tensor  #: (B,) m: the widest gap of what shall touch
    clearance: (
        Tensor  #: (B,) m: the least between the hand and a stick, negative where one is inside
    )
    cost: Tensor  #: (B,)
    iterations: int

    @property
    def upper(self) -> Tensor:
        """(B, 7)"""
        return torch.cat(upper_pose(self.lower[:, :3], self.lower[:, 3:], self.angle), dim=1)


def first_guess(style: Style) -> tuple[float, ...]:
    """m: places 13 mm from one another towards the tips, the thumb's behind the others (measured)."""
    ahead = {UPPER: 0.0, LOWER: -0.012}
    places = [0.035]
    for stick in style[1:]:
        if stick:
            places.append(ahead[stick])
            ahead[stick] -= 0.013
    return tuple(places)


def sides(style: Style) -> tuple[tuple[float, float, float], ...]:
    """By finger: towards which of its stick's sides it lies. The thesis searches no sides; these are the
    release's: thumb +z, index +y above other fingers, all others -z."""
    above = style[1] == UPPER and UPPER in style[2:]
    index = (0.0, 1.0, 0.0) if above else (0.0, 0.0, -1.0)
    return ((0.0, 0.0, 1.0), index, *[(0.0, 0.0, -1.0)] * (len(style) - 2))


class PoseSolver:
    """Finds gripping poses of one hand.

    *Limits:* a local search from straight fingers, so that a grip which there is may not be
    found. Contact is of tips with round sticks; forces come after it
    (:mod:`understudy_gripping.balance`).
    """

    def __init__(self, scene: HandScene) -> None:
        self.scene = scene
        self.kinematics = hand = HandKinematics(scene)
        self.fingers = scene.measures.names
        self._size = scene.measures.size
        capsules = hand.capsules
        self._tips = torch.tensor([capsules.index(f"{f}_distal") for f in self.fingers])
        self._supports = [name for name in SUPPORTS if name in capsules]
        self._support_rows = torch.tensor([capsules.index(name) for name in self._supports])
        self._apart = torch.tensor(_pairs_apart(capsules)).T
        low, high = hand.ranges.T
        inside = torch.where(high - low > 1e-3, _INSIDE, 0.0)
        self._low, self._high = low + inside, high - inside

    def rest(self, style: Style) -> Tensor:
        """(H,) rad: the T-pose of figure 5.6, whose numbers the thesis does not give."""
        last = max(finger for finger, stick in enumerate(style) if stick)
        values = []
        for name in self.kinematics.hinges:
            finger, _, what = name.partition("_")
            row = FINGERS.index(finger)
            bend = _BEND if style[row] else _IDLE_BEND if row < last else _LAST_BEND
            bends = finger != "thumb" and what in ("proximal", "middle", "distal")
            values.append(_THUMB.get(name, bend if bends else 0.0))
        return torch.tensor(values, dtype=torch.float64).clamp(self._low, self._high)

    def solve(
        self,
        candidates: Sequence[Candidate],
        iterations: int = 400,
        start: Poses | None = None,
        angles: Sequence[float] | None = None,
    ) -> Poses:
        """The poses of all `candidates`, side by side.

        Parameters
        ----------
        candidates
            B of them.
        iterations
            of L-BFGS, at most.
        start
            where to begin (B rows); the T-pose without. The lower stick then stays as it is.
        angles
            B angles between the sticks to hold; free without.

        Raises
        ------
        ConfigError
            the hand has no such style.
        """
        for candidate in candidates:
            check_style(candidate.style, len(self.fingers))
        problem = _Problem(self, candidates)
        count, hinges = len(candidates), len(self.kinematics.hinges)
        free = torch.tensor([_FAR] * 3 + [_TURNED] * 3, dtype=torch.float64).expand(count, 6)
        nominal = torch.tensor([*_PLACE, *_TURN], dtype=torch.float64).repeat(count, 1)
        nominal[:, :3] *= self._size
        point = torch.cat([problem.rest, torch.zeros(count, 7, dtype=torch.float64)], dim=1)
        if start is not None:
            nominal, free = start.lower, torch.zeros(count, 6, dtype=torch.float64)
            point[:, :hinges], point[:, -1] = start.pose, start.angle
        problem.nominal = torch.cat([nominal[:, :3], rotations.normalize(nominal[:, 3:])], dim=1)
        low, high = (torch.full((count, 1), a, dtype=torch.float64) for a in ANGLES)
        if angles is not None:
            low = high = torch.tensor(angles, dtype=torch.float64)[:, None]
        lows = torch.cat([self._low.expand(count, hinges), -free * self._size, low], dim=1)
        highs = torch.cat([self._high.expand(count, hinges), free * self._size, high], dim=1)
        scale = torch.ones(hinges + 7, dtype=torch.float64)
        scale[hinges : hinges + 3] = _ARM
        found = minimise(
            lambda scaled: problem.cost(scaled * scale),
            point / scale, lows / scale, highs / scale, iterations,
        )  # fmt: skip
        return problem.poses(found.points * scale, found.values, found.iterations)


class _Problem:
    """The cost of the poses of some candidates."""

    nominal: Tensor  #: (B, 7)

    def __init__(self, solver: PoseSolver, candidates: Sequence[Candidate]) -> None:
        self._solver, self._hand = solver, solver.kinematics
        styles = torch.tensor([c.style for c in candidates])
        #: (B, F) whether a finger touches, and (B, F) the stick's row: 0 the upper one.
        self._touches, self._stick = styles > 0, (styles - 1).clamp(min=0)
        places = torch.zeros(styles.shape, dtype=torch.float64)
        for row, candidate in enumerate(candidates):
            places[row, self._touches[row]] = torch.tensor(candidate.places, dtype=torch.float64)
        side = torch.tensor([sides(c.style) for c in candidates], dtype=torch.float64)
        along = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)
        #: (B, F, 3) in the stick's frame: what p_i(x) of eq. 5.6 is.
        self._goals = places[..., None] * along + RADIUS * side
        self.rest = torch.stack([solver.rest(c.style) for c in candidates])
        supports = [SUPPORTS[name] for name in solver._supports]
        self._support_sticks = torch.tensor([stick - 1 for stick, _ in supports])
        self._support_places = torch.tensor([p for _, p in supports], dtype=torch.float64)

    def sticks(self, point: Tensor) -> tuple[Tensor, Tensor]:
        """Positions (B, 2, 3) and rotations (B, 2, 4), the upper stick first."""
        position = self.nominal[:, :3] + point[:, -7:-4]
        turn = rotations.multiply(
            self.nominal[:, 3:], rotations.from_exponential_map(_nudged(point[:, -4:-1]))
        )
        upper, turned = upper_pose(position, turn, point[:, -1])
        return torch.stack([upper, position], 1), torch.stack([turned, turn], 1)

    def _distances(self, point: Tensor) -> tuple[Placed, Tensor, Tensor, Tensor, Tensor]:
        """Shapes; ends of the sticks (B, 2, 2, 3); and m between the sticks and capsules (B, C, 2), boxes
        (B, S, 2), one another (B,)."""
        hand = self._hand
        shapes = hand.shapes(point[:, :-7])
        positions, turns = self.sticks(point)
        ends = stick_ends(positions, turns, HALF_LENGTH)
        gaps = segment_distance(shapes.ends[:, :, None], ends[:, None])
        gaps = gaps - hand.radii[:, None] - RADIUS
        boxes = box_distance(
            ends[:, None], shapes.boxes[:, :, None], shapes.turns[:, :, None],
            hand.box_sizes[:, None],
        ) - RADIUS  # fmt: skip
        between = segment_distance(ends[:, 0], ends[:, 1]) - 2.0 * RADIUS
        return shapes, ends, gaps, boxes, between

    def cost(self, point: Tensor) -> Tensor:
        """(B,)"""
        solver, hand = self._solver, self._hand
        shapes, ends, gaps, boxes, between = self._distances(point)
        positions, turns = self.sticks(point)
        rows = torch.arange(len(point))[:, None]
        touched, turned = positions[rows, self._stick], turns[rows, self._stick]
        goals = touched + rotations.rotate(turned, self._goals)  # p_i(x)
        tips = shapes.ends[:, solver._tips]
        with torch.no_grad():
            nearest = place_on_segment(goals, tips)
        away = _norm(at(tips, nearest) - goals) - hand.radii[solver._tips]  # of f_i(q) from p_i(x)
        tip_gaps = gaps[:, solver._tips].gather(2, self._stick[..., None])[..., 0]
        cost = _CONTACT * (self._touches * (away**2 + (tip_gaps - _GAP) ** 2)).sum(1)
        held = gaps[:, solver._support_rows, self._support_sticks]
        _, along = nearest_places(
            shapes.ends[:, solver._support_rows], ends[:, self._support_sticks]
        )
        place = (2.0 * along - 1.0) * HALF_LENGTH
        cost = cost + _CONTACT * ((held - _GAP) ** 2).sum(1)
        cost = cost + _ALONG * ((place - self._support_places) ** 2).sum(1)
        # 0.1 mm inside is still finite, so that a start inside finds its way out.
        for clearances in (gaps.flatten(1), boxes.flatten(1), between[:, None]):
            cost = cost + _CLEARANCE * clamped_log(clearances + 1e-4, _BARRIER).sum(1)
        one, other = solver._apart
        touching = (
            segment_distance(shapes.ends[:, one], shapes.ends[:, other])
            - hand.radii[one]
            - hand.radii[other]
        )
        cost = cost + _FINGERS_APART * (touching.clamp(max=0.0) ** 2).sum(1)
        pose, moved, turn, angle = point[:, :-7], point[:, -7:-4], point[:, -4:-1], point[:, -1]
        return (
            cost
            + _POSE * ((pose - self.rest) ** 2).sum(1)
            + _STICK_PLACE * (moved**2).sum(1)
            + _STICK_TURN * (turn**2).sum(1)
            + _ANGLE * (angle - 0.02) ** 2
        )

    @torch.no_grad()
    def poses(self, point: Tensor, value: Tensor, iterations: int) -> Poses:
        solver = self._solver
        _, _, gaps, boxes, _ = self._distances(point)
        positions, turns = self.sticks(point)
        tip_gaps = gaps[:, solver._tips].gather(2, self._stick[..., None])[..., 0]
        held = gaps[:, solver._support_rows, self._support_sticks]
        open_ = torch.cat([torch.where(self._touches, tip_gaps, 0.0), held], dim=1)
        clearance = torch.cat([gaps.flatten(1), boxes.flatten(1)], dim=1).amin(1)
        lower = torch.cat([positions[:, 1], turns[:, 1]], dim=1)
        return Poses(
            tuple(self._hand.hinges), point[:, :-7], lower, point[:, -1], open_.amax(1), clearance,
            value, iterations,
        )  # fmt: skip


def _pairs_apart(capsules: Sequence[str]) -> list[tuple[int, int]]:
    """The links of different fingers that shall not pass through one another."""
    free = [
        (row, name.partition("_")[0])
        for row, name in enumerate(capsules)
        if not name.endswith(("_proximal", "_metacarpal"))
    ]
    return [(a, b) for k, (a, one) in enumerate(free) for b, other in free[k + 1 :] if one != other]


def _nudged(vector: Tensor) -> Tensor:
    """`vector`, where it is 0 a little away from it: the length of 0 has no gradient."""
    return torch.where(vector.abs().sum(-1, keepdim=True) > 0, vector, vector + 1e-12)


def _norm(vector: Tensor) -> Tensor:
    return ((vector * vector).sum(-1) + 1e-24).sqrt()
