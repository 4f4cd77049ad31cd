"""Poses of an arm, and an auto-encoder of them: a job of this plugin's own, with a slot of its own."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from understudy import distributed
from understudy.errors import RunError
from understudy.options import check_range
from understudy.random import WorldStreams, private_rng
from understudy.records import runs
from understudy.records.checkpoint import misshapen
from understudy.records.runs import newest_state
from understudy.setup.building import device_of
from understudy.setup.config import Experiment
from understudy.task import Context
from understudy_networks.nn import mlp
from understudy_networks.supervised import NetworkJob
from understudy_reinforcement.evaluation import Evaluation, Measured


class Poses(ABC):
    """Where poses to learn from come from; a kind of this plugin's own, built with ``(options,)``."""

    #: J, how many joint angles a pose has.
    joints: int

    @abstractmethod
    def draw(self, u: Tensor) -> Tensor:
        """Poses (B, J), rad, from random numbers `u` (B, 2) in [0, 1)."""


class Arcs(Poses):
    """Arcs and waves: every joint bends alike, except for a wave along the arm. Two numbers make a pose."""

    @dataclass(frozen=True)
    class Options:
        joints: int = 8  #: how many joints the arm has, from 1
        bend: float = 2.0  #: rad, greatest bend of the whole arm, to either side
        wave: float = 0.5  #: rad, greatest deviation of a joint by the wave, to either side

        def __post_init__(self) -> None:
            check_range(self, "joints", least=1, most=1000)
            check_range(self, "bend", "wave", least=0, most=100)

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


class LearnPoses(NetworkJob[AutoEncoder]):
    """Trains an auto-encoder on drawn poses by gradient descent on the mean squared error.

    A sample is a pose; the poses come from what fills the slot ``poses``.
    """

    @dataclass(frozen=True)
    class Options:
        code: int = 2  #: L, how many numbers the code has
        #: units of the encoder's layers, and in reverse of the decoder's
        hidden: tuple[int, ...] = (32,)
        batch: int = 256  #: poses of an iteration
        learning_rate: float = 3e-3  #: learning rate of gradient descent, above 0

        def __post_init__(self) -> None:
            check_range(self, "code", "batch", "hidden", least=1, most=10_000)
            check_range(self, "learning_rate", above=0)

    def __init__(self, options: Options, experiment: Experiment) -> None:
        self.options, self._seed = options, experiment.root.seed
        self.device = device_of(experiment.root.device)
        self.poses: Poses = experiment.need("poses").build()
        with private_rng(self._seed, "autoencoder"):
            network = AutoEncoder(self.poses.joints, options.code, options.hidden)
        self.network = network.to(self.device)

    def prepare(self) -> None:
        self.begin(self.options.learning_rate, self._seed, "poses")

    def iterate(self, samples: int) -> dict[str, Any]:
        u = torch.rand(self.options.batch, 2, generator=self.generator, device=self.device)
        pose = self.poses.draw(u)
        loss = (self.network(pose) - pose).square().mean()
        self.descend(loss, loss.view(1))
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
        return Evaluation(episodes=episodes, measures=measures)


def trained_decoder(run: str, context: Context) -> tuple[nn.Module, int]:
    """The frozen decoder that the run folder `run` has, and how many numbers it takes.

    Raises
    ------
    RunError
        if it is no run of the job 'miniature/autoencoder'.
    """
    assert context.registry is not None
    experiment = runs.open_run(run).experiment(context.registry)
    job = experiment.one("job")
    if job is None or job.component.factory is not LearnPoses:
        raise RunError(f"{run} trained no auto-encoder (experiment=miniature/poses).")
    options: LearnPoses.Options = job.options
    joints = experiment.need("poses").build().joints
    network = AutoEncoder(joints, options.code, options.hidden)
    state: Any = newest_state(run).get("network")
    for misfit in misshapen(dict(network.state_dict()), state, "network"):
        raise RunError(f"The auto-encoder of {run} does not fit its own configuration: {misfit}.")
    network.load_state_dict(state)
    return network.decoder.requires_grad_(False).to(context.device), options.code
