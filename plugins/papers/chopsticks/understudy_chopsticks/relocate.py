"""Relocation: plans as goals. Each world follows a plan of its own (thesis, sections 5.4.2 and 5.6).

Plans lie in a bank on the device, P of them, T frames of 10 ms each; one holds L relocations, one after another. A world draws one as its episode begins, and
the bank is refilled from the planner while others run: a row that is about to be replaced is no longer drawn, and
gets its new plan once no world follows the old one. N worlds, U hinges;
m, rad, s.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from understudy import random
from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, Fields, InitialStates, Rollout, Shape, State
from understudy.task.terms import ranges
from understudy_chopsticks.plan import AHEAD, PLANNED, Gripping, gripping, planned
from understudy_hand.table import ARM_POSE
from understudy_hand.tools import mujoco_sizes
from understudy_tensors import rotations
from understudy_tool_planner import objects
from understudy_tool_planner.configuration import NoPlan
from understudy_tool_planner.planner import (
    ASIDE,
    CLOSING,
    DT,
    LEAST,
    PHASES,
    PRESSING,
    Plan,
    Planner,
)
from understudy_tool_planner.tasks import APART, Table, random_goal, random_shape

#: Numbers of a plan's frame: the arm, the angle between the sticks, the object's pose, whether it is held, which
#: relocation it is of, and 1 in that one's last frame.
_FRAME = 7 + 1 + 7 + 1 + 1 + 1
_OBJECT, _HELD, _LEG, _LAST = slice(8, 15), 15, 16, 17
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
        self._thrown = False
        #: m: between which the tool is held further along its lower part.
        self._shift = (0.0, 0.0)
        #: Whether a relocation is planned only as it begins (:meth:`onward`), and how many were.
        self.one_by_one, self._onwards = False, 0
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
    ) -> None:
        """Make it one of `count` plans of so many `relocations` of at most so many `seconds` each, whose sticks
        take and put with an error of `noise` m; `later`, each when it is first needed (:meth:`need`). `settled`, of a
        tool that is where it comes to rest in the hand; each held by a `shift` m further along, drawn evenly; the
        closed tool rests for `pressing` s before it lifts."""
        if len(self.frames):
            return
        self._shift, made = shift, self._made
        at = made.lower[0].double().cpu() if settled or self.shifted else None
        self._planner = Planner(made.grips[0], made.scene, at, pressing)
        self._relocations, self._noise, self._thrown = relocations, noise, thrown
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
        self, row: int, world: int, frame: int, place: Tensor, turn: Tensor, along: float
    ) -> int | None:
        """The row of `world` itself with the plan `row` made anew at its frame `frame`, without noise: from where the arm is planned
        then, the tool is held (`along` m further), and the object is, at `place` (3,) m turned by `turn` (4,). None where there is no
        such plan.
        """
        frame = min(frame, int(self.lengths[row]))
        here = self.frames[row, frame].double().cpu()
        leg = int(here[_LEG])
        planner = self._planner.shifted(along)
        now = replace(planner.begin(tuple(here[:7].tolist())), angle=here[7])
        shape = self._shapes[row]
        if abs(float(place[2]) - shape.height) > ON_TABLE:
            return None
        known = leg + 1 if self.one_by_one else self._relocations
        goals = [(float(x), float(y)) for x, y in self.goals[row, leg:known, :2]]
        start, heading = (float(place[0]), float(place[1])), float(rotations.heading(turn))
        plans: list[Plan] = []
        try:
            for k, goal in enumerate(goals):
                table = Table((shape,), (start,), (heading,))
                plan = planner.plan(table.task(0, goal), now, table.without(0), anew=k == 0)
                plans.append(plan)
                now, heading = plan.end, float(rotations.heading(plan.object[-1, 3:]))
                start = goal
        except NoPlan:
            return None
        own = self.drawn + world
        self._copy(row, own, along)
        return own if self._put(own, plans, leg) else None

    def onward(
        self, row: int, world: int, frame: int, place: Tensor, turn: Tensor, along: float
    ) -> int | None:
        """The row of `world` itself with the relocation that begins with the frame `frame` of the plan `row`: from where the arm is planned
        then, the tool is held (`along` m further), and the object lies, to a goal that is drawn now. None where there is no such plan.
        """
        for number in range(_TRIES):
            name = f"{self._stream}/onward/{self._onwards}/{number}"
            empty = Table((self._shapes[row],), ((9.0, 9.0),), (0.0,))
            goal = random_goal(empty, 0, random.generator(self._seed, name))
            try:
                found = self.toward(row, world, frame, place, turn, goal, along)
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
        place: Tensor,
        turn: Tensor,
        goal: tuple[float, float],
        along: float,
        anew: bool = False,
    ) -> int:
        """The row of `world` itself with a plan to `goal` m: from where the arm is in the plan `row` at its frame `frame`, the tool is
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
        own, leg = self.drawn + world, int(here[_LEG])
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
        return self.frames[row, : int(self.lengths[row]) + 1, _OBJECT][:, :3].cpu().numpy()

    def _put(self, row: int, plans: list[Plan], first: int) -> bool:
        """Write the frames of `plans`, whose first is the relocation number `first`; whether they had room. Where
        others follow that are not planned yet, a frame of the next one is the last."""
        parts = [self._leg(plan, leg) for leg, plan in enumerate(plans, first)]
        if first + len(plans) < self._relocations:
            parts.append(parts[-1][-1:].clone())
            parts[-1][:, _LEG], parts[-1][:, _LAST] = first + len(plans), 0.0
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
        frames[-1, _LAST] = 1.0
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
        room = self.frames.shape[1] - (self._relocations - 1) * round(RESTING / DT)
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
            most = 0.25 if shape.kind == "capsule" else 0.5
            heading = most * float(torch.rand((), generator=stream)) * np.pi
            error = self._noise * torch.randn(3, generator=stream, dtype=torch.float64)
            now = planner.start()
            if before is not None:
                now, (x, y) = before.end, before.object[-1, :2].tolist()
                start, heading = (x, y), float(rotations.heading(before.object[-1, 3:]))
            table = self._table(shape, start, heading, goal)
            try:
                task = table.task(0, goal, self._upon)
                task = replace(task, above=self._above, thrown=self._thrown)
                plan = planner.plan(task, now, table.without(0), error)
            except NoPlan as failed:
                why = str(failed)
                continue
            if len(plan.angle) <= room:
                return plan
        raise ConfigError(f"None of {_TRIES} tasks drawn in a row has a plan: {why}")

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


