"""An arm of many joints, an auto-encoder of how it usually bends, and acting in what that learned."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from understudy import distributed
from understudy.errors import ConfigError, RunError
from understudy.nn import mlp
from understudy.options import check_range
from understudy.random import WorldStreams, generator, private_rng
from understudy.records import runs
from understudy.running.evaluation import Evaluation, Measured
from understudy.running.jobs import Job
from understudy.running.reinforcement import misshapen
from understudy.running.warm_start import newest_state
from understudy.setup.building import device_of
from understudy.setup.config import Experiment, validate
from understudy.task import (
    Actuation,
    ActionSpace,
    Box,
    Context,
    Encoder,
    Fields,
    InitialStates,
    Scene,
    Shape,
    Simulator,
    State,
)
from understudy_basics import optimisers

# ---------------------------------------------------------------------- poses and their code


class Poses(ABC):
    """Where poses to learn from come from; a kind of this plugin's own, built with ``(options,)``."""

    #: J, how many joint angles a pose has.
    joints: int

    @abstractmethod
    def draw(self, u: Tensor) -> Tensor:
        """Poses (B, J), rad, from random numbers `u` (B, 2) in [0, 1)."""


class Arcs(Poses):
    """Arcs and waves: every joint bends alike, but for a wave along the arm. Two numbers make one."""

    @dataclass(frozen=True)
    class Options:
        joints: int = 8
        bend: float = 2.0  #: rad, of the whole arm, to either side
        wave: float = 0.5  #: rad, of a joint, to either side

        def __post_init__(self) -> None:
            check_range(self, "joints", least=1)
            check_range(self, "bend", "wave", least=0)

    def __init__(self, options: Options) -> None:
        self._options, self.joints = options, options.joints

    def draw(self, u: Tensor) -> Tensor:
        options, signed = self._options, 2 * u - 1
        along = torch.arange(options.joints, device=u.device) / options.joints
        wave = torch.cos(math.pi * along)
        return signed[:, :1] * options.bend / options.joints + signed[:, 1:] * options.wave * wave


class AutoEncoder(nn.Module):
    """Poses (B, J) to a code (B, L) and back."""

    def __init__(self, joints: int, code: int, hidden: Sequence[int]) -> None:
        super().__init__()
        self.encoder = mlp([joints, *hidden, code], activation=nn.ELU)
        self.decoder = mlp([code, *reversed(hidden), joints], activation=nn.ELU)

    def forward(self, pose: Tensor) -> Tensor:
        return self.decoder(self.encoder(pose))


