"""What walking is: how the walker moves, what it is worth, what it observes, and when it has fallen.

The reward is that of Yu, Turk and Liu 2018 (section 3), which the thesis' task follows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, Encoder, Fields, InitialStates, Memory, Shape
from understudy_morphology.assistance import torques
from understudy_morphology.figure import FEET, TORSO
from understudy_morphology.scene import ROOT_POSITIONS, WalkerScene
from understudy_tensors.limits import ANGLE, limits
from understudy_tensors.rotations import heading, tangent_normal


class Gait(Fields):
    """How the walker moves.

    - ``forward_velocity`` m/s, of the root along x; ``sideways`` m, of the root from the line y = 0
    - ``lean`` rad, in [0, pi], between the torso's axis and the vertical; ``turn`` rad, the torso's
      heading
    - ``height`` of the root over that of standing; ``clearance`` (2,) m, of the lowest corner of the
      left and the right foot above the floor
    - ``effort`` sum of the shares of torque, without sign
    """

    reads = ("qpos", "qvel", "xquat", "geom_xpos", "geom_xmat", "action")
    provides = {
        "forward_velocity": (), "sideways": (), "lean": (), "turn": (), "height": (),
        "clearance": (len(FEET),), "effort": (),
    }  # fmt: skip

    def __init__(self, options: None, context: Context) -> None:
        scene = context.need_scene(WalkerScene, "fields 'morphology/gait'")
        model = scene.model
        self._standing, self._torso = scene.standing_height, model.body(TORSO).id
        self._feet = [model.geom(name).id for name in FEET]
        self._half = torch.tensor(model.geom_size[self._feet], dtype=torch.float32)
        self._half = self._half.to(context.device)

    def compute(
        self,
        qpos: Tensor,
        qvel: Tensor,
        xquat: Tensor,
        geom_xpos: Tensor,
        geom_xmat: Tensor,
        action: Tensor,
    ) -> dict[str, Tensor]:
        torso = xquat[:, self._torso]
        up = tangent_normal(torso)[:, 5]
        # a box reaches down from its centre by its half sizes along its axes' vertical parts
        clearances = [
            geom_xpos[:, foot, 2] - geom_xmat[:, foot].reshape(-1, 9)[:, 6:].abs() @ half
            for foot, half in zip(self._feet, self._half, strict=True)
        ]
        return {
            "forward_velocity": qvel[:, 0],
            "sideways": qpos[:, 1],
            "lean": torch.acos(up.clamp(-1.0, 1.0)),
            "turn": heading(torso),
            "height": qpos[:, 2] / self._standing,
            "clearance": torch.stack(clearances, dim=1),
            "effort": torques(action).abs().sum(dim=1),
        }


class Speed(Memory):
    """How much too slow the walker has been of late.

    ``slowness`` (N,) m/s is a mean of target less velocity in which the weight of what was falls off
    with the time constant `seconds`.
    """

    reads = ("forward_velocity", "target_velocity")
    keeps = {"slowness": ()}

    @dataclass(frozen=True)
    class Options:
        seconds: float = 0.5  #: s, time constant of the mean, above 0

        def __post_init__(self) -> None:
            check_range(self, "seconds", above=0)

    def __init__(self, options: Options, context: Context) -> None:
        self._share = 1.0 - math.exp(-context.control_dt / options.seconds)

    def begin(self, forward_velocity: Tensor, target_velocity: Tensor) -> dict[str, Tensor]:
        return {"slowness": target_velocity - forward_velocity}

    def advance(
        self, kept: Mapping[str, Tensor], forward_velocity: Tensor, target_velocity: Tensor
    ) -> dict[str, Tensor]:
        now = target_velocity - forward_velocity
        return {"slowness": torch.lerp(kept["slowness"], now, self._share)}


class Worth(Fields):
    """The reward of a step, ``worth`` (N,):

    r = alive - velocity |v̂ - v̄| - energy Σ|τ / τ_max| - sideways |y| - upright (|lean| + |turn|)

    It is a field, not a sum of reward terms, so that a measure of evaluations can add it up too.
    """

    reads = ("slowness", "effort", "sideways", "lean", "turn")
    provides = {"worth": ()}

    @dataclass(frozen=True)
    class Options:
        alive: float = 4.0  #: reward of each step, from 0
        velocity: float = 3.0  #: s/m, from 0: cost of each m/s off the target velocity
        energy: float = 0.4  #: weight, from 0, of the sum of torques as shares of their limits
        sideways: float = 3.0  #: 1/m, from 0: cost of each metre to the side
        upright: float = 1.0  #: 1/rad, from 0: cost of leaning and turning away

        def __post_init__(self) -> None:
            check_range(self, "alive", "velocity", "energy", "sideways", "upright", least=0)

    def __init__(self, options: Options, context: Context) -> None:
        self._options = options

    def compute(
        self, slowness: Tensor, effort: Tensor, sideways: Tensor, lean: Tensor, turn: Tensor
    ) -> dict[str, Tensor]:
        options = self._options
        return {
            "worth": options.alive
            - options.velocity * slowness.abs()
            - options.energy * effort
            - options.sideways * sideways.abs()
            - options.upright * (lean + turn.abs())
        }


def normalised(
    value: Tensor,
    *,
    #: T, steps of a whole episode, from 1
    steps: int = 500,
) -> Tensor:
    """A step's part of the normalised return, eq. 6.4: reward / T. To be summed over the episode; a
    fall ends the sum, not the division by T = `steps`."""
    return value / steps


@limits(low=(0, 1), limit=ANGLE)
def fallen(
    height: Tensor,
    lean: Tensor,
    turn: Tensor,
    *,
    #: share of the root's standing height, in [0, 1]
    low: float = 0.8,
    #: rad by which the torso may lean or turn
    limit: float = 0.8,
) -> Tensor:
    """The root is below the share `low` of its standing height, or the torso leans or turns away by
    more than `limit` rad."""
    return (height < low) | (lean > limit) | (turn.abs() > limit)


class Body(Encoder):
    """What the walker feels, (N, 18 + 2 J).

    Height and distance from the line (m); the root's rotation (two axes), velocity (m/s, world) and
    angular velocity (rad/s, its own frame); joints' angles and rates; the feet's clearance; how fast it
    should go and how much too slow it has been.
    """

    reads = ("qpos", "qvel", "clearance", "target_velocity", "slowness")

    def __init__(self, options: None, context: Context) -> None:
        scene = context.need_scene(WalkerScene, "encoder 'morphology/body'")
        self.shape: Shape = (2 + 6 + 6 + len(FEET) + 2 + 2 * scene.joints,)

    def encode(
        self,
        qpos: Tensor,
        qvel: Tensor,
        clearance: Tensor,
        target_velocity: Tensor,
        slowness: Tensor,
    ) -> Tensor:
        speed = torch.stack([target_velocity, slowness], dim=1)
        return torch.cat(
            [
                qpos[:, 1:3],
                tangent_normal(qpos[:, 3:ROOT_POSITIONS]),
                qpos[:, ROOT_POSITIONS:],
                qvel,
                clearance,
                speed,
            ],
            dim=1,
        )


class Standing(InitialStates):
    """Standing on the floor; joints are turned, and everything moves, by a little at random."""

    @dataclass(frozen=True)
    class Options:
        #: largest deviation: rad (hinges stay within their ranges), m/s and rad/s
        noise: float = 0.05

        def __post_init__(self) -> None:
            check_range(self, "noise", least=0, most=1e3)

    def __init__(self, options: Options, context: Context) -> None:
        scene = context.need_scene(WalkerScene, "initial_states 'morphology/standing'")
        model, device = scene.model, context.device

        def constant(values: object) -> Tensor:
            return torch.as_tensor(values, dtype=torch.float32).to(device)

        self._qpos, self._noise = constant(model.qpos0).repeat(context.num_worlds, 1), options.noise
        hinges = model.jnt_range[1:]
        self._low, self._high = constant(hinges[:, 0]), constant(hinges[:, 1])
        self._joints, self._nv = scene.joints, model.nv

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        either_way = self._noise * (2 * streams.uniform(self._joints + self._nv) - 1)
        turned, moved = either_way.split([self._joints, self._nv], dim=1)
        qpos = self._qpos.clone()
        qpos[:, ROOT_POSITIONS:] = turned.clamp(self._low, self._high)
        return {"qpos": qpos, "qvel": moved}