def bank_of(context: Context, who: str) -> tuple[Gripping, Bank]:
    """The task's, which initial states fill."""
    made = gripping(context, who)
    return made, context.once("plans", lambda: Bank(made, context))


class Relocations(InitialStates):
    """The sticks in the hand, open, and the object at the start of a plan that each world draws; in an evaluation each from
    a share of the bank of its own.

    ``plan_row`` () is its number in the bank; ``plan_goal`` (3,) m, where the object is to be put in the end.
    """

    rollout_fields = ("plan_row",)
    episode_fields: Mapping[str, Shape] = {"plan_row": (), "plan_goal": (3,)}

    @dataclass(frozen=True)
    class Options:
        plans: int = (
            4  #: in the bank; the thesis has 100 tasks of eight objects, a GPU 256 plans here
        )
        refill: int = 1  #: plans that are made anew in an iteration (some 0.1 s of a core each); 0 keeps the first ones
        longest: float = 3.0  #: s: relocations that take longer are not followed
        relocations: int = 1  #: of the object, one after another in a plan; figure 5.21 has eight
        #: m: standard deviation of a plan's error in where the sticks take and put (section 5.7.5 has 0.003)
        noise: float = 0.0
        thrown: bool = (
            False  #: whether the object is thrown, to the table's far side (section 5.7.2)
        )
        #: whether plans count on the tool where it comes to rest in the hand, and not where its grip was found for
        settled: bool = False
        #: m: how much further along its lower part the tool is held, drawn evenly for each plan; beyond 0 the hand is nearer
        #: to the tips (section 5.7.2 has -0.05 to 0.05)
        shift: tuple[float, float] = (0.0, 0.0)
        #: s that the closed tool rests before it lifts (the release has 0.05); a box is held firmly only after some 0.3
        pressing: float = PRESSING
        #: how much more often plans are drawn that go badly: with exp(-harder r), r the mean reward of a decision that follows one
        #: (the release has 1); 0 draws evenly
        harder: float = 0.0

        def __post_init__(self) -> None:
            check_range(self, "harder", least=0, most=100.0)
            check_range(self, "plans", least=1, most=100_000)
            check_range(self, "refill", least=0, most=100_000)
            check_range(self, "relocations", least=1, most=MOST)
            check_range(self, "noise", least=0, most=0.05)
            if self.thrown and self.relocations > 1:
                raise ValueError(
                    f"relocations={self.relocations} of what is thrown are not possible: it lands out of reach."
                )
            check_range(self, "pressing", least=0, most=1.0)
            least = round(2 * (LEAST + CLOSING) + self.pressing + ASIDE, 6)
            check_range(self, "longest", least=least, most=60.0)
            low, high = self.shift
            if not -FARTHEST <= low <= high <= FARTHEST:
                raise ValueError(
                    f"shift={[low, high]} is not possible: the first is the lower one, and both are from {-FARTHEST:g} to "
                    f"{FARTHEST:g} m."
                )
            if self.refill >= self.plans:
                raise ValueError(
                    f"refill={self.refill} with plans={self.plans} is not possible: some have to stay."
                )

    def __init__(self, options: Options, context: Context) -> None:
        made, self.bank = bank_of(context, "initial_states 'chopsticks/relocations'")
        self.pressing = options.pressing  #: s
        self._evaluating = context.evaluating
        self._refill = 0 if context.evaluating else options.refill
        if made.scene.options.below is not None and options.relocations > 1:
            raise ConfigError(
                f"initial_states.relocations={options.relocations} is not possible with scene.below: what is put upon "
                "another stays there. Set one of them alone."
            )
        if options.thrown and (made.scene.options.below or made.scene.options.above):
            raise ConfigError(
                "initial_states.thrown=true takes one object alone. Leave out scene.below and scene.above."
            )
        # A GPU captures the step in which episodes begin, so its bank has to be whole before.
        self._later = context.evaluating and context.device.type == "cpu"
        self.bank.fill(
            options.plans, options.longest, options.relocations, options.noise, self._later,
            options.thrown, options.settled, options.shift, options.pressing,
        )  # fmt: skip
        device, model = context.device, made.scene.model
        start = torch.tensor(made.begin(np.array(ARM_POSE))[0], dtype=torch.float32, device=device)
        self._start, self._velocity = start, torch.zeros(model.nv, device=device)
        self._at = int(model.joint("object").qposadr[0])
        below = made.scene.options.below
        self._under = None if below is None else int(model.joint("below").qposadr[0])
        self._height = 0.0 if below is None else below.height
        above = made.scene.options.above
        self._over = None if above is None else int(model.joint("above").qposadr[0])
        if above is not None and made.scene.options.object is not None:
            self._up = made.scene.options.object.height + above.height
        if self.bank.forms is not None:
            self.varies = self.bank.forms.varies
        #: Rows that may be drawn, then those that wait to be replaced.
        self._order = torch.arange(options.plans, device=device)
        self._waiting: list[int] = []
        self._next = 0
        self._harder = 0.0 if context.evaluating else options.harder
        #: (P,) mean reward of the decisions that followed each plan; 0 of one that nobody followed yet.
        self._going = torch.zeros(options.plans, device=device)

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        free = len(self._order) - self._refill
        share = streams.uniform(1)[:, 0]
        if self._evaluating:  # no two worlds the same plan, where there are as many: episodes that repeat tell nothing
            share = (torch.arange(len(share), device=share.device) + share) / len(share)
        if self._harder:
            weight = torch.exp(-self._harder * self._going[self._order[:free]]).cumsum(0)
            place = torch.searchsorted(weight, share * weight[-1], right=True)
        else:
            place = (share * free).long()
        place = place.clamp(max=free - 1)
        row = self._order[place]
        if self._later:
            self.bank.need(row.unique().tolist())
        thing = self.bank.frames[row, 0, _OBJECT]
        further = self.bank.shifted
        qpos = self.bank.starts[row] if further else self._start.repeat(len(row), 1)
        qpos[:, self._at : self._at + 7] = thing
        if self._under is not None:
            qpos[:, self._under : self._under + 2] = self.bank.goals[row, 0, :2]
            qpos[:, self._under + 2] = self._height
        if self._over is not None:
            qpos[:, self._over : self._over + 7] = thing
            qpos[:, self._over + 2] += self._up
        forms, bank = self.bank.forms, self.bank
        of_forms = {} if forms is None else forms.values(bank.kinds[row], bank.sizes[row])
        return {
            **of_forms,
            "qpos": qpos,
            "qvel": self._velocity.expand(len(row), -1),
            "plan_row": row.float(),
            "plan_goal": self.bank.goals[row, -1],
        }

    def _learn(self, rollout: Rollout) -> None:
        """How well plans go, of those that the rollout follows."""
        row, zero = rollout.fields["plan_row"].long().flatten(), torch.zeros_like(self._going)
        total = zero.index_add(0, row, rollout.rewards.flatten())
        count = zero.index_add(0, row, torch.ones_like(rollout.rewards).flatten())
        self._going.copy_(torch.where(count > 0, total / count.clamp(min=1), self._going))

    def update(self, rollout: Rollout) -> dict[str, float]:
        if self._harder:
            self._learn(rollout)
        if not self._refill:
            return {}
        # What waited through the whole rollout was not drawn in it, so its last step has all that follow it.
        followed = set(rollout.fields["plan_row"][-1].long().unique().tolist())
        done = [row for row in self._waiting if row not in followed]
        for row in done:
            self.bank.replace(row)
            self._going[row] = 0.0
        self._waiting = [row for row in self._waiting if row not in done]
        count = len(self._order)
        while len(self._waiting) < self._refill:
            self._waiting.append(self._next)
            self._next = (self._next + 1) % count
        rest = [row for row in range(count) if row not in self._waiting]
        self._order.copy_(torch.tensor([*rest, *self._waiting]))
        return {"new_plans": float(len(done))}

    def state_dict(self) -> State:
        return {
            "bank": self.bank.state_dict(), "order": self._order, "waiting": list(self._waiting),
            "next": self._next, **({"going": self._going} if self._harder else {}),
        }  # fmt: skip

    def load_state_dict(self, state: State) -> None:
        self.bank.load_state_dict(state["bank"])
        self._order.copy_(state["order"])
        if "going" in state:
            self._going.copy_(state["going"])
        self._waiting, self._next = [int(row) for row in state["waiting"]], int(state["next"])


