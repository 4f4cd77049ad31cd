"""Plans: where arm, sticks and an object shall be while it is taken and put elsewhere (thesis, section 5.6).

Approach, closing, relocation, release, in frames of 10 ms. m, rad, s; in the world.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import torch
from torch import Tensor

from understudy_gripping.grip import Grip
from understudy_gripping.kinematics import HandKinematics
from understudy_hand.model import TABLE_CENTRE, TABLE_SIZE
from understudy_hand.scene import HandScene
from understudy_hand.table import ARM_POSE
from understudy_tensors import rotations
from understudy_tool_planner import arm, trajectory
from understudy_tool_planner.configuration import (
    INSIDE,
    SWIVELS,
    Configurations,
    Holder,
    NoPlan,
    choose,
)
from understudy_tool_planner.gripper import Jaws
from understudy_tool_planner.objects import Shape, Things
from understudy_tool_planner.throwing import OPENING, STOP, SWING, Throw, throw
from understudy_tool_planner.trajectory import Frames, Pose, Way

__all__ = ["ASIDE", "CLOSING", "DT", "LEAST", "PHASES", "PRESSING", "Plan", "Planner"]

#: s of a frame; m/s and s: speed of the sticks (thesis), and the least that a phase takes (release).
DT, SPEED, LEAST = 0.01, 0.25, 0.5
#: rad/s at which the gripper turns at most. By the release's 0.4 π a hinge of the wrist moves at 2.3 rad/s at once, and from 2 on its servo
#: is at its limit, which throws the sticks out of the hand.
TURNING = 0.6
#: s that closing and opening take; that closed ones rest before they lift, where nothing else is said; that open ones take to go aside.
CLOSING, PRESSING, ASIDE = 0.15, 0.1, 0.1
#: s that sticks wait before they begin anew, as long as a plan takes to be found; m and s of their way up first.
WAITING, LIFT, LIFTING = 0.1, 0.03, 0.3
PHASES = ("approach", "close", "relocate", "release")
_FRAMES = ("place", "turn", "angle")
#: m: sticks that are nearer to where they open around an object do not go over it first.
_NEAR = 0.03
#: rad: how far a hinge of the arm may go in a frame.
STEP = 0.15
#: m: how deep what is carried may be in what it lies on.
SUNK = 1e-4
#: Configurations that are tried, the best first; starts of a way that the first one did not find clear.
_TRIED, _STARTS = 6, 3


@dataclass(frozen=True)
class Task:
    """An object to be moved, and where to."""

    shape: Shape
    start: tuple[float, float]  #: m, on the table
    goal: tuple[float, float]  #: m
    heading: float = 0.0  #: rad, at the start
    goal_heading: float | None = None  #: rad; None leaves it as it is
    upon: float = 0.0  #: m: how high what it is put upon is; 0 is the table
    thrown: bool = False  #: whether it is thrown there
    above: Shape | None = None  #: what lies upon it and goes along; the sticks keep clear of it

    def over(self, place: Tensor, heading: Tensor) -> Things:
        """What lies upon it where it is at `place` (3,) m, turned by `heading` () rad."""
        if self.above is None:
            return Things.of([], place.new_zeros(0, 2), place.new_zeros(0))
        found = Things.of([self.above], place[None, :2], heading[None])
        found.places[:, 2] += place[2] + self.shape.height
        return found


@dataclass(frozen=True)
class Moment:
    """Where arm and sticks are as a plan begins."""

    lower: Tensor  #: (7,) the lower stick's position and rotation
    angle: Tensor  #: () rad, between the sticks
    arm: Tensor  #: (7,) rad


@dataclass(frozen=True)
class Plan:
    """T frames of :data:`DT`."""

    lower: Tensor  #: (T, 7) the lower stick
    angle: Tensor  #: (T,) rad, between the sticks
    arm: Tensor  #: (T, 7) rad
    object: Tensor  #: (T, 7) what is moved
    phase: Tensor  #: (T,) number in :data:`PHASES`
    clearance: float  #: m, the least of all frames: of sticks, hand and what is carried

    @property
    def seconds(self) -> float:
        return DT * len(self.angle)

    @property
    def end(self) -> Moment:
        """From which the next plan goes on."""
        return Moment(self.lower[-1], self.angle[-1], self.arm[-1])

    def approach(self, thing: Tensor) -> Plan:
        """Its approach alone, while an object rests at the pose `thing` (7,)."""
        count = int((self.phase == PHASES.index("approach")).sum())
        return Plan(
            self.lower[:count], self.angle[:count], self.arm[:count], thing.expand(count, 7), self.phase[:count],
            self.clearance,
        )  # fmt: skip

    def after(self, way: Plan) -> Plan:
        """This plan with `way` before it, from where that ends."""
        return Plan(
            torch.cat([way.lower, self.lower]), torch.cat([way.angle, self.angle]), torch.cat([way.arm, self.arm]),
            torch.cat([way.object, self.object]), torch.cat([way.phase, self.phase]), min(way.clearance, self.clearance),
        )  # fmt: skip


@dataclass(frozen=True)
class _Asked:
    """What a plan has to do, in tensors of the world frame."""

    task: Task
    now: Moment
    start: Tensor  #: (3,) m, of the object's middle
    goal: Tensor  #: (3,) m; of one that is thrown, where it is let go
    heading: Tensor  #: () rad, at the start
    last: Tensor  #: () rad, at the goal
    others: Things  #: objects that stay
    error: Tensor | None  #: (3,) m
    thrown: Throw | None
    own: Things  #: the object, at the start
    above: tuple[Things, Things]  #: what lies upon it, at the start and at the goal
    away: Frames | None  #: waiting, opening and going up first, if something has failed


class Planner:
    """Plans for one hand and grip. Deterministic.

    *Limits:* it plans motions, not forces: objects stand still until they are taken, and are
    spheres, capsules and boxes of the sizes of table 5.2. The search is partly random, so it
    may miss a way that exists.

    Parameters
    ----------
    at
        (7,) the lower part's position and rotation in the palm's frame, where a hand holds it elsewhere than the grip
        was found for: tongs turn a little between two fingers.
    pressing
        s that the closed gripper rests before it lifts.
    over
        m: how high over an object a gripper that comes from elsewhere goes first; then it comes down. 0: straight to it.
    slowly
        how many times as long the gripper takes for its ways without an object as by the thesis' speed.
    """

    def __init__(
        self,
        grip: Grip,
        scene: HandScene,
        at: Tensor | None = None,
        pressing: float = PRESSING,
        over: float = 0.0,
        slowly: float = 1.0,
    ) -> None:
        grip.need(scene)
        self._pressing, self._over, self._slowly = pressing, over, slowly
        self._jaws, self._least = Jaws(scene.options.tool), float(grip.angles[0])
        hand = HandKinematics(scene)
        shapes = hand.shapes(torch.tensor(grip.poses[:1]))
        corners = torch.tensor(
            [[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], dtype=torch.float64
        )
        boxes = shapes.boxes[0, :, None] + torch.einsum(
            "sij,spj->spi", shapes.turns[0], corners * hand.box_sizes[:, None]
        )
        lower = torch.tensor(grip.lower) if at is None else at
        self._holder = Holder(
            self._jaws,
            self._least,
            float(grip.angles[-1]),
            lower[:3],
            rotations.to_matrix(rotations.normalize(lower[3:])),
            torch.cat([shapes.ends[0].flatten(0, 1), boxes.flatten(0, 1)]),
            torch.cat(
                [hand.radii.repeat_interleave(2), torch.zeros(boxes[..., 0].numel()).double()]
            ),
        )
        self._lower = rotations.normalize(lower[3:])
        #: m: how much further along the lower part the tool is held.
        self._along = 0.0

    def shifted(self, along: float) -> Planner:
        """The same for a tool that is held `along` m further along its lower part (section 5.7.2)."""
        other = copy.copy(self)
        other._along = along
        away = (along - self._along) * self._holder.turn[:, 0]
        other._holder = replace(self._holder, place=self._holder.place + away)
        return other

    def start(self) -> Moment:
        """Where a plan begins: the tool where the standard arm has it, however far along it is held."""
        if not self._along:
            return self.begin()
        standard = torch.tensor(ARM_POSE, dtype=torch.float64)
        palm, turn = arm.forward(standard)
        palm = palm - self._along * (turn @ self._holder.turn[:, 0])
        found = arm.solve(palm, turn, arm.swivel_of(standard))
        if not found.inside > 0.0:
            raise NoPlan(
                f"No plan begins with the tool held {1e3 * self._along:g} mm further along: the arm does not reach it."
            )
        return self.begin(tuple(found.pose.tolist()))

    def begin(self, pose: tuple[float, ...] = ARM_POSE) -> Moment:
        """The sticks in the hand, open, with the arm at `pose` rad."""
        angles = torch.tensor(pose, dtype=torch.float64)
        palm, turn = arm.forward(angles)
        place = palm + turn @ self._holder.place
        rotation = rotations.multiply(_quaternion(turn), self._lower)
        return Moment(torch.cat([place, rotation]), angles.new_tensor(self._least), angles)

    @torch.no_grad()
    def plan(
        self,
        task: Task,
        now: Moment,
        others: Things,
        error: Tensor | None = None,
        anew: bool = False,
    ) -> Plan:
        """The way to take the object and to put it at its goal.

        Parameters
        ----------
        now
            where arm and sticks are.
        others
            objects that stay.
        error
            (3,) m: how far beside the object's middle the sticks take, carry and put it (noise of section 5.7.5).
        anew
            whether something has failed: the sticks wait, open and go up before they approach (section 5.7.5).

        Raises
        ------
        NoPlan
            none was found; the sentence says in which phase, and by how many millimetres.
        """
        asked = self._asked(task, now, others, error, anew)
        _refuse_what_is_no_number(asked)
        found = choose(
            task.shape, asked.start, asked.heading, asked.goal, asked.last, now.lower[3:],
            _united(others, *asked.above), self._holder,
        )  # fmt: skip
        _refuse_beside_the_table(task)
        worst: NoPlan | None = None
        for row in range(min(_TRIED, len(found.score))):
            try:
                return self._complete(found, row, asked)
            except NoPlan as refused:
                worst = worst or refused
        assert worst is not None
        raise worst

    def _asked(
        self, task: Task, now: Moment, others: Things, error: Tensor | None, anew: bool
    ) -> _Asked:
        heading = torch.tensor(task.heading, dtype=torch.float64)
        last = heading if task.goal_heading is None else heading.new_tensor(task.goal_heading)
        start = heading.new_tensor((*task.start, task.shape.height))
        goal = heading.new_tensor((*task.goal, task.shape.height + task.upon))
        thrown = None
        if task.thrown:  # it is let go in the air, turned as it was taken
            thrown = throw(start, goal)
            goal, last = thrown.release, heading
        return _Asked(
            task, now, start, goal, heading, last, others, error, thrown,
            own=Things.of([task.shape], start[None, :2], heading[None]),
            above=(task.over(start, heading), task.over(goal, last)),
            away=self._away(now) if anew else None,
        )  # fmt: skip

    def _complete(self, found: Configurations, row: int, asked: _Asked) -> Plan:
        """The plan that takes the object in the configuration `row`."""
        closed, wide = found.closed[row], found.open[row]
        takes, puts = found.turn[row], found.end[row]

        def pose(turn: Tensor, angle: Tensor, middle: Tensor) -> Pose:
            return Pose(self._jaws.placed(rotations.to_matrix(turn), angle, middle), turn, angle)

        arrives = asked.goal if asked.thrown is None else asked.thrown.begin
        approach, relocate, clear = self._moves(
            asked, pose(takes, wide, asked.start), pose(takes, closed, asked.start), pose(puts, closed, arrives)
        )  # fmt: skip
        shares = torch.linspace(0.0, 1.0, round(CLOSING / DT) + 1, dtype=torch.float64)[1:]
        close = self._turning(takes, wide, closed, asked.start, shares)
        count = round(self._pressing / DT)
        rest = Frames(*(getattr(close, n)[-1:].repeat_interleave(count, 0) for n in _FRAMES))
        close = _joined(close, rest)
        if asked.thrown is None:
            free = self._release(puts, closed, asked.goal, shares)
        else:
            swing, free = self._swing(puts, closed, asked.thrown)
            relocate = _joined(relocate, swing)
            clear.append(self._clear(swing, asked.others))
        clear += [
            self._clear(frames, _united(asked.others, above))
            for frames, above in zip((close, free), asked.above, strict=True)
        ]
        order = [approach, close, relocate, free]
        whole = _joined(*order)
        phase = torch.repeat_interleave(
            torch.arange(4), torch.tensor([len(f.angle) for f in order])
        )
        matrix = rotations.to_matrix(whole.turn)
        palm, hand = self._holder.palm(whole.place, matrix)
        clear.append(float(self._holder.clearance(palm, hand).amin()))
        if min(clear) < 0.0:
            raise NoPlan(
                f"No plan reaches the goal: on the way the hand or the gripper is {-1e3 * min(clear):.1f} mm in the "
                "table or an object. Choose another goal, or move what is in the way."
            )
        if (error := asked.error) is not None and error.any():  # shifted evenly during the approach
            approaching = phase == PHASES.index("approach")
            share = torch.where(approaching, approaching.cumsum(0) / approaching.sum(), 1.0)
            whole = Frames(whole.place + share[:, None] * error, whole.turn, whole.angle)
            palm, hand = self._holder.palm(whole.place, matrix)
        return Plan(
            torch.cat([whole.place, whole.turn], 1), whole.angle, self._arms(asked.now, palm, hand, phase),
            self._object(asked, whole, phase, takes), phase, min(clear),
        )  # fmt: skip

    def _moves(
        self, asked: _Asked, open_: Pose, taken: Pose, put: Pose
    ) -> tuple[Frames, Frames, list[float]]:
        """The approach to `open_`, the relocation from `taken` to `put`, and the clearance of each, m."""
        task, away = asked.task, asked.away
        begin = Pose(asked.now.lower[:3], asked.now.lower[3:], asked.now.angle)
        if away is not None:
            begin = Pose(away.place[-1], away.turn[-1], away.angle[-1])
        # An object that is put upon another comes nearer to it than the sphere around it.
        carried = task.shape.height - SUNK if task.upon > 0 else task.shape.reach
        everything = _united(asked.others, asked.own, asked.above[0])
        ways = [
            Way(self._jaws, begin, open_, everything),
            Way(self._jaws, taken, put, asked.others, carried),
        ]
        if self._over and float((begin.place - open_.place).norm()) > _NEAR:
            over = replace(open_, place=open_.place + open_.place.new_tensor([0, 0, self._over]))
            down = Way(self._jaws, over, open_, everything)
            ways = [replace(ways[0], end=over), ways[1], down]
        inner, value = trajectory.find(ways, 1)
        parts, clear = [], []
        for k, way in enumerate(ways):
            name = "approach" if way.carried is None else "relocate"
            frames, least = self._best(way, inner[k], value[k])
            if least < 0.0:  # again, from several starts
                more, values = trajectory.find([way], _STARTS)
                frames, least = self._best(way, more[0], values[0])
            if least < 0.0:
                raise NoPlan(
                    f"No plan reaches the goal: in the phase '{name}' something is in the way, by "
                    f"{-1e3 * least:.1f} mm at the best. Choose another goal, or move what is in the way."
                )
            parts.append(frames)
            clear.append(least)
        before = [] if away is None else [away]
        return _joined(*before, parts[0], *parts[2:]), parts[1], clear

    def _clear(self, frames: Frames, things: Things) -> float:
        """m, the least in all frames."""
        return float(trajectory.clearance(self._jaws, frames, things).amin())

    def _object(self, asked: _Asked, frames: Frames, phase: Tensor, takes: Tensor) -> Tensor:
        """(T, 7) where the object is: at the start until it is taken with the sticks turned by `takes`, between
        their tips while it is moved, and then at the goal, or in flight."""
        centre, _ = self._jaws.tips(frames.angle)
        place = frames.place if asked.error is None else frames.place - asked.error
        middle = place + torch.einsum("nij,nj->ni", rotations.to_matrix(frames.turn), centre)
        moving, done = phase == 2, phase == 3
        at = torch.where(
            moving[:, None], middle, torch.where(done[:, None], asked.goal, asked.start)
        )
        if asked.thrown is not None:
            at[done] = asked.thrown.flight(
                DT * torch.arange(1, int(done.sum()) + 1, dtype=at.dtype)
            )
        first, last = rotations.from_heading(asked.heading), rotations.from_heading(asked.last)
        turned = rotations.multiply(
            rotations.multiply(frames.turn, rotations.conjugate(takes)), first
        )
        rotation = torch.where(moving[:, None], turned, torch.where(done[:, None], last, first))
        return torch.cat([at, rotation], 1)

    def _best(self, way: Way, inner: Tensor, value: Tensor) -> tuple[Frames, float]:
        """Frames of the cheapest start that is clear, and its clearance; if none is, those of the clearest."""
        length = float((way.end.place - way.start.place).square().sum().sqrt())
        turned = float(rotations.angle_between(way.start.turn, way.end.turn))
        slowly = self._slowly if way.carried is None else 1.0
        count = round(slowly * max(LEAST, length / SPEED, turned / TURNING) / DT)
        shares = torch.linspace(0.0, 1.0, count + 1, dtype=torch.float64)
        best: tuple[Frames, float] | None = None
        for row in value.argsort().tolist():
            frames = trajectory.along(way, inner[row], shares)
            least = float(trajectory.clearance(self._jaws, frames, way.things, way.carried).amin())
            if way.carried is not None:
                rest = float(torch.minimum(self._height(way.start), self._height(way.end)))
                matrix = rotations.to_matrix(frames.turn)
                held = trajectory.tips(self._jaws, frames.place, matrix, frames.angle)
                lift = held[:, 2].amin()
                if float(lift) < rest - SUNK:
                    least = min(least, float(lift) - rest)
            if best is None or least > best[1]:
                best = frames, least
            if least >= 0.0:
                break
        assert best is not None
        return best

    def _turning(
        self, turn: Tensor, first: Tensor, last: Tensor, middle: Tensor, shares: Tensor
    ) -> Frames:
        """The sticks opened or closed around `middle`, which stays between their tips."""
        angle = first + shares * (last - first)
        turns = turn.expand(len(shares), 4)
        place = self._jaws.placed(rotations.to_matrix(turns), angle, middle.expand(len(shares), 3))
        return Frames(place, turns, angle)

    def _release(self, turn: Tensor, closed: Tensor, middle: Tensor, shares: Tensor) -> Frames:
        """The lower stick stays while the upper one opens (thesis, section 5.6.2); then both go aside, so that
        neither touches what they leave. An upper one that lags behind does not push it on the way."""
        angle = self._opened(closed, shares)
        matrix, least = rotations.to_matrix(turn), torch.full_like(closed, self._least)
        stays = self._jaws.placed(matrix, closed, middle)
        aside = self._jaws.placed(matrix, least, middle) - stays
        steps = torch.linspace(0.0, 1.0, round(ASIDE / DT) + 1, dtype=torch.float64)[1:, None]
        place = torch.cat([stays.expand(len(shares), 3), stays + steps * aside])
        open_ = least.expand(len(steps))
        return Frames(place, turn.expand(len(place), 4), torch.cat([angle, open_]))

    def _opened(self, angle: Tensor, share: Tensor) -> Tensor:
        """(n,) rad: by the shares `share` (n,) of the way open from `angle`."""
        return self._least + (angle - self._least) * (1.0 - share)

    def _away(self, now: Moment) -> Frames:
        """From `now`: at rest, then open and up."""
        up = torch.linspace(0.0, 1.0, round(LIFTING / DT) + 1, dtype=torch.float64)
        share = torch.cat([torch.zeros(round(WAITING / DT), dtype=torch.float64), up[1:]])
        place = now.lower[:3] + share[:, None] * now.lower.new_tensor([0.0, 0.0, LIFT])
        return Frames(place, now.lower[3:].expand(len(share), 4), self._opened(now.angle, share))

    def _height(self, pose: Pose) -> Tensor:
        centre, _ = self._jaws.tips(pose.angle)
        return pose.place[2] + rotations.to_matrix(pose.turn)[2] @ centre

    def _swing(self, turn: Tensor, closed: Tensor, thrown: Throw) -> tuple[Frames, Frames]:
        """The sticks until they let go, and from then on until the object lands: they open and stop."""
        count = round(max(STOP, thrown.seconds) / DT)
        times = DT * torch.arange(1, round(SWING / DT) + count + 1, dtype=torch.float64)
        opened = ((times - SWING) / OPENING).clamp(0.0, 1.0)
        middle, angle = thrown.swing(times), self._opened(closed, opened)
        turns = turn.expand(len(times), 4)
        place = self._jaws.placed(rotations.to_matrix(turns), angle, middle)
        return tuple(  # type: ignore[return-value]
            Frames(place[part], turns[part], angle[part])
            for part in (slice(None, -count), slice(-count, None))
        )

    def _arms(self, now: Moment, palm: Tensor, hand: Tensor, phase: Tensor) -> Tensor:
        """(T, 7) rad: the swivel goes evenly from where it is to the best end of the approach, and from there
        to that of the relocation."""
        swivel = arm.swivel_of(now.arm)
        poses: list[Tensor] = []
        before = now.arm
        for moving, still in ((0, 1), (2, 3)):
            rows = (phase == moving) | (phase == still)
            count, moved = int(rows.sum()), int((phase == moving).sum())
            shares = torch.linspace(0.0, 1.0, moved + 1, dtype=torch.float64)[1:]
            shares = torch.cat([shares, torch.ones(count - moved, dtype=torch.float64)])
            ends = torch.cat([SWIVELS, swivel[None]])
            path = swivel + shares[:, None] * (ends - swivel)
            solved = arm.solve(palm[rows][:, None], hand[rows][:, None], path)
            inside = solved.inside.amin(0)
            steps = torch.diff(torch.cat([before.expand(1, len(ends), 7), solved.pose]), dim=0)
            fast = steps.abs().amax((0, 2))
            wrist = solved.pose[-1, :, 4:6].square().sum(-1)
            cost = (solved.pose[-1] - before).square().sum(-1) + 0.1 * wrist
            ok = (inside >= 0.2 * INSIDE) & (fast <= STEP)
            if not ok.any():
                raise NoPlan(
                    f"No plan reaches the goal: in the phase '{PHASES[moving]}' the arm cannot follow the sticks. "
                    "Choose another goal."
                )
            best = int(torch.where(ok, cost, torch.inf).argmin())
            poses.append(solved.pose[:, best])
            swivel, before = ends[best], solved.pose[-1, best]
        return torch.cat(poses)


def _refuse_what_is_no_number(asked: _Asked) -> None:
    """NaN passes for neither near nor far, and infinity for both."""
    error = () if asked.error is None else (asked.error,)
    known = (
        asked.start, asked.goal, asked.heading, asked.last, *_fields(asked.others), asked.now.lower, asked.now.angle,
        asked.now.arm, *error,
    )  # fmt: skip
    if not all(bool(value.isfinite().all()) for value in known):
        raise NoPlan(
            "No plan reaches the goal: where an object or the arm is, or is to be, has no finite number. Give m and rad."
        )


def _refuse_beside_the_table(task: Task) -> None:
    for what, place in (("the object", task.start), ("its goal", task.goal)):
        beyond = max(
            abs(at - middle) - half
            for at, middle, half in zip(place, TABLE_CENTRE, TABLE_SIZE, strict=False)
        )
        if beyond > 0.0:
            ends = [(m - h, m + h) for m, h in zip(TABLE_CENTRE, TABLE_SIZE, strict=True)]
            (a, b), (c, d) = ends[:2]
            raise NoPlan(
                f"No plan reaches the goal: {what} at ({place[0]:g}, {place[1]:g}) m is {1e3 * beyond:.1f} mm beside the table, which "
                f"is from {a:g} to {b:g} m along x and from {c:g} to {d:g} m along y. Choose a place on it."
            )


def _joined(*parts: Frames) -> Frames:
    return Frames(*(torch.cat([getattr(part, name) for part in parts]) for name in _FRAMES))


def _united(*several: Things) -> Things:
    return Things(*(torch.cat(parts) for parts in zip(*map(_fields, several), strict=True)))


def _fields(things: Things) -> tuple[Tensor, ...]:
    return things.places, things.turns, things.sizes, things.rounding


def _quaternion(matrix: Tensor) -> Tensor:
    """(4,) of a rotation matrix (3, 3)."""
    found = np.zeros(4)
    mujoco.mju_mat2Quat(found, matrix.numpy().ravel())
    return torch.from_numpy(found)
