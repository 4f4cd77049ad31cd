"""Episodes that begin at a take-off: at given features, or where the run-up of another run ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, InitialStates, Shape
from understudy_characters.scene import CharacterScene
from understudy_jumping.arena import MAT, Arena, arena_of
from understudy_jumping.run_up import takeoff_features
from understudy_jumping.takeoff import POSES, Takeoff, takeoff_states
from understudy_skills import bank
from understudy_tensors import rotations
from understudy_tensors.groups import Groups
from understudy_tensors.limits import check_angle

EPISODE_FIELDS: Mapping[str, Shape] = {
    "obstacle_height": (), "obstacle_width": (), "mat_height": (),
    "takeoff_features": (5,),
}  # fmt: skip


_FARTHEST = 20.0
"""m before an obstacle, twice as far as the longest jump."""


@dataclass(frozen=True)
class Distance:
    """How far the root is from the obstacle at the take-off, m: near + (far - near) ρ + ahead sin α.

    An obstacle straight in front is reached in half the time of one beside, hence the last term.
    """

    near: float = 0.8  #: m, distance from the obstacle at ρ = 0
    far: float = 1.2  #: m, distance from the obstacle at ρ = 1
    ahead: float = 0.8  #: m by which the distance is greater straight in front of the obstacle

    def __post_init__(self) -> None:
        check_range(self, "near", "far", above=0, most=_FARTHEST)
        check_range(self, "ahead", least=0, most=_FARTHEST)

    def at(self, rho: Tensor, alpha: Tensor) -> Tensor:
        """(N,)"""
        return self.near + (self.far - self.near) * rho + self.ahead * alpha.sin().clamp(min=0.0)


class Takeoffs(InitialStates):
    """At the take-off; the obstacle is as the difficulty has it.

    World i begins at take-off i of `takeoff` and `others`, over and over. ``takeoff_features`` (5,) are
    its v_z, ω_x, ω_y, ω_z and α; ``from_takeoff`` () and ``from_NAME`` () of each of `others` are 1 in the
    worlds that begin there.
    """

    reads = ("difficulty",)
    episode_fields = EPISODE_FIELDS
    varies = (f"mocap_pos/{MAT}",)

    @dataclass(frozen=True)
    class Options:
        #: the first take-off (table 4.3; of obstacle jumps table 4.4)
        takeoff: Takeoff = field(default_factory=Takeoff)
        #: further take-offs by name, in the order of their names
        others: Mapping[str, Takeoff] = field(default_factory=dict)
        #: ``plant``: the pose as the foot is planted; ``step``: the step before it
        pose: Literal["plant", "step"] = "plant"
        distance: Distance = field(default_factory=Distance)  #: m, how far from the obstacle
        #: largest deviation of joints, rad, and of all velocities, m/s and rad/s
        noise: float = 0.02

        def __post_init__(self) -> None:
            check_range(self, "noise", least=0, most=1)
            if "takeoff" in self.others:
                raise ValueError(
                    "others.takeoff is not possible: that is the name of the first one."
                )

    def __init__(self, options: Options, context: Context) -> None:
        who = "initial_states 'jumping/takeoff'"
        scene = context.need_scene(CharacterScene, who)
        self._arena, self._distance = arena_of(context, who), options.distance
        self._noise, layout = options.noise, scene.layout
        names = sorted(options.others)
        takeoffs = [options.takeoff, *(options.others[name] for name in names)]
        states = takeoff_states(scene.character, POSES[options.pose], takeoffs)
        self._groups = Groups(["takeoff", *names], context)
        self._qpos, self._qvel = (self._groups.of_worlds(rows) for rows in states)
        self._features = self._groups.of_worlds([takeoff.features for takeoff in takeoffs])
        self.episode_fields = {**EPISODE_FIELDS, **self._groups.fields}
        self._at = layout.root_address
        self._hinges = layout.hinge_qpos[layout.hinge_used.bool()].to(context.device)
        self._balls = layout.ball_qpos.to(context.device)

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        difficulty = fields["difficulty"]
        qpos, count = self._qpos.clone(), self._balls.shape[0]
        size = 3 * count + len(self._hinges) + self._qvel.shape[1]
        moved = self._noise * (2.0 * streams.uniform(size) - 1.0)
        balls, hinges, velocities = moved.split(
            [3 * count, len(self._hinges), self._qvel.shape[1]], dim=1
        )
        turned = rotations.from_exponential_map(balls.unflatten(1, (count, 3)))
        qpos[:, self._balls] = rotations.multiply(qpos[:, self._balls], turned)
        qpos[:, self._hinges] += hinges
        alpha = self._features[:, -1]
        qpos[:, self._at] = -self._distance.at(self._arena.rho(difficulty), alpha)
        return {
            "qpos": qpos,
            "qvel": self._qvel + velocities,
            "takeoff_features": self._features,
            **self._groups.flags(),
            **obstacle_at(self._arena, difficulty),
        }


class Harvested(InitialStates):
    """Where the run-ups of another run ended (a bank that ``job=harvest`` made), turned so that the
    approach is `alpha`."""

    reads = ("difficulty",)
    episode_fields = EPISODE_FIELDS
    varies = (f"mocap_pos/{MAT}",)

    @dataclass(frozen=True)
    class Options:
        file: str  #: the bank, or the folder of the run that has one
        alpha: float = (
            -0.05
        )  #: rad, angle of approach: 0 has the obstacle on its left, π/2 in front
        distance: Distance = field(default_factory=Distance)  #: m, how far from the obstacle
        #: m, drawn evenly, by which it begins nearer or farther at most: run-ups end so in other places than their bank has
        spread: float = 0.0

        def __post_init__(self) -> None:
            check_angle(self, "alpha")
            check_range(self, "spread", least=0, most=_FARTHEST)

    def __init__(self, options: Options, context: Context) -> None:
        who = "initial_states 'jumping/harvested'"
        scene, device = context.need_scene(CharacterScene, who), context.device
        self._arena, self._distance = arena_of(context, who), options.distance
        self._spread = options.spread
        states = athletes_states(options.file, context, scene)
        qpos, qvel = states["qpos"].to(device), states["qvel"].to(device)
        self._at, dof = scene.layout.root_address, scene.layout.root_dof
        at = self._at
        root = qpos[:, at + 3 : at + 7]
        heading = rotations.heading(root)
        wanted = torch.full_like(heading, Takeoff(alpha=options.alpha).heading)
        turn = rotations.from_heading(wanted - heading)
        features = takeoff_features(root, qvel[:, dof : dof + 6])
        alpha = torch.full_like(heading, options.alpha).unsqueeze(1)
        self._features = torch.cat([features, alpha], dim=1)
        self._qpos, self._qvel = qpos.clone(), qvel.clone()
        self._qpos[:, at : at + 2] = 0.0
        self._qpos[:, at + 3 : at + 7] = rotations.multiply(turn, root)
        self._qvel[:, dof : dof + 3] = rotations.rotate(turn, qvel[:, dof : dof + 3])

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        difficulty = fields["difficulty"]
        count = len(self._qpos)
        row = (streams.uniform(1).squeeze(1) * count).long().clamp(max=count - 1)
        qpos = self._qpos[row]
        alpha = self._features[row, -1]
        qpos[:, self._at] = -self._distance.at(self._arena.rho(difficulty), alpha)
        if self._spread:
            qpos[:, self._at] += self._spread * (2.0 * streams.uniform(1).squeeze(1) - 1.0)
        return {
            "qpos": qpos,
            "qvel": self._qvel[row],
            "takeoff_features": self._features[row],
            **obstacle_at(self._arena, difficulty),
        }


def athletes_states(file: str, context: Context, scene: CharacterScene) -> dict[str, Tensor]:
    """The states of a bank of this athlete.

    Raises
    ------
    ConfigError
        it is of another.
    """
    states = bank.starts(file, context, "initial_states")
    for name, size in {"qpos": scene.model.nq, "qvel": scene.model.nv}.items():
        if name not in states or tuple(states[name].shape[1:]) != (size,):
            raise ConfigError(
                f"initial_states: the bank {file} has no states of this athlete ('{name}' "
                f"of {size} numbers). Harvest the run of a run-up (job=harvest)."
            )
    return states


def obstacle_at(arena: Arena, difficulty: Tensor) -> dict[str, Tensor]:
    """The obstacle's fields, and where the mat is, at `difficulty` (N,)."""
    height, width = arena.height(difficulty), arena.width(difficulty)
    mat = arena.mat_height(height)
    place = torch.stack([arena.mat_x(width), torch.zeros_like(width), mat], dim=1)
    return {
        "obstacle_height": height,
        "obstacle_width": width,
        "mat_height": mat,
        f"mocap_pos/{MAT}": place,
    }