class Follow(Fields):
    """The plan that each world follows, at its time: what ``chopsticks/plan`` gives, and the object.

    - ``plan_time`` () s, since the plan began, and ``plan_lasts`` () s, how long it is
    - ``planned_object`` (7,): where the object shall be, in the world; ``planned_held`` () 1 while the sticks hold it
    - ``planned_goal`` (3,) m, of the relocation that is on; ``planned_leg`` () its number, from 0; ``leg_over`` () 1
      in its last frame
    - ``object_shape`` (6,): 1 for its kind of sphere, capsule and box, and half of its extent along each of its axes, m
    - ``object_ahead`` (6, 7): where it shall be every 0.05 s of the next 0.3 s, in the frame of the palm as it is
    """

    reads = (
        "followed", "plan_since", "plan_stopped", "stopped_since", "episode_time", "xpos", "xquat",
    )  # fmt: skip
    provides: Mapping[str, Shape] = {
        **PLANNED,
        "plan_time": (),
        "plan_lasts": (),
        "planned_object": (7,),
        "planned_held": (),
        "planned_goal": (3,),
        "planned_leg": (),
        "leg_over": (),
        "object_shape": (2 * len(objects.KINDS),),
        "object_ahead": (len(AHEAD), 7),
    }

    @dataclass(frozen=True)
    class Options:
        #: rad that the sticks' targets close further while they hold the object, so that they press on it: by
        #: friction sticks close a good half of what their targets do
        squeeze: float = 0.12
        #: s by which the arm's targets go ahead of the plan at its speed; null is the servos' own lag, kd / kp
        lead: float | None = None
        #: Whether arm, hand and sticks have a plan; without one they stay as they begin, and only where the object shall
        #: be in the end is known (figure 5.22)
        planner: bool = True

        def __post_init__(self) -> None:
            check_range(self, "squeeze", least=0, most=0.2)
            check_range(self, "lead", least=0, most=1.0)

    def __init__(self, options: Options, context: Context) -> None:
        self._gripping, self._bank = bank_of(context, "fields 'chopsticks/follow'")
        hinges = self._gripping.scene.hinges
        self.provides = {**self.provides, **planned(hinges)}
        self._plans = options.planner
        axis = torch.tensor([1.0, 0.0, 0.0], device=context.device)
        self._axis = rotations.rotate(
            self._gripping.lower[:, 3:], axis.expand(len(self._gripping.lower), 3)
        )
        self._squeeze = options.squeeze
        model, arm = self._gripping.scene.model, len(ARM_POSE)
        # A servo whose velocity target is 0 lags by kd / kp: 25 mm at 0.25 m/s. The release's have the plan's.
        lag = -model.actuator_biasprm[:arm, 2] / model.actuator_gainprm[:arm, 0]
        lead = lag if options.lead is None else np.full(arm, options.lead)
        self._lead = torch.tensor(lead, dtype=torch.float32, device=context.device)
        steps = [round(t / DT) for t in AHEAD]
        self._steps = torch.tensor([0, *steps], device=context.device)
        self._palm = self._gripping.scene.model.body("palm").id

    def compute(
        self,
        followed: Tensor,
        plan_since: Tensor,
        plan_stopped: Tensor,
        stopped_since: Tensor,
        episode_time: Tensor,
        xpos: Tensor,
        xquat: Tensor,
    ) -> dict[str, Tensor]:
        made, goes = self._gripping, plan_stopped < 0
        # Sticks that stopped at once would be thrown out of the hand.
        rate = torch.exp((stopped_since - episode_time) / SLOWING)
        rate = torch.where(goes, 1.0, rate)
        time = torch.where(goes, episode_time - plan_since, plan_stopped + SLOWING * (1.0 - rate))
        row = followed.long().clamp(0, len(self._bank.goals) - 1)  # a number that went wrong
        whole = torch.where(goes, (time / DT).round(), (time / DT).floor())
        share = torch.where(goes, 0.0, time / DT - whole)[:, None]
        frame = whole.long()[:, None] + goes[:, None] * self._steps
        here, after = self._bank.at(row, frame), self._bank.at(row, frame + 1)
        if not self._plans:
            here = after = self._unplanned(row, here)
        turning = rate[:, None] * (after[..., 7] - here[..., 7]) / DT
        speed = rate[:, None, None] * (after[..., :7] - here[..., :7]) / DT
        arm = here[..., :7] + share[..., None] * (after[..., :7] - here[..., :7])
        angle = here[..., 7] + share * (after[..., 7] - here[..., 7])
        hand, slope = made.at(made.poses, angle)
        pose = torch.cat([arm, hand], dim=-1)
        velocity = torch.cat([speed, slope * turning[..., None]], dim=-1)
        lower, away = made.lower.expand(*angle.shape, 7), self._bank.shifts[row, None, None]
        lower = torch.cat([lower[..., :3] + away * self._axis, lower[..., 3:]], dim=-1)
        still = torch.zeros_like(lower[..., :6])
        gripper = torch.cat([lower, angle[..., None], still, turning[..., None]], dim=-1)
        held, now = here[:, 0, _HELD] * goes, lower[:, 0]
        targets, _ = made.at(made.targets, angle[:, 0] + self._squeeze * held)
        palm, turn = xpos[:, self._palm, None], xquat[:, self._palm, None]
        thing, leg = here[:, 1:, _OBJECT], here[:, 0, _LEG]
        return {
            "planned_angle": angle[:, 0],
            "planned_targets": torch.cat(
                [arm[:, 0] + self._lead * velocity[:, 0, : len(ARM_POSE)], targets], dim=1
            ),
            "planned_pose": pose[:, 0],
            "planned_velocity": velocity[:, 0],
            "planned_upper": made.upper(now, angle[:, 0]),
            "planned_lower": now,
            "plan_ahead": torch.cat([pose, velocity, gripper], dim=-1)[:, 1:],
            "plan_time": time,
            "plan_lasts": DT * self._bank.lengths[row].float(),
            "planned_object": here[:, 0, _OBJECT],
            "planned_held": held,
            "planned_goal": self._bank.goals[row, leg.long()],
            "planned_leg": leg,
            "leg_over": here[:, 0, _LAST],
            "object_shape": self._bank.seen[row],
            "object_ahead": torch.cat(
                [
                    rotations.inverse_rotate(turn.expand(-1, len(AHEAD), 4), thing[..., :3] - palm),
                    rotations.multiply(
                        rotations.conjugate(turn).expand_as(thing[..., 3:]), thing[..., 3:]
                    ),
                ],
                dim=-1,
            ),
        }

    def _unplanned(self, row: Tensor, here: Tensor) -> Tensor:
        """The frames `here` (N, K, _FRAME) of the plans `row` (N,) with arm and sticks as they begin, nothing held, and the object
        where it shall be in the end."""
        found = here.clone()
        found[..., : _OBJECT.start] = self._bank.frames[row, 0, : _OBJECT.start][:, None]
        found[..., _OBJECT] = self._bank.at(row, self._bank.lengths[row])[:, None, _OBJECT]
        found[..., _HELD] = 0.0
        return found


