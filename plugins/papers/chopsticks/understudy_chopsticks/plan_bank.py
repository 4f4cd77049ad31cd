"""Plans as goals: a bank of them on the device (thesis, sections 5.4.2 and 5.6).

P plans of T frames of 10 ms each; one holds L relocations, one after another. A plan is replaced in its row, from the planner.
N worlds; m, rad, s.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from understudy import random
from understudy.errors import ConfigError
from understudy.task import Context, State
from understudy_chopsticks.held_grip import Gripping
from understudy_chopsticks.plan import gripping
from understudy_hand.tools import mujoco_sizes
from understudy_tensors import rotations
from understudy_tool_planner import objects
from understudy_tool_planner.configuration import NoPlan
from understudy_tool_planner.planner import DT, PHASES, PRESSING, Plan, Planner
from understudy_tool_planner.tasks import APART, Table, random_goal, random_shape

#: Numbers of a plan's frame: the arm, the angle between the sticks, the object's pose, whether it is held, which
#: relocation it is of, and 1 in that one's last frame.
_FRAME = 7 + 1 + 7 + 1 + 1 + 1
OBJECT, HELD, LEG, LAST = slice(8, 15), 15, 16, 17
#: s between two relocations, in which the object comes to rest.
RESTING = 0.3
#: m: where throws go to, x and y: the table's far side.
_FAR = ((-0.1, 0.1), (0.2, 0.3))
#: Goals that are tried for a plan.
_TRIES = 20
#: Relocations in an episode, at most.
MOST = 8
#: s that a plan made anew may take longer; m that an object that lies on the table may be off its height.
LONGER, ON_TABLE = 3.0, 0.003
#: m: how much further along a tool may be held, either way; the fingers are then near its end.
FARTHEST = 0.06
#: s in which a plan that has failed slows down by 1 / e.
SLOWING = 0.1
#: Of a plan that has not drawn its object yet.
_SOME = objects.Shape("sphere", (0.01,))


class Bank:
    """P plans on the device."""

    def __init__(self, made: Gripping, context: Context) -> None:
        thing = made.scene.options.object
        if thing is None:
            raise ConfigError(
                "Relocation needs an object on the table. Set scene.object, such as '{kind: sphere, sizes: [0.01]}'."
            )
        if len(made.grips) > 1:
            raise ConfigError(
                "Relocation takes one grip. Set grip.name, grip.file or grip.style, and no grip.candidates."
            )
        #: What every plan moves; None where each draws another.
        self._alike = None if thing.kind == "any" else objects.Shape(thing.kind, thing.sizes)
        self.scene, self.forms = made.scene, made.scene.forms
        below = made.scene.options.below
        #: What the object is put upon, and how high that is, m.
        self._below = objects.Shape(below.kind, below.sizes) if below is not None else None
        if self._below is not None and self._below.kind != "box":
            raise ConfigError(
                f"Nothing stays upon a {self._below.kind} (scene.below). Set it to a box, such as "
                "'{kind: box, sizes: [0.02, 0.02, 0.02]}'."
            )
        above = made.scene.options.above
        self._above = objects.Shape(above.kind, above.sizes) if above is not None else None
        if self._above is not None and thing.kind != "box":
            raise ConfigError(
                f"Nothing lies upon a {thing.kind} (scene.above). Set scene.object to a box, such as "
                "'{kind: box, sizes: [0.015, 0.015, 0.015]}'."
            )
        self._upon = 2.0 * self._below.height if self._below is not None else 0.0
        self._made = made
        self._device = context.device
        # An evaluation's plans are ones that no training follows.
        self._stream = f"plans/{'evaluation' if context.evaluating else 'training'}"
        self._seed, self._drawn = context.seed, 0
        self._relocations, self._noise, self._spare = 1, 0.0, 0
        self._thrown = self._elsewhere = False
        #: m: between which the tool is held further along its lower part.
        self._shift = (0.0, 0.0)
        #: Whether a relocation is planned only as it begins (:meth:`onward`), and how many were.
        self.one_by_one, self._onwards = False, 0
        #: Whether a plan that fails is made anew (:meth:`again`).
        self.anew = False
        self._missing: set[int] = set()
        self.frames = self.goals = self.lengths = self.shifts = torch.zeros(0)

    def fill(
        self,
        count: int,
        seconds: float,
        relocations: int,
        noise: float,
        later: bool = False,
        thrown: bool = False,
        settled: bool = False,
        shift: tuple[float, float] = (0.0, 0.0),
        pressing: float = PRESSING,
        elsewhere: bool = False,
        over: float = 0.0,
        slowly: float = 1.0,
    ) -> None:
        """Make it one of `count` plans of so many `relocations` of at most so many `seconds` each, whose sticks
        take and put with an error of `noise` m; `later`, each when it is first needed (:meth:`need`). `settled`, of a
        tool that is where it comes to rest in the hand; each held by a `shift` m further along, drawn evenly; the
        closed tool rests for `pressing` s before it lifts; with `elsewhere` it goes away before each relocation but the first. `over` and `slowly`
        as of :class:`~understudy_tool_planner.planner.Planner`."""
        if len(self.frames):
            return
        self._shift, made = shift, self._made
        at = made.lower[0].double().cpu() if settled or self.shifted else None
        self._planner = Planner(made.grips[0], made.scene, at, pressing, over, slowly)
        self._relocations, self._noise, self._thrown = relocations, noise, thrown
        self._elsewhere = elsewhere
        longest = relocations * seconds + (relocations - 1) * RESTING
        self._room = round(longest / DT) + 1
        self.frames = torch.zeros(count, self._room, _FRAME, device=self._device)
        #: (P, L, 3) m
        self.goals = torch.zeros(count, relocations, 3, device=self._device)
        #: (P,) int64: the last frame.
        self.lengths = torch.zeros(count, dtype=torch.int64, device=self._device)
        #: (P,) m: how much further along its lower part the tool is held.
        self.shifts = torch.zeros(count, device=self._device)
        self._along = [0.0] * count
        self._shapes = [self._alike or _SOME] * count
        #: (P,) int64 and (P, 3) m: number of the object's kind, and MuJoCo's sizes of it; and what is seen of both (P, 6).
        self.kinds = torch.zeros(count, dtype=torch.int64, device=self._device)
        self.sizes = torch.zeros(count, 3, device=self._device)
        self.seen = torch.zeros(count, 2 * len(objects.KINDS), device=self._device)
        for row, shape in enumerate(self._shapes):
            self.give(row, shape)
        #: (P, nq) as a plan of a tool that is held further along begins.
        self.starts = torch.zeros(
            count if self.shifted else 0, self._made.scene.model.nq, device=self._device
        )
        self._missing = set(range(count))
        if not later:
            self.need(range(count))
        self._extend()

    @property
    def shifted(self) -> bool:
        """Whether a tool is held further along anywhere."""
        return any(self._shift)

    def need(self, rows: Iterable[int]) -> None:
        """Make the plans `rows` that are not there yet; which they are depends on no other."""
        for row in self._missing.intersection(rows):
            self._drawn = row * _TRIES * MOST
            self.replace(row)
        self._missing.difference_update(rows)

    def slipped(self, place: Tensor) -> list[float]:
        """m: how much further along its lower part, now at `place` (N, 3) m in the palm's frame, the tool is held than in its grip."""
        lower = self._made.lower[0]
        axis = rotations.rotate(lower[3:], torch.eye(3, device=lower.device)[0])
        away = ((place - lower[:3]) @ axis).nan_to_num(0.0)  # of a world that went wrong
        return away.clamp(-FARTHEST, FARTHEST).tolist()

    def spare(self, count: int) -> None:
        """Keep so many rows more, which nobody draws, for plans that are made within episodes."""
        self._spare = count
        if len(self.frames):
            self._extend()

    def _extend(self) -> None:
        if not self._spare:
            return
        self.drawn = len(self.frames)
        count, longer = self._spare, self._room + round(LONGER / DT)
        frames = torch.zeros(self.drawn + count, longer, _FRAME, device=self._device)
        frames[: self.drawn] = self.frames[:, [*range(self._room), *[-1] * (longer - self._room)]]
        self.frames = frames
        self.goals = torch.cat([self.goals, self.goals[:1].repeat(count, 1, 1)])
        self.lengths = torch.cat([self.lengths, self.lengths[:1].repeat(count)])
        self.shifts = torch.cat([self.shifts, self.shifts[:1].repeat(count)])
        self._along += self._along[:1] * count
        self._shapes += self._shapes[:1] * count
        self.kinds = torch.cat([self.kinds, self.kinds[:1].repeat(count)])
        self.sizes = torch.cat([self.sizes, self.sizes[:1].repeat(count, 1)])
        self.seen = torch.cat([self.seen, self.seen[:1].repeat(count, 1)])

    def give(self, row: int, shape: objects.Shape) -> None:
        """Have the plan `row` move an object of this shape."""
        number = objects.KINDS.index(shape.kind)
        self._shapes[row], self.kinds[row] = shape, number
        self.sizes[row] = torch.tensor(mujoco_sizes(shape.kind, shape.sizes))
        one_of = [float(k == number) for k in range(len(objects.KINDS))]
        half = [size + shape.rounding for size in shape.half_sizes]
        self.seen[row] = torch.tensor([*one_of, *half])

    def replace(self, row: int) -> None:
        """Put a new plan into a row, in place."""
        if self._alike is None:
            stream = random.generator(self._seed, f"{self._stream}/shape/{self._drawn}")
            self.give(row, random_shape(stream))
        if self.shifted:
            self._hold_further(row)
        plans = self._plans(self._planner.shifted(self._along[row]), self._shapes[row])
        for leg, plan in enumerate(plans):
            self.goals[row, leg:] = plan.object[-1, :3].float().to(self._device)
        self._put(row, plans, 0)

    def _hold_further(self, row: int) -> None:
        """Draw how far along the tool is held in the plan `row`, and how arm and tool begin then."""
        (low, high), name = self._shift, f"{self._stream}/shift/{self._drawn}"
        share = float(torch.rand((), generator=random.generator(self._seed, name)))
        self._along[row] = self.shifts[row] = along = low + (high - low) * share
        arm = self._planner.shifted(along).start().arm.numpy()
        start = self._made.further(arm, along)
        self.starts[row] = torch.tensor(start, dtype=torch.float32, device=self._device)

    def again(
        self, row: int, world: int, frame: int, leg: int, place: Tensor, turn: Tensor, along: float
    ) -> int | None:
        """The row of `world` itself with the plan `row` made anew at its frame `frame`, from the relocation number `leg` on, without
        noise: from where the arm is planned then, the tool is held (`along` m further), and the object is, at `place` (3,) m turned by
        `turn` (4,). None where there is no such plan, or something lay upon the object, which may have fallen.
        """
        frame = min(frame, int(self.lengths[row]))
        here = self.frames[row, frame].double().cpu()
        planner = self._planner.shifted(along)
        now = replace(planner.begin(tuple(here[:7].tolist())), angle=here[7])
        shape = self._shapes[row]
        if abs(float(place[2]) - shape.height) > ON_TABLE or self._above is not None:
            return None
        known = leg + 1 if self.one_by_one else self._relocations
        goals = [(float(x), float(y)) for x, y in self.goals[row, leg:known, :2]]
        start, heading = (float(place[0]), float(place[1])), float(rotations.heading(turn))
        plans: list[Plan] = []
        try:
            for k, goal in enumerate(goals):
                table = self._table(shape, start, heading, goal)
                task = table.task(0, goal, self._upon)
                plan = planner.plan(task, now, table.without(0), anew=k == 0)
                plans.append(plan)
                now, heading = plan.end, float(rotations.heading(plan.object[-1, 3:]))
                start = goal
        except NoPlan:
            return None
        own = self.drawn + world
        self._copy(row, own, along)
        for k, plan in enumerate(plans, leg):  # as high as this object lies
            self.goals[own, k:] = plan.object[-1, :3].float().to(self._device)
        return own if self._put(own, plans, leg) else None

    def onward(
        self, row: int, world: int, frame: int, leg: int, place: Tensor, turn: Tensor, along: float
    ) -> int | None:
        """The row of `world` itself with the relocation number `leg`, which begins with the frame `frame` of the plan `row`: from where the arm is planned
        then, the tool is held (`along` m further), and the object lies, to a goal that is drawn now. None where there is no such plan.
        """
        for number in range(_TRIES):
            name = f"{self._stream}/onward/{self._onwards}/{number}"
            empty = Table((self._shapes[row],), ((9.0, 9.0),), (0.0,))
            goal = random_goal(empty, 0, random.generator(self._seed, name))
            try:
                found = self.toward(row, world, frame, leg, place, turn, goal, along)
            except NoPlan:
                continue
            self._onwards += 1
            return found
        return None

    def toward(
        self,
        row: int,
        world: int,
        frame: int,
        leg: int,
        place: Tensor,
        turn: Tensor,
        goal: tuple[float, float],
        along: float,
        anew: bool = False,
    ) -> int:
        """The row of `world` itself with a plan to `goal` m, its relocation number `leg`: from where the arm is in the plan `row` at its frame `frame`, the tool is
        held (`along` m further), and the object lies; `anew` where something has failed, or where the tool that let go of the object still
        touches it: then it opens and goes up first.

        Raises
        ------
        NoPlan
            there is none.
        """
        frame = min(frame, int(self.lengths[row]))
        here = self.frames[row, frame].double().cpu()
        shape = self._shapes[row]
        if abs(float(place[2]) - shape.height) > ON_TABLE:
            raise NoPlan("No plan reaches the goal: the object does not lie on the table.")
        if self._above is not None:
            raise NoPlan("No plan reaches the goal: what lay upon the object may be in the way.")
        if self._below is not None:
            raise NoPlan("No plan reaches the goal: what the object is put upon may be in the way.")
        start, heading = (float(place[0]), float(place[1])), float(rotations.heading(turn))
        planner = self._planner.shifted(along)
        now = replace(planner.begin(tuple(here[:7].tolist())), angle=here[7])
        table = Table((shape,), (start,), (heading,))
        task, rest = table.task(0, goal), table.without(0)
        try:
            plan = planner.plan(task, now, rest, anew=anew)
        except NoPlan as refused:
            if anew:
                raise
            try:
                plan = planner.plan(task, now, rest, anew=True)
            except NoPlan:
                raise refused from None
        own = self.drawn + world
        if not self._put(own, [plan], leg):
            raise NoPlan("No plan reaches the goal in time. Choose another goal.")
        self._copy(row, own, along)
        self.goals[own, leg:] = plan.object[-1, :3].float().to(self._device)
        return own

    def _copy(self, row: int, own: int, along: float) -> None:
        """What a plan that is made anew has of the plan `row` before it, with the tool held `along` m further."""
        self.goals[own] = self.goals[row].clone()
        self._along[own] = self.shifts[own] = along
        self.give(own, self._shapes[row])

    def way(self, row: int) -> np.ndarray:
        """(T, 3) m: where the object is in the plan `row`."""
        return self.frames[row, : int(self.lengths[row]) + 1, OBJECT][:, :3].cpu().numpy()

    def _put(self, row: int, plans: list[Plan], first: int) -> bool:
        """Write the frames of `plans`, whose first is the relocation number `first`; whether they had room. Where
        others follow that are not planned yet, a frame of the next one is the last."""
        parts = [self._leg(plan, leg) for leg, plan in enumerate(plans, first)]
        if first + len(plans) < self._relocations:
            parts.append(parts[-1][-1:].clone())
            parts[-1][:, LEG], parts[-1][:, LAST] = first + len(plans), 0.0
        frames = torch.cat(parts)
        if len(frames) > self.frames.shape[1]:
            return False
        frames = frames.to(self._device)
        self.frames[row, : len(frames)] = frames
        self.frames[row, len(frames) :] = frames[-1]
        self.lengths[row] = len(frames) - 1
        return True

    def _leg(self, plan: Plan, leg: int) -> Tensor:
        """(T, _FRAME) of `plan`, the relocation number `leg`, with the rest after it."""
        held = (plan.phase == PHASES.index("close")) | (plan.phase == PHASES.index("relocate"))
        count = len(plan.angle)
        which, last = torch.full((count, 1), float(leg)), torch.zeros(count, 1)
        frames = torch.cat(
            [plan.arm, plan.angle[:, None], plan.object, held[:, None], which, last], dim=1
        ).float()
        if leg + 1 < self._relocations:
            frames = torch.cat([frames, frames[-1:].repeat(round(RESTING / DT), 1)])
        frames[-1, LAST] = 1.0
        return frames

    def _table(
        self,
        shape: objects.Shape,
        start: tuple[float, float],
        heading: float,
        goal: tuple[float, float],
    ) -> Table:
        """The object, and at its goal what it is put upon."""
        if self._below is None:
            return Table((shape,), (start,), (heading,))
        return Table((shape, self._below), (start, goal), (heading, 0.0))

    def _plans(self, planner: Planner, shape: objects.Shape) -> list[Plan]:
        """Of the next relocations, each from where the last one ended."""
        plans: list[Plan] = []
        for _ in range(1 if self.one_by_one else self._relocations):
            plans.append(self._plan(planner, shape, plans[-1] if plans else None))
        return plans

    def _plan(self, planner: Planner, shape: objects.Shape, before: Plan | None) -> Plan:
        """The next plan of a stream of random starts and goals; of those that there is none for, none."""
        # not of the frames, which are more where there are plans made anew
        room = self._room - (self._relocations - 1) * round(RESTING / DT)
        room //= self._relocations
        why = f"they last longer than {DT * room:g} s (initial_states.longest)"
        for _ in range(_TRIES):
            self._drawn += 1
            stream = random.generator(self._seed, f"{self._stream}/{self._drawn}")
            empty = Table((shape,), ((9.0, 9.0),), (0.0,))
            start, goal = (random_goal(empty, 0, stream) for _ in range(2))
            if self._thrown:
                share = torch.rand(2, generator=stream).tolist()
                goal = tuple(
                    low + (high - low) * s for (low, high), s in zip(_FAR, share, strict=True)
                )
            if (by := self._below or self._above) is not None:
                apart = shape.reach + by.reach + APART
                if math.dist(start, goal) < apart:
                    continue
            heading = _heading(shape, stream)
            error = self._noise * torch.randn(3, generator=stream, dtype=torch.float64)
            now = planner.start()
            if before is not None:
                now, (x, y) = before.end, before.object[-1, :2].tolist()
                start, heading = (x, y), float(rotations.heading(before.object[-1, 3:]))
            table = self._table(shape, start, heading, goal)
            try:
                task = table.task(0, goal, self._upon)
                task = replace(task, above=self._above, thrown=self._thrown)
                way = None
                if self._elsewhere and before is not None:
                    way = self._to_another(planner, shape, before, stream)
                    now = way.end
                plan = planner.plan(task, now, table.without(0), error)
            except NoPlan as failed:
                why = str(failed)
                continue
            if way is not None:
                plan = plan.after(way)
            if len(plan.angle) <= room:
                return plan
        raise ConfigError(f"None of {_TRIES} tasks drawn in a row has a plan: {why}")

    def _to_another(
        self, planner: Planner, shape: objects.Shape, before: Plan, stream: torch.Generator
    ) -> Plan:
        """From where the plan `before` ends to where the tool would take another object like this one, elsewhere on the table."""
        lies = before.object[-1]
        at = (float(lies[0]), float(lies[1]))
        headings = (_heading(shape, stream), float(rotations.heading(lies[3:])))
        table = Table((shape, shape), ((9.0, 9.0), at), headings)
        table = table.moved(0, random_goal(table, 0, stream))
        task = table.task(0, random_goal(table, 0, stream))
        return planner.plan(task, before.end, table.without(0)).approach(lies)

    def at(self, row: Tensor, frame: Tensor) -> Tensor:
        """(N, …, _FRAME) of the plans `row` (N,) at the frames `frame` (N, …), the last one after their end;
        of a world whose numbers went wrong those of some plan."""
        row, frame = row.clamp(0, len(self.lengths) - 1), frame.clamp(min=0)
        own = row.view(-1, *[1] * (frame.dim() - 1)).expand_as(frame)
        return self.frames[own, torch.minimum(frame, self.lengths[own])]

    def state_dict(self) -> State:
        return {
            "frames": self.frames, "goals": self.goals, "lengths": self.lengths, "drawn": self._drawn,
            **({"shifts": self.shifts, "starts": self.starts} if self.shifted else {}),
            **({"shapes": self._of_shapes()} if self._alike is None else {}),
        }  # fmt: skip

    def _of_shapes(self) -> Tensor:
        """(P, 4) float64: number of the kind, and the sizes that it has, m."""
        rows = [[objects.KINDS.index(s.kind), *s.sizes, 0.0, 0.0][:4] for s in self._shapes]
        return torch.tensor(rows, dtype=torch.float64)

    def load_state_dict(self, state: State) -> None:
        for name in self.state_dict().keys() - {"drawn", "shapes"}:
            getattr(self, name).copy_(state[name])
        self._along = self.shifts.tolist()
        for row, (kind, *sizes) in enumerate(state.get("shapes", torch.zeros(0, 4)).tolist()):
            name = objects.KINDS[int(kind)]
            self.give(row, objects.Shape(name, tuple(sizes[: objects.COUNTS[name]])))
        self._drawn = int(state["drawn"])
        if self._drawn < 0:
            raise ValueError(f"'drawn' cannot be {self._drawn}")


def _heading(shape: objects.Shape, stream: torch.Generator) -> float:
    """rad: how an object is turned where it lies, drawn from a stream."""
    most = 0.25 if shape.kind == "capsule" else 0.5
    return most * float(torch.rand((), generator=stream)) * np.pi


def bank_of(context: Context, who: str) -> tuple[Gripping, Bank]:
    """The task's, which initial states fill."""
    made = gripping(context, who)
    return made, context.once("plans", lambda: Bank(made, context))
