"""Planning again within an episode: what has failed is begun anew, from where everything is (thesis, section 5.7.5).

N worlds; m, s.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.task import Context, Memory
from understudy_chopsticks.plan_bank import SLOWING, bank_of
from understudy_tool_planner.configuration import NoPlan
from understudy_tool_planner.planner import DT

#: s after which what slows down stands.
STOPS = 4.0 * SLOWING


class Again(Memory):
    """Which plan a world follows, and since when; a plan that fails is made anew, without noise.

    A relocation fails where the object is far from its plan, or not at its goal as the plan ends. The sticks then slow down and stop until the object lies still,
    rest for the 0.1 s that a plan takes to be found, open, go up by 3 cm and begin anew, for the same goals. Trainings never plan
    anew, as in the thesis: nothing leaves the device in them. With `onward`, each relocation after the first is planned when the one before is over,
    from where the object then lies. A plan made within an episode takes into account how far the tool has slipped along its lower part in the hand.

    A visitor can lead one world (:meth:`send`; not in the thesis): the relocation that is on is ended first, the next goal is the visitor's, and where no plan
    reaches this goal, the hand waits for another.

    - ``followed`` () number in the bank; ``plan_since`` () s of the episode
    - ``plan_stopped`` () s, the plan's time at which it stopped, -1 where it goes on; ``stopped_since`` () s of the episode
    - ``replans`` () so far; ``given_up`` () 1 where there was no plan; ``leg_begun`` () number of the last relocation that has begun

    *Limits:* evaluations on a GPU are refused, since their steps are captured. An object that is not flat on the table, falls off it, does not come to rest, or that no plan reaches, is given up. A
    sphere rests only if it has rolling friction (``scene.object.rolling``).
    """

    reads = (
        "plan_row", "episode_time", "qpos", "qvel", "object_distance", "leg_missed", "planned_leg", "plan_over",
        "stick_state",
    )  # fmt: skip
    keeps = dict.fromkeys(
        (
            "followed",
            "plan_since",
            "plan_stopped",
            "stopped_since",
            "replans",
            "given_up",
            "leg_begun",
        ),
        (),
    )

    @dataclass(frozen=True)
    class Options:
        #: how many plans may be made anew in an episode of an evaluation; the thesis does not limit
        #: them
        most: int = 0
        #: whether each next relocation of an evaluation's episode is planned only as it begins,
        #: from where the object lies
        onward: bool = False
        #: m from the plan at which the object counts as lost (as in the termination ``lost``)
        distance: float = 0.0178
        still: float = 0.02  #: m/s below which the object lies still
        patience: float = 2.0  #: s for which the sticks wait until the object lies still

        def __post_init__(self) -> None:
            check_range(self, "distance", "still", most=1e3)
            check_range(self, "most", least=0, most=100)
            check_range(self, "distance", "still", "patience", above=0)

    def __init__(self, options: Options, context: Context) -> None:
        made, self._bank = bank_of(context, "memory 'chopsticks/again'")
        self._options = options
        self._most: float = options.most if context.evaluating else 0
        self._onward = self._bank.one_by_one = options.onward and context.evaluating
        joint = made.scene.model.joint("object")
        self._at, self._dof = int(joint.qposadr[0]), int(joint.dofadr[0])
        if (self._most or self._onward) and context.device.type != "cpu":
            asked = (
                f"memory.again.most={options.most}" if self._most else "memory.again.onward=true"
            )
            raise ConfigError(
                f"{asked} needs device=cpu simulator=mujoco: plans are made on the host, which a step "
                "that a GPU captures does not wait for. Evaluate the run there: "
                f"understudy evaluate RUN device=cpu simulator=mujoco {asked}"
            )
        if self._most or self._onward:
            self._bank.spare(context.num_worlds)
        self._bank.anew = self._most > 0
        self._context = context
        #: m: where the visitor wants the object to be brought; None before they say so.
        self.target: tuple[float, float] | None = None
        self._new = False  #: whether nothing was planned for it yet
        self.refused = ""  #: why no plan reaches it, in a sentence

    def send(self, x: float, y: float) -> None:
        """Bring the object to this place of the table next, m. From then on plans are made anew without limit.

        Raises
        ------
        ConfigError
            where there is more than one world, or plans are made on another device.
        """
        if self._context.num_worlds != 1 or self._context.device.type != "cpu":
            raise ConfigError(
                "An object is led in one world on the CPU. Set num_worlds=1 device=cpu."
            )
        if self.target is None:
            self._most = math.inf
            self._bank.spare(1)
        self.target, self._new, self.refused = (x, y), True, ""

    @property
    def body(self) -> str:
        """Name of the body that is led."""
        return "object"

    def way(self, kept: Mapping[str, Tensor]) -> np.ndarray:
        """(T, 3) m: of the object, in the plan that world 0 follows."""
        return self._bank.way(int(kept["followed"][0]))

    def begin(self, plan_row: Tensor, **fields: Tensor) -> dict[str, Tensor]:
        new = {name: torch.zeros_like(plan_row) for name in self.keeps}
        self._new = self.target is not None
        return {**new, "followed": plan_row, "plan_stopped": new["plan_stopped"] - 1.0}

    def advance(
        self,
        kept: Mapping[str, Tensor],
        plan_row: Tensor,
        episode_time: Tensor,
        qpos: Tensor,
        qvel: Tensor,
        object_distance: Tensor,
        leg_missed: Tensor,
        planned_leg: Tensor,
        plan_over: Tensor,
        stick_state: Tensor,
    ) -> Mapping[str, Tensor]:
        if not self._most and not self._onward:
            return kept
        new = {name: value.clone() for name, value in kept.items()}
        along = self._bank.slipped(stick_state[:, -1, :3])
        if self._new:
            new["given_up"].zero_()
        stopped = new["plan_stopped"] >= 0
        begun = ~stopped & (planned_leg > new["leg_begun"])
        new["leg_begun"] = torch.where(stopped, new["leg_begun"], planned_leg)
        failed = (object_distance > self._options.distance) | (leg_missed > 0)
        if self._onward:  # what begins is planned from where the object lies, wherever that is
            failed &= ~begun
        failed &= ~stopped & (new["replans"] < self._most) & (new["given_up"] == 0)
        time = episode_time - new["plan_since"]
        new["plan_stopped"] = torch.where(failed, time, new["plan_stopped"])
        new["stopped_since"] = torch.where(failed, episode_time, new["stopped_since"])
        speed = qvel[:, self._dof : self._dof + 3].norm(dim=-1)
        since = episode_time - new["stopped_since"]
        stopped &= new["given_up"] == 0  # who is led waits for another goal
        ready = stopped & (speed < self._options.still) & (since > STOPS)
        late = since > self._options.patience
        late &= self.target is None  # who is led waits as long as it takes
        late = stopped & ~ready & (late | (qpos[:, self._at + 2] < 0))  # or beside the table
        for world in (ready | late).nonzero()[:, 0].tolist():  # an evaluation's, and few
            thing = qpos[world, self._at : self._at + 7].double().cpu()
            frame = round((float(new["plan_stopped"][world]) + SLOWING) / DT)
            old, leg, row = int(new["followed"][world]), int(new["leg_begun"][world]), None
            if ready[world] and self.target is not None:
                row = self._toward(old, world, frame, leg, thing, along[world], anew=True)
            elif ready[world]:
                row = self._bank.again(old, world, frame, leg, thing[:3], thing[3:], along[world])
            if row is None:
                new["given_up"][world] = 1.0
                if self.target is None:  # else it stands still
                    new["plan_stopped"][world] = -1.0
                continue
            new["plan_stopped"][world] = -1.0
            new["followed"][world], new["plan_since"][world] = row, episode_time[world]
            new["replans"][world] += 1.0
        if self._new and bool(plan_over[0] > 0) and bool(new["plan_stopped"][0] < 0):
            thing = qpos[0, self._at : self._at + 7].double().cpu()
            old, leg = int(new["followed"][0]), int(new["leg_begun"][0])
            row = self._toward(old, 0, round(float(time[0]) / DT), leg, thing, along[0])
            if row is not None:
                new["followed"][0], new["plan_since"][0] = row, episode_time[0]
        if self._onward:
            for world in begun.nonzero()[:, 0].tolist():
                thing = qpos[world, self._at : self._at + 7].double().cpu()
                old, frame = int(new["followed"][world]), round(float(time[world]) / DT)
                leg = int(planned_leg[world])
                row = self._bank.onward(old, world, frame, leg, thing[:3], thing[3:], along[world])
                if row is None:
                    new["given_up"][world] = 1.0
                    continue
                new["followed"][world], new["plan_since"][world] = row, episode_time[world]
        # What has not changed is returned as it is: what is computed from it stays.
        return {
            name: kept[name] if torch.equal(kept[name], new[name]) else new[name] for name in new
        }

    def _toward(
        self,
        old: int,
        world: int,
        frame: int,
        leg: int,
        thing: Tensor,
        along: float,
        anew: bool = False,
    ) -> int | None:
        assert self.target is not None
        self._new, self.refused = False, ""
        try:
            return self._bank.toward(
                old, world, frame, leg, thing[:3], thing[3:], self.target, along, anew
            )
        except NoPlan as refused:
            self.refused = str(refused)
            return None