class Object(Fields):
    """The object, and how far it is from where it shall be.

    - ``object_state`` (13,): position, rotation, linear and angular velocity in the palm's frame
    - ``object_distance`` () m and ``object_turn`` () rad from the plan; ``goal_distance`` () m from the goal
    - ``object_placed`` () 1 where the plan is over and the object within `within` m of the goal; where something is to go along, it still
      lies upon it
    - ``plan_over`` () 1 once the plan has ended
    - ``legs_placed`` (8,) 1 in the moment at which that relocation is over and its object within `within` m;
      ``leg_placed`` () 1 where any is, ``leg_missed`` () 1 where one is over and its object elsewhere
    """

    reads = (
        "qpos", "qvel", "xpos", "xquat", "planned_object", "planned_goal", "planned_leg", "leg_over",
        "plan_lasts", "plan_time", "plan_stopped", "object_shape",
    )  # fmt: skip
    provides: Mapping[str, Shape] = {
        "object_state": (13,),
        "object_distance": (),
        "object_turn": (),
        "goal_distance": (),
        "object_placed": (),
        "plan_over": (),
        "legs_placed": (MOST,),
        "leg_placed": (),
        "leg_missed": (),
    }

    @dataclass(frozen=True)
    class Options:
        within: float = 0.005  #: m from the goal that count as success (figure 5.22)
        settle: float = 0.3  #: s after the plan's end, in which the object comes to rest

        def __post_init__(self) -> None:
            check_range(self, "within", above=0)
            check_range(self, "settle", least=0)

    def __init__(self, options: Options, context: Context) -> None:
        made, _ = bank_of(context, "fields 'chopsticks/object'")
        model = made.scene.model
        self._at, self._dof = (
            int(address[0])
            for address in (model.joint("object").qposadr, model.joint("object").dofadr)
        )
        self._palm, self._options = model.body("palm").id, options
        above, own = made.scene.options.above, made.scene.options.object
        self._above = None if above is None else int(model.joint("above").qposadr[0])
        if above is not None and own is not None:
            self._up, self._half = own.height + above.height, 0.5 * min(own.sizes)
        self._legs = torch.arange(MOST, device=context.device)

    def compute(
        self,
        qpos: Tensor,
        qvel: Tensor,
        xpos: Tensor,
        xquat: Tensor,
        planned_object: Tensor,
        planned_goal: Tensor,
        planned_leg: Tensor,
        leg_over: Tensor,
        plan_lasts: Tensor,
        plan_time: Tensor,
        plan_stopped: Tensor,
        object_shape: Tensor,
    ) -> dict[str, Tensor]:
        place, rotation = qpos[:, self._at : self._at + 3], qpos[:, self._at + 3 : self._at + 7]
        speed = qvel[:, self._dof : self._dof + 3]
        spin = rotations.rotate(rotation, qvel[:, self._dof + 3 : self._dof + 6])
        palm, turn = xpos[:, self._palm], xquat[:, self._palm]
        away = (place - planned_goal).norm(dim=-1)
        goes = plan_stopped < 0
        over = goes & (plan_time >= plan_lasts + self._options.settle - 0.5 * DT)
        turned = rotations.angle_between(rotation, planned_object[:, 3:])
        # The last one is judged when the plan is over, the others in their last frame.
        done = torch.where(plan_time < plan_lasts - 0.5 * DT, goes & (leg_over > 0), over)
        good = away <= self._options.within
        if self._above is not None:
            apart = qpos[:, self._above : self._above + 3] - place
            lies = (apart[:, 2] - self._up).abs() < ON_TABLE
            good &= lies & (apart[:, :2].norm(dim=-1) < self._half)
        there = done & good
        legs = planned_leg.long()[:, None] == self._legs
        return {
            "object_state": torch.cat(
                [
                    rotations.inverse_rotate(turn, place - palm),
                    rotations.canonical(rotations.multiply(rotations.conjugate(turn), rotation)),
                    rotations.inverse_rotate(turn, speed),
                    rotations.inverse_rotate(turn, spin),
                ],
                dim=-1,
            ),
            # Where a plan has stopped there is none for the object.
            "object_distance": (place - planned_object[:, :3]).norm(dim=-1) * goes,
            "object_turn": turned * (object_shape[:, 0] == 0),  # a sphere's rotation is nobody's
            "goal_distance": away,
            "object_placed": (over & good).float(),
            "plan_over": over.float(),
            "legs_placed": (there[:, None] & legs).float(),
            "leg_placed": there.float(),
            "leg_missed": (done & ~there).float(),
        }


@ranges(0.0, 1.0)
def thing(
    object_distance: Tensor,
    object_turn: Tensor,
    *,
    distance: float = 40.0,  #: 1/m (eq. 5.4)
    turn: float = 10.0,  #: 1/rad, of the angle Θ (eq. 5.4); a sphere's counts as 0
) -> Tensor:
    """exp of eq. 5.4: the object as planned, exp(-40 ‖p - p̃‖ - 10 Θ)."""
    return torch.exp(-distance * object_distance - turn * object_turn)


def lost(
    object_distance: Tensor,
    *,
    distance: float = 0.0178,  #: m, where exp(-20 d) is 0.7, the release's; the thesis names none
) -> Tensor:
    """The object is far from where it is planned."""
    return object_distance > distance


def missed(plan_over: Tensor, object_placed: Tensor) -> Tensor:
    """The plan is over, and the object not at its goal."""
    return (plan_over > 0) & (object_placed == 0)


def placed(object_placed: Tensor) -> Tensor:
    """The object is at its goal, and the plan over."""
    return object_placed > 0