class LearnPoses(Job):
    """Trains an auto-encoder on drawn poses by gradient descent on the mean squared error.

    A sample is a pose; the poses come from what fills the slot ``poses``.
    """

    @dataclass(frozen=True)
    class Options:
        code: int = 2  #: L
        hidden: tuple[int, ...] = (32,)
        batch: int = 256  #: poses of an iteration
        learning_rate: float = 3e-3

        def __post_init__(self) -> None:
            check_range(self, "code", "batch", least=1)
            check_range(self, "learning_rate", above=0)

    def __init__(self, options: Options, experiment: Experiment) -> None:
        self.options, self._seed = options, experiment.root.seed
        self.device = device_of(experiment.root.device)
        self.poses: Poses = experiment.need("poses").build()
        with private_rng(self._seed, "autoencoder"):
            network = AutoEncoder(self.poses.joints, options.code, options.hidden)
        self.network = network.to(self.device)

    def prepare(self) -> None:
        rate = torch.tensor(self.options.learning_rate, device=self.device)
        self._optimiser = optimisers.adam(list(self.network.parameters()), rate)
        self._generator = generator(self._seed, "poses", self.device)

    def iterate(self, samples: int) -> dict[str, Any]:
        u = torch.rand(self.options.batch, 2, generator=self._generator, device=self.device)
        pose = self.poses.draw(u)
        self._optimiser.zero_grad()
        loss = (self.network(pose) - pose).square().mean()
        loss.backward()
        distributed.average_gradients(list(self.network.parameters()), loss.detach().view(1))
        self._optimiser.step()
        return {"consumed": len(pose) * distributed.size(), "loss": float(loss.detach())}

    @torch.no_grad()
    def evaluate(
        self, draw: str, episodes: int, *, give_up_below: float | None = None
    ) -> Evaluation:
        """The root mean square error of the angles, rad, over `episodes` poses."""
        u = WorldStreams(self._seed, f"poses/{draw}", episodes, self.device).uniform(2)
        pose = self.poses.draw(u)
        error = (self.network(pose) - pose).square().mean(dim=1).sqrt()
        measures = {"error": Measured.of("last", error.cpu())}
        return Evaluation(episodes=episodes, measures=measures, objective="error")

    def state_dict(self) -> State:
        return {
            "network": dict(self.network.state_dict()),
            "optimiser": optimisers.state_of(self._optimiser),
            "generator": self._generator.get_state(),
        }

    def load_state_dict(self, state: State) -> None:
        self.load_learned(state, 0)
        optimisers.load_state(self._optimiser, state["optimiser"])
        self._generator.set_state(state["generator"])

    def load_learned(self, state: State, samples: int) -> None:
        for misfit in misshapen(dict(self.network.state_dict()), state.get("network"), "network"):
            raise RunError(f"The checkpoint does not fit this auto-encoder: {misfit}.")
        self.network.load_state_dict(state["network"])


def trained_decoder(run: str, context: Context) -> tuple[nn.Module, int]:
    """The frozen decoder that the run folder `run` has, and how many numbers it takes.

    Raises
    ------
    RunError
        if it is no run of the job 'miniature.autoencoder'.
    """
    assert context.registry is not None
    experiment = validate(runs.open_run(run).config, context.registry)
    job = experiment.one("job")
    if job is None or job.component.factory is not LearnPoses:
        raise RunError(f"{run} trained no auto-encoder (experiment=miniature/poses).")
    options: LearnPoses.Options = job.options
    joints = experiment.need("poses").build().joints
    network = AutoEncoder(joints, options.code, options.hidden)
    network.load_state_dict(newest_state(run)["network"])
    return network.decoder.requires_grad_(False).to(context.device), options.code


# ---------------------------------------------------------------------- the arm


class ArmScene(Scene):
    """A chain of equal links in a plane, fixed at the origin; straight, it lies along the first axis."""

    @dataclass(frozen=True)
    class Options:
        joints: int = 8
        length: float = 1.0  #: m, of all links
        lag: float = 0.1  #: s, time constant with which a joint follows its target

        def __post_init__(self) -> None:
            check_range(self, "joints", least=1)
            check_range(self, "length", "lag", above=0)

    def __init__(self, options: Options, context: Context) -> None:
        self.options = options

    def describe(self) -> dict[str, Any]:
        return {"joints": self.options.joints, "length_m": self.options.length}


class Arm(Simulator):
    """Each joint follows its target (N, J), rad, with a first-order lag, exactly."""

    state_fields = ("angles",)

    def __init__(self, options: None, context: Context) -> None:
        scene = context.need_scene(ArmScene, "simulator 'miniature.arm'").options
        self.control_size, self._substeps = scene.joints, context.substeps
        self.fields: Mapping[str, Shape] = {"angles": (scene.joints,)}
        self._angles = torch.zeros(context.num_worlds, scene.joints, device=context.device)
        self._share = 1 - math.exp(-context.control_dt / context.substeps / scene.lag)

    def read(self, name: str) -> Tensor:
        return self._angles

    def set_state(self, worlds: Tensor, state: Mapping[str, Tensor]) -> None:
        self._angles.copy_(torch.where(worlds.unsqueeze(1), state["angles"], self._angles))

    def step(self, control: Tensor, substeps: int | None = None) -> None:
        for _ in range(substeps or self._substeps):
            self._angles.lerp_(control, self._share)

    def failed(self) -> Tensor:
        return ~(self._angles.abs() < 1e6).all(dim=1)

    def snapshot(self) -> dict[str, Tensor]:
        return {"angles": self._angles.clone()}

    def restore(self, snapshot: Mapping[str, Tensor], worlds: Tensor | None = None) -> None:
        if worlds is None:
            worlds = torch.ones_like(self._angles[:, 0], dtype=torch.bool)
        self.set_state(worlds, snapshot)


