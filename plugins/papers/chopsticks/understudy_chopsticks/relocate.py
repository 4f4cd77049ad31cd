"""How a relocation begins: each world draws a plan of the bank, which is refilled from the planner while others run (thesis, sections
5.4.2 and 5.7).

A row that is about to be replaced is no longer drawn, and gets its new plan once no world follows the old one. P plans, N
worlds; m, rad, s.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, InitialStates, Rollout, Shape, State
from understudy_chopsticks.plan_bank import FARTHEST, LONGER, MOST, OBJECT, RESTING, bank_of
from understudy_hand.table import ARM_POSE
from understudy_tool_planner.planner import ASIDE, CLOSING, DT, LEAST, PRESSING


class Relocations(InitialStates):
    """The sticks in the hand, open, and the object at the start of a plan that each world draws. In an evaluation, each world
    draws from its own share of the bank.

    ``plan_row`` () is the plan's number in the bank; ``plan_goal`` (3,) m, where the object is to be put in the end.
    """

    reads = ("episode_limit",)
    rollout_fields = ("plan_row",)
    episode_fields: Mapping[str, Shape] = {"plan_row": (), "plan_goal": (3,)}

    @dataclass(frozen=True)
    class Options:
        #: how many plans the bank has; the thesis has 100 tasks of eight objects, a GPU 256 plans
        #: here
        plans: int = 4
        refill: int = 1  #: plans that are made anew in an iteration (some 0.1 s of a core each); 0 keeps the first ones
        longest: float = 3.0  #: s, longest duration of a relocation; longer plans are not followed
        #: how many relocations of the object a plan has, one after another; figure 5.21 has eight
        relocations: int = 1
        #: m: standard deviation of a plan's error in where the sticks take and put (section 5.7.5 has 0.003)
        noise: float = 0.0
        #: whether the object is thrown, to the table's far side (section 5.7.2)
        thrown: bool = False
        #: whether plans count on the tool where it comes to rest in the hand, and not where its grip was found for
        settled: bool = False
        #: m: how much further along its lower part the tool is held, drawn evenly for each plan; beyond 0 the hand is nearer
        #: to the tips (section 5.7.2 has -0.05 to 0.05)
        shift: tuple[float, float] = (0.0, 0.0)
        #: s that the closed tool rests before it lifts (the release has 0.05); a box is held firmly only after some 0.3
        pressing: float = PRESSING
        #: whether the tool goes to where another object might lie before it comes for each relocation but the first, as with
        #: several objects on the table (section 5.7.5): `longest` has to have room for it
        elsewhere: bool = False
        #: m: how high over the object a tool that comes from elsewhere goes first, before it comes down to it; 0: straight to it
        over: float = 0.0
        #: factor, from 1 to 10, of the time in which the tool comes to the object at the thesis'
        #: 0.25 m/s (section 5.6.2)
        slowly: float = 1.0
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
                    f"relocations={self.relocations} is not possible with thrown=true: a thrown object lands out of reach. Set one of them alone."
                )
            check_range(self, "over", least=0, most=0.2)
            check_range(self, "slowly", least=1, most=10)
            if self.elsewhere and self.relocations == 1:
                raise ValueError(
                    "elsewhere=true is not possible with relocations=1: the tool goes there between two relocations. Set relocations=4, or leave elsewhere out."
                )
            check_range(self, "pressing", least=0, most=1.0)
            check_range(self, "longest", least=self.least, most=60.0)
            low, high = self.shift
            if not -FARTHEST <= low <= high <= FARTHEST:
                raise ValueError(
                    f"shift={[low, high]} is not possible: the first is the lower one, and both are from {-FARTHEST:g} to "
                    f"{FARTHEST:g} m."
                )
            if self.refill >= self.plans:
                raise ValueError(
                    f"refill={self.refill} with plans={self.plans} is not possible: give more plans than are refilled."
                )

        @property
        def least(self) -> float:
            """s, of a relocation that goes nowhere."""
            return round(2 * (LEAST + CLOSING) + self.pressing + ASIDE, 6)

    def __init__(self, options: Options, context: Context) -> None:
        self._options, self._asked = options, False
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
        if options.elsewhere and made.scene.options.above is not None:
            raise ConfigError(
                "initial_states.elsewhere=true is not possible with scene.above: what lies upon the object would be in the way. "
                "Set one of them alone."
            )
        # A GPU captures the step in which episodes begin, so its bank has to be whole before.
        self._later = context.evaluating and context.device.type == "cpu"
        self.bank.fill(
            options.plans, options.longest, options.relocations, options.noise, self._later,
            options.thrown, options.settled, options.shift, options.pressing, options.elsewhere,
            options.over, options.slowly,
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

    def _say_if_too_short(self, row: Tensor, limit: Tensor) -> None:
        """Of the first episodes (N,) s, which follow the plans `row` (N,): what has no time passes for what has failed."""
        self._asked, own, count = True, self._options, self._options.relocations
        needed = DT * self.bank.lengths[row].double()
        if self.bank.one_by_one:  # the others are not planned yet
            needed = needed.clamp(min=count * own.least + (count - 1) * RESTING)
        late, most = needed > limit, float(limit.max())
        enough = count * own.longest + count * RESTING + LONGER * self.bank.anew
        if late.any():
            what = "relocations" if count == 1 else f"{count} relocations in a row"
            told = (
                f"before {what} can be in {int(late.sum())} of {len(row)} worlds, where they take {float(needed[late].min()):.3g} s or "
                "more, so none succeeds there"
            )
        elif self.bank.anew and most < enough - RESTING:
            told = f"before a plan made anew (memory.again.most) can be over, which may last {LONGER:g} s longer"
        else:
            return
        seconds = math.ceil(enough)
        warnings.warn(
            f"Episodes of {most:g} s are over {told}. Set episode.seconds={seconds} evaluation.seconds={seconds}.",
            stacklevel=2,
        )

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
        limit = fields.get("episode_limit")
        # a GPU captures this, and nothing leaves it
        if not self._asked and limit is not None and limit.device.type == "cpu":
            self._say_if_too_short(row, limit)
        thing = self.bank.frames[row, 0, OBJECT]
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
        waiting, following = [int(row) for row in state["waiting"]], int(state["next"])
        if sorted(self._order.tolist()) != [*range(len(self._order))]:
            raise ValueError("'order' does not have each plan once")
        if not all(0 <= row < len(self._order) for row in (*waiting, following)):
            raise ValueError("'waiting' or 'next' are plans that there are not")
        self._waiting, self._next = waiting, following
