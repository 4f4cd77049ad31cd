"""Gripping poses by inverse kinematics (thesis, section 5.5.3, equations 5.6 and 5.7), batched.

B candidates, F fingers, H hinges of the hand. m, rad; in the palm's frame. A candidate is a style, and a
place along its stick for each finger that touches one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import torch
from torch import Tensor

from understudy_gripping.descent import minimise
from understudy_gripping.distances import box_distance, clamped_log
from understudy_gripping.holding import holding
from understudy_gripping.kinematics import HandKinematics, Placed, stick_ends
from understudy_gripping.styles import Style, check_style
from understudy_hand.scene import HandScene
from understudy_hand.table import FINGERS, can_meet
from understudy_hand.tools import GRIPPERS, HALF_LENGTH, RADIUS, Tool, upper_pose
from understudy_tensors import rotations
from understudy_tensors.segments import at, nearest_places, place_on_segment, segment_distance

#: rad: the range of the angle of the upper part.
ANGLES = (-0.2, 0.2)
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
#: Of a link's axis, at which it is compared with a bone of the palm: 3 mm apart in the longest.
_SAMPLES = 17
#: m that count as much as a rad: about how long a finger is.
_ARM = 0.1


@dataclass(frozen=True)
class Candidate:
    """What is to be found a pose for."""

    style: Style
    places: tuple[float, ...]  #: m, by finger that touches, from the thumb on; x of section 5.5.3
    #: m, by link that bears the tool beside the tips; none takes those of the tool.
    supports: tuple[float, ...] = ()


@dataclass(frozen=True)
class Poses:
    """What was found."""

    hinges: tuple[str, ...]
    pose: Tensor  #: (B, H) rad
    lower: Tensor  #: (B, 7) the lower stick's position and rotation
    angle: Tensor  #: (B,) rad, between the sticks
    gaps: Tensor  #: (B,) m: the widest gap of what shall touch
    #: (B,) m: the least between the hand and a stick, negative where one is inside
    clearance: Tensor
    cost: Tensor  #: (B,)
    iterations: int


class PoseSolver:
    """Finds gripping poses of one hand.

    *Limits:* a local search from straight fingers, so that a grip which there is may not be
    found. Contact is of tips with round sticks or bars; forces come after it
    (:mod:`understudy_gripping.balance`).
    """

    def __init__(self, scene: HandScene, finger_clearance: float | None = None) -> None:
        """With `finger_clearance` (m) links of different fingers keep so far apart by the barrier that the sticks have;
        without it only what lies beyond their first links is drawn out of one another, as far as that costs little."""
        self.scene, self.finger_clearance = scene, finger_clearance
        self.tool: Tool = scene.options.tool
        self.holding = holding(self.tool)
        self.kinematics = hand = HandKinematics(scene)
        self.fingers = scene.measures.names
        self._size = scene.measures.size
        capsules = hand.capsules
        self._tips = torch.tensor([capsules.index(f"{f}_distal") for f in self.fingers])
        #: Links that bear the tool: of capsules and boxes their rows among all of both, capsules first.
        self._shapes = [*capsules, *hand.boxes]
        self._supports = [name for name in self.holding.supports if name in self._shapes]
        self._support_rows = torch.tensor(
            [self._shapes.index(name) for name in self._supports], dtype=torch.long
        )
        self._apart = torch.tensor(_pairs_apart(capsules)).T
        #: Rows of capsules, and of capsules and boxes, that can meet.
        rows = combinations(enumerate(self._shapes), 2)
        meet = [(a, b) for (a, one), (b, other) in rows if can_meet(one, other)]
        count = len(capsules)
        self._capsules_meet = torch.tensor([p for p in meet if p[1] < count]).reshape(-1, 2).T
        self._boxes_meet = (
            torch.tensor([(a, b - count) for a, b in meet if b >= count > a]).reshape(-1, 2).T
        )
        low, high = hand.ranges.T
        inside = torch.where(high - low > 1e-3, _INSIDE, 0.0)
        self._low, self._high = low + inside, high - inside

    def rest(self, style: Style) -> Tensor:
        """(H,) rad: the T-pose of figure 5.6, whose numbers the thesis does not give."""
        last = max(finger for finger, stick in enumerate(style) if stick)
        robot, values = self.scene.options.robot, []
        own = {} if robot is None else robot.rest
        for name in self.kinematics.hinges:
            finger, _, what = name.partition("_")
            row = FINGERS.index(finger)
            bend = _BEND if style[row] else _IDLE_BEND if row < last else _LAST_BEND
            bends = finger != "thumb" and what in ("proximal", "middle", "distal")
            values.append(own.get(name, _THUMB.get(name, bend if bends else 0.0)))
        return torch.tensor(values, dtype=torch.float64).clamp(self._low, self._high)

    def solve(
        self,
        candidates: Sequence[Candidate],
        iterations: int = 400,
        start: Poses | None = None,
        angles: Sequence[float] | None = None,
        nominal: Tensor | None = None,
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
            B angles between the parts to hold; free without.
        nominal
            (B, 7) about which the lower part is searched; that of the tool without.

        Raises
        ------
        ConfigError
            the hand has no such style.
        """
        own = self.holding
        for candidate in candidates:
            check_style(candidate.style, len(self.fingers), self.tool)
        problem = _Problem(self, candidates)
        count, hinges = len(candidates), len(self.kinematics.hinges)
        free = torch.tensor([own.far] * 3 + [own.turned] * 3, dtype=torch.float64).expand(count, 6)
        if nominal is None:
            nominal = torch.tensor([*own.place, *own.turn], dtype=torch.float64).repeat(count, 1)
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
        own = solver.holding
        self._gripper = GRIPPERS.get(solver.tool)
        places = torch.zeros(styles.shape, dtype=torch.float64)
        for row, candidate in enumerate(candidates):
            places[row, self._touches[row]] = torch.tensor(candidate.places, dtype=torch.float64)
        side = torch.tensor([own.sides(c.style) for c in candidates], dtype=torch.float64)
        along = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)
        #: (B, F, 3) in the stick's frame: what p_i(x) of eq. 5.6 is.
        self._goals = places[..., None] * along + own.thickness * side
        self.rest = torch.stack([solver.rest(c.style) for c in candidates])
        supports = [own.supports[name] for name in solver._supports]
        self._support_sticks = torch.tensor([part - 1 for part, _ in supports], dtype=torch.long)
        #: (B, S)
        self._support_places = torch.tensor(
            [c.supports or [place for _, place in supports] for c in candidates],
            dtype=torch.float64,
        )

    def sticks(self, point: Tensor) -> tuple[Tensor, Tensor]:
        """Positions (B, P, 3) and rotations (B, P, 4) of the tool's parts, the upper one first."""
        position = self.nominal[:, :3] + point[:, -7:-4]
        turn = rotations.multiply(
            self.nominal[:, 3:], rotations.from_exponential_map(_nudged(point[:, -4:-1]))
        )
        if self._gripper is None:
            return position[:, None], turn[:, None]
        upper, turned = upper_pose(position, turn, point[:, -1], self._gripper)
        return torch.stack([upper, position], 1), torch.stack([turned, turn], 1)

    def _distances(self, point: Tensor) -> tuple[Placed, Tensor, Tensor, Tensor, Tensor]:
        """Shapes; ends of the parts (B, P, 2, 3); and m between the parts and capsules (B, C, P), boxes
        (B, S, P), one another (B, P - 1); tongs' bars hang together."""
        hand, bar = self._hand, self._solver.holding.bar
        shapes = hand.shapes(point[:, :-7])
        positions, turns = self.sticks(point)
        ends = stick_ends(positions, turns, HALF_LENGTH)
        if bar is None:
            gaps = segment_distance(shapes.ends[:, :, None], ends[:, None]) - RADIUS
            along, thickness = ends, RADIUS
        else:
            gaps = box_distance(
                shapes.ends[:, :, None], positions[:, None], rotations.to_matrix(turns)[:, None],
                positions.new_tensor(bar),
            )  # fmt: skip
            # Boxes of the hand see a bar as three rods side by side.
            across = positions.new_tensor(
                [[0.0, 0.0, way * (bar[2] - bar[1])] for way in (-1.0, 0.0, 1.0)]
            )
            aside = rotations.rotate(turns[:, :, None], across)
            along = (ends[:, :, None] + aside[..., None, :]).flatten(1, 2)
            thickness = bar[1]
        gaps = gaps - hand.radii[:, None]
        boxes = box_distance(
            along[:, None], shapes.boxes[:, :, None], shapes.turns[:, :, None],
            hand.box_sizes[:, None],
        ) - thickness  # fmt: skip
        between = gaps.new_zeros(len(point), 0)
        if bar is None and ends.shape[1] == 2:
            between = segment_distance(ends[:, :1], ends[:, 1:]) - 2.0 * RADIUS
        return shapes, ends, gaps, boxes, between

    def _held(self, gaps: Tensor, boxes: Tensor) -> Tensor:
        """(B, S) m: of the links that bear it, from their part."""
        rows = self._solver._support_rows
        if not len(rows):
            return gaps.new_zeros(len(gaps), 0)
        return torch.cat([gaps, boxes], dim=1)[:, rows, self._support_sticks]

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
        held = self._held(gaps, boxes)
        # Where a capsule is nearest to it, or the middle of a box.
        middles = shapes.boxes[:, :, None].expand(-1, -1, 2, -1)
        bearing = torch.cat([shapes.ends, middles], dim=1)[:, solver._support_rows]
        _, along = nearest_places(bearing, ends[:, self._support_sticks])
        place = (2.0 * along - 1.0) * HALF_LENGTH
        cost = cost + _CONTACT * ((held - _GAP) ** 2).sum(1)
        cost = cost + _ALONG * ((place - self._support_places) ** 2).sum(1)
        # 0.1 mm inside is still finite, so that a start inside finds its way out.
        for clearances in (gaps.flatten(1), boxes.flatten(1), between):
            cost = cost + _CLEARANCE * clamped_log(clearances + 1e-4, _BARRIER).sum(1)
        if solver.finger_clearance is None:
            touching = self._between(shapes, solver._apart)
            cost = cost + _FINGERS_APART * (touching.clamp(max=0.0) ** 2).sum(1)
        else:
            one, box = solver._boxes_meet
            in_palm = box_distance(
                shapes.ends[:, one], shapes.boxes[:, box], shapes.turns[:, box], hand.box_sizes[box],
                _SAMPLES,
            ) - hand.radii[one]  # fmt: skip
            between = torch.cat([self._between(shapes, solver._capsules_meet), in_palm], dim=1)
            spare = between - solver.finger_clearance
            cost = cost + _CLEARANCE * clamped_log(spare, _BARRIER).sum(1)
        pose, moved, turn, angle = point[:, :-7], point[:, -7:-4], point[:, -4:-1], point[:, -1]
        return (
            cost
            + _POSE * ((pose - self.rest) ** 2).sum(1)
            + _STICK_PLACE * (moved**2).sum(1)
            + _STICK_TURN * (turn**2).sum(1)
            + _ANGLE * (angle - 0.02) ** 2
        )

    def _between(self, shapes: Placed, pairs: Tensor) -> Tensor:
        """(B, N) m between the capsules whose rows are `pairs` (2, N)."""
        one, other = pairs
        radii = self._hand.radii
        return (
            segment_distance(shapes.ends[:, one], shapes.ends[:, other]) - radii[one] - radii[other]
        )

    @torch.no_grad()
    def poses(self, point: Tensor, value: Tensor, iterations: int) -> Poses:
        solver = self._solver
        _, _, gaps, boxes, _ = self._distances(point)
        positions, turns = self.sticks(point)
        tip_gaps = gaps[:, solver._tips].gather(2, self._stick[..., None])[..., 0]
        held = self._held(gaps, boxes)
        open_ = torch.cat([torch.where(self._touches, tip_gaps, 0.0), held], dim=1)
        clearance = torch.cat([gaps.flatten(1), boxes.flatten(1)], dim=1).amin(1)
        lower = torch.cat([positions[:, -1], turns[:, -1]], dim=1)
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