class Straight(InitialStates):
    """The arm nearly straight."""

    def __init__(self, options: None, context: Context) -> None:
        scene = context.need_scene(ArmScene, "initial_states 'miniature.straight'").options
        self._joints = scene.joints

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        return {"angles": 0.1 * streams.normal(self._joints)}


class Tip(Fields):
    """Where the arm ends, m."""

    reads = ("angles",)
    provides = {"tip": (2,)}

    def __init__(self, options: None, context: Context) -> None:
        scene = context.need_scene(ArmScene, "fields 'miniature.tip'").options
        self._link = scene.length / scene.joints

    def compute(self, angles: Tensor) -> dict[str, Tensor]:
        heading = angles.cumsum(dim=1)
        links = torch.stack([heading.cos(), heading.sin()], dim=2)
        return {"tip": self._link * links.sum(dim=1)}


class Posture(Encoder):
    """Joint angles and where the tip should go, (N, J + 2)."""

    reads = ("angles", "target")

    def __init__(self, options: None, context: Context) -> None:
        scene = context.need_scene(ArmScene, "encoder 'miniature.posture'").options
        self.shape = (scene.joints + 2,)

    def encode(self, angles: Tensor, target: Tensor) -> Tensor:
        return torch.cat([angles, target], dim=1)


class DecodedPose(Actuation):
    """Joint targets: the pose that a trained decoder makes of a code, plus an offset that is zero
    unless it is large enough.

    The offset that was used is the field ``pose_offset``.
    """

    keeps: Mapping[str, Shape]

    @dataclass(frozen=True)
    class Options:
        run: str  #: folder of the run that trained the auto-encoder
        code_scale: float = 2.0
        offset_scale: float = 0.2  #: rad
        dead: float = 0.1  #: rad, the size of an offset below which it is none

        def __post_init__(self) -> None:
            check_range(self, "code_scale", "offset_scale", above=0)
            check_range(self, "dead", least=0)

    def __init__(self, options: Options, context: Context) -> None:
        assert context.simulator is not None
        joints = context.simulator.control_size
        self._options = options
        self._decoder, code = trained_decoder(options.run, context)
        made = self._decoder(torch.zeros(1, code, device=context.device)).shape[1]
        if made != joints:
            raise ConfigError(
                f"actuation.run={options.run} makes poses of {made} joints; this arm has {joints}."
            )
        self.action_space = ActionSpace({"code": Box(code), "offset": Box(joints)})
        self.keeps = {"pose_offset": (joints,)}
        self._none = torch.zeros(context.num_worlds, joints, device=context.device)

    def _offset(self, action: Tensor) -> Tensor:
        offset = self._options.offset_scale * self.action_space.split(action)["offset"]
        return torch.where(offset.abs() < self._options.dead, 0.0, offset)

    def begin(self) -> dict[str, Tensor]:
        return {"pose_offset": self._none}

    def advance(self, action: Tensor) -> dict[str, Tensor]:
        return {"pose_offset": self._offset(action)}

    def control(self, action: Tensor) -> Tensor:
        code = self._options.code_scale * torch.tanh(self.action_space.split(action)["code"])
        return self._decoder(code) + self._offset(action)


def sparse(pose_offset: Tensor, *, scale: float = 1.0) -> Tensor:
    """exp(-mean |offset| / scale): 1 where the decoded pose is used as it is."""
    return torch.exp(-pose_offset.abs().mean(dim=1) / scale)
