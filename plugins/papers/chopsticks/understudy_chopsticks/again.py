"""Planning again within an episode: what has failed is begun anew, from where everything is (thesis, section 5.7.5).

N worlds; m, s.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.task import Context, Memory
from understudy_chopsticks.relocate import SLOWING, bank_of
from understudy_tool_planner.planner import DT

#: s after which what slows down stands.
STOPS = 4.0 * SLOWING


class Again(Memory):
    """Which plan a world follows, and since when; a plan that fails is made anew, without noise.

    A relocation fails where the object is far from its plan, or elsewhere as it ends. The sticks then slow down and stop until the object lies still,
    rest for the 0.1 s that a plan takes to be found, open, go up by 3 cm and begin anew, for the same goals. Trainings never plan
    anew, as in the thesis: nothing leaves the device in them. With `onward` each relocation after the first is planned as the one before is over,
    from where the object then lies.

    - ``followed`` () number in the bank; ``plan_since`` () s of the episode
    - ``plan_stopped`` () s, the plan's time at which it stopped, -1 where it goes on; ``stopped_since`` () s of the episode
    - ``replans`` () so far; ``given_up`` () 1 where there was no plan; ``leg_begun`` () number of the last relocation that has begun

    *Limits:* evaluations on a GPU are refused, since their steps are captured. An object that is not flat on the table, falls off it, does not come to rest, or that no plan reaches, is given up. A
    sphere rests only if it has rolling friction (``scene.object.rolling``).
    """

    reads = (
        "plan_row", "episode_time", "qpos", "qvel", "object_distance", "leg_missed", "planned_leg",
    )  # fmt: skip
    keeps = dict.fromkeys(
        ("followed", "plan_since", "plan_stopped", "stopped_since", "replans", "given_up", "leg_begun"), ()
    )

    @dataclass(frozen=True)
    class Options:
        most: int = (
            0  #: plans made anew in an episode of an evaluation; the thesis does not limit them
        )
        #: plan each next relocation of an evaluation's episode only as it begins, from where the object lies
        onward: bool = False
        distance: float = (
            0.0178  #: m from the plan at which the object counts as lost (as termination lost)
        )
        still: float = 0.02  #: m/s below which the object lies still
        patience: float = 2.0  #: s for which the sticks wait until it does

        def __post_init__(self) -> None:
            check_range(self, "most", least=0, most=100)
            check_range(self, "distance", "still", "patience", above=0)

    def __init__(self, options: Options, context: Context) -> None:
        made, self._bank = bank_of(context, "memory 'chopsticks/again'")
        self._options, self._most = options, options.most if context.evaluating else 0
        self._onward = self._bank.one_by_one = options.onward and context.evaluating
        joint = made.scene.model.joint("object")
        self._at, self._dof = int(joint.qposadr[0]), int(joint.dofadr[0])
        if (self._most or self._onward) and context.device.type != "cpu":
            asked = f"memory.again.most={self._most}" if self._most else "memory.again.onward=true"
            raise ConfigError(
                f"{asked} needs device=cpu simulator=mujoco: plans are made on the host, which a step "
                "that a GPU captures does not wait for. Evaluate the run there: "
                f"understudy evaluate RUN device=cpu simulator=mujoco {asked}"
            )
        if self._most or self._onward:
            self._bank.spare(context.num_worlds)

    def begin(self, plan_row: Tensor, **fields: Tensor) -> dict[str, Tensor]:
        new = {name: torch.zeros_like(plan_row) for name in self.keeps}
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
    ) -> Mapping[str, Tensor]:
        if not self._most and not self._onward:
            return kept
        new = {name: value.clone() for name, value in kept.items()}
        stopped = new["plan_stopped"] >= 0
        failed = (object_distance > self._options.distance) | (leg_missed > 0)
        failed &= ~stopped & (new["replans"] < self._most) & (new["given_up"] == 0)
        time = episode_time - new["plan_since"]
        new["plan_stopped"] = torch.where(failed, time, new["plan_stopped"])
        new["stopped_since"] = torch.where(failed, episode_time, new["stopped_since"])
        speed = qvel[:, self._dof : self._dof + 3].norm(dim=-1)
        since = episode_time - new["stopped_since"]
        ready = stopped & (speed < self._options.still) & (since > STOPS)
        late = since > self._options.patience
        late = stopped & ~ready & (late | (qpos[:, self._at + 2] < 0))  # or beside the table
        for world in (ready | late).nonzero()[:, 0].tolist():  # an evaluation's, and few
            thing = qpos[world, self._at : self._at + 7].double().cpu()
            frame = round((float(new["plan_stopped"][world]) + SLOWING) / DT)
            old, row = int(new["followed"][world]), None
            if ready[world]:
                row = self._bank.again(old, world, frame, thing[:3], thing[3:])
            new["plan_stopped"][world] = -1.0
            if row is None:
                new["given_up"][world] = 1.0
                continue
            new["followed"][world], new["plan_since"][world] = row, episode_time[world]
            new["replans"][world] += 1.0
        if self._onward:
            begun = (planned_leg > new["leg_begun"]) & (new["plan_stopped"] < 0)
            new["leg_begun"] = torch.where(begun, planned_leg, new["leg_begun"])
            for world in begun.nonzero()[:, 0].tolist():
                thing = qpos[world, self._at : self._at + 7].double().cpu()
                old, frame = int(new["followed"][world]), round(float(time[world]) / DT)
                row = self._bank.onward(old, world, frame, thing[:3], thing[3:])
                if row is None:
                    new["given_up"][world] = 1.0
                    continue
                new["followed"][world], new["plan_since"][world] = row, episode_time[world]
        return new
