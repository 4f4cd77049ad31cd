"""The job that trains a pose auto-encoder (thesis, section 4.4.2), and what other runs take from it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from understudy import distributed
from understudy.errors import RunError
from understudy.options import check_range
from understudy.random import generator, private_rng
from understudy.records import runs
from understudy.records.checkpoint import misshapen
from understudy.records.runs import Run, newest_state
from understudy.setup.building import device_of
from understudy.setup.config import Experiment
from understudy.task import Context, State
from understudy_characters.character import load_character
from understudy_motion.reading import Axis, ReadOptions, Unit
from understudy_networks.nn import mlp
from understudy_networks.supervised import NetworkJob
from understudy_pose_vae import pictures
from understudy_pose_vae.clips import PoseSet, read_poses
from understudy_pose_vae.features import PoseFeatures
from understudy_reinforcement.evaluation import Evaluation, Measured
from understudy_skills.kept import files_of
from understudy_tensors import rotations


class PoseVAE(nn.Module):
    """Features (B, D) to a Gaussian over codes (B, L) and back; two hidden layers with tanh each way.

    ``code_mean`` and ``code_std`` (L,) are of the codes of the poses learned from.
    """

    code_mean: Tensor
    code_std: Tensor

    def __init__(self, features: int, latent: int, hidden: Sequence[int]) -> None:
        super().__init__()
        self.encoder = mlp([features, *hidden, 2 * latent], activation=nn.Tanh)
        self.decoder = mlp([latent, *reversed(hidden), features], activation=nn.Tanh)
        self.register_buffer("code_mean", torch.zeros(latent))
        self.register_buffer("code_std", torch.ones(latent))

    def encode(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """μ_x and log σ²_x, each (B, L)."""
        mean, log_variance = self.encoder(x).chunk(2, dim=1)
        return mean, log_variance

    def reconstruct(self, x: Tensor) -> Tensor:
        """x' (B, D) from the mean code."""
        return self.decoder(self.encode(x)[0])

    def loss(self, x: Tensor, noise: Tensor, beta: float) -> tuple[Tensor, Tensor]:
        """L_MSE(x, x') + β KL(N(μ_x, Σ_x), N(0, I)) (eq. 4.2), and the first of the two.

        The error is a mean over numbers and poses, the divergence a sum over codes and a mean over poses.
        (The authors' release sums it over the batch too, which is a β of 1.28e-3 here.)
        """
        mean, log_variance = self.encode(x)
        error = (self.decoder(mean + (0.5 * log_variance).exp() * noise) - x).square().mean()
        divergence = 0.5 * (mean.square() + log_variance.exp() - 1 - log_variance).sum(1).mean()
        return error + beta * divergence, error

    @torch.no_grad()
    def note_codes(self, x: Tensor) -> None:
        """Set ``code_mean`` and ``code_std`` from the features `x` (P, D)."""
        mean, _ = self.encode(x)
        self.code_mean.copy_(mean.mean(0))
        self.code_std.copy_(mean.std(0))


class LearnPoses(NetworkJob[PoseVAE]):
    """Trains a :class:`PoseVAE`. A sample is a pose; an iteration is every pose once, in mini-batches."""

    @dataclass(frozen=True)
    class Options:
        #: Folders of clips, clip files, names of generated clips, or names in $UNDERSTUDY_DATA/motions.
        clips: tuple[str, ...]
        character: str = "humanoid"  #: the character whose joints and lengths the poses have
        #: whether each pose's mirror image is learned, too; with them the authors' clips are 20 230
        #: poses
        mirror: bool = True
        held_out: float = 0.1  #: share of the clips that only evaluations see
        #: L, how many numbers the code has; null takes as many as principal components cover
        #: ``coverage``
        latent: int | None = 13
        coverage: float = 0.85  #: share of the poses' variance that ``latent=null`` has to cover
        #: units of the encoder's layers, and in reverse of the decoder's (section 4.4)
        hidden: tuple[int, ...] = (256, 256)
        beta: float = 1e-5  #: weight of the KL divergence (section 4.4), from 0
        batch: int = 128  #: poses of an optimiser step, from 1
        learning_rate: float = 1e-4  #: learning rate of Adam, above 0 (section 4.4)
        unit: Unit | None = None  #: unit of lengths, where a clip file does not give it
        up: Axis | None = None  #: the vertical axis, where a clip file does not give it
        rate: float | None = None  #: frames per second, where a clip file does not give them

        def __post_init__(self) -> None:
            check_range(self, "latent", "batch", "hidden", least=1, most=10_000)
            check_range(self, "beta", least=0)
            check_range(self, "learning_rate", "rate", above=0)
            check_range(self, "held_out", "coverage", above=0, most=0.99)
            if not self.clips:
                raise ValueError("clips=() is not possible: name clips, or a folder of clips.")

    network: PoseVAE

    def __init__(self, options: Options, experiment: Experiment) -> None:
        self.options, self._seed = options, experiment.root.seed
        self._registry = experiment.registry
        self.device = device_of(experiment.root.device)
        self._features = PoseFeatures(load_character(options.character, self._registry))
        self._set: PoseSet | None = None

    @property
    def poses(self) -> PoseSet:
        """What is learned from and what is held out; read when it is first asked for."""
        if self._set is None:
            options = self.options
            reading = ReadOptions(unit=options.unit, up=options.up, rate=options.rate)
            self._set = read_poses(
                options.clips,
                self._features,
                self._registry,
                reading,
                mirror=options.mirror,
                held_out=options.held_out,
                seed=self._seed,
            )
        return self._set

    def prepare(self) -> None:
        options = self.options
        latent = options.latent or needed(explained(self.poses.features), options.coverage)
        with private_rng(self._seed, "pose_vae"):
            network = PoseVAE(self._features.size, latent, options.hidden)
        self.network = network.to(self.device)
        self._x = self.poses.features.to(self.device)
        self.begin(options.learning_rate, self._seed, "pose_vae/batches")

    def iterate(self, samples: int) -> dict[str, Any]:
        options, x, network = self.options, self._x, self.network
        size = min(options.batch, len(x))
        order = torch.randperm(len(x), generator=self.generator, device=self.device)
        batches = order[: len(x) // size * size].view(-1, size)
        sums = torch.zeros(2, device=self.device)
        latent = network.code_mean.shape[0]
        for rows in batches:
            noise = torch.randn(size, latent, generator=self.generator, device=self.device)
            found = torch.stack(network.loss(x[rows], noise, options.beta))
            sums += self.descend(found[0], found)
        network.note_codes(x)
        loss, error = (sums / len(batches)).tolist()
        return {"consumed": batches.numel() * distributed.size(), "loss": loss, "error": error}

    @torch.no_grad()
    def evaluate(
        self, draw: str, episodes: int, *, give_up_below: float | None = None
    ) -> Evaluation:
        """Of `episodes` poses of clips that were held out, or of all where these are fewer:

        ``rotation_error`` (deg), over joints; ``position_error`` (cm), over joints and tips, in the
        root's frame; ``explained_variance``, of the features.
        """
        stream = generator(self._seed, f"pose_vae/{draw}")
        rows = torch.randperm(len(self.poses.held_out_features), generator=stream)[:episodes]
        pose, x = self.poses.held_out_poses[rows], self.poses.held_out_features[rows]
        made = self.network.reconstruct(x.to(self.device)).cpu()
        mean = self.poses.features.mean(0)
        total = (self.poses.held_out_features - mean).square().sum(1).mean()
        values = {
            **errors(self._features, pose, self._features.rotations(made)),
            "explained_variance": 1 - (made - x).square().sum(1) / total,
        }
        measures = {name: Measured.of("last", value) for name, value in values.items()}
        return Evaluation(episodes=len(rows), measures=measures, objective="explained_variance")

    @torch.no_grad()
    def products(self, run: Run) -> None:
        """Leaves :data:`pictures.FILE`: poses that it makes, and what principal components would."""
        features, poses = self._features, self.poses
        network = self.network.cpu()
        stream = generator(self._seed, "pose_vae/pictures")
        codes = torch.randn(pictures.SAMPLES, len(network.code_mean), generator=stream)
        steps = torch.linspace(-2.0, 2.0, pictures.STEPS)
        along = torch.eye(len(network.code_mean))[:, None] * steps[:, None]
        shown = torch.randperm(len(poses.held_out_poses), generator=stream)[: pictures.PAIRS]

        def made(codes: Tensor) -> Tensor:
            code = network.code_mean + network.code_std * codes
            return features.rotations(network.decoder(code))

        rebuilt = features.rotations(network.reconstruct(poses.held_out_features[shown]))
        share = explained(poses.features)
        latent = len(network.code_mean)
        linear = projected(poses.features, poses.held_out_features, latent)
        beside = errors(features, poses.held_out_poses, features.rotations(linear))
        mean = poses.features.mean(0)
        spread = (poses.held_out_features - mean).square().sum()
        pictures.save(
            run.path / pictures.FILE,
            features,
            {
                "samples": made(codes),
                "along": made(along.flatten(0, 1)),
                "given": poses.held_out_poses[shown],
                "rebuilt": rebuilt,
            },
            {
                "explained": share.numpy(),
                "latent": np.array(latent),
                "poses": np.array([len(poses.poses), len(poses.held_out_poses)]),
                "principal": np.array([
                    *(float(v.mean()) for v in beside.values()),
                    1 - float((linear - poses.held_out_features).square().sum() / spread),
                ]),
            },
        )  # fmt: skip
        np.save(run.path / POSES, poses.poses.half().numpy(), allow_pickle=False)
        self.network.to(self.device)

    def sources(self) -> Mapping[str, Any]:
        return self.poses.sources

    def load_learned(self, state: State, samples: int) -> None:
        self.network = network_of(state, self.options, self._features).to(self.device)


#: In the run folder: the poses learned from, (P, J, 4) float16.
POSES = "poses.npy"


@dataclass(frozen=True)
class TrainedPoses:
    """What another run takes from a run of this job."""

    network: PoseVAE  #: frozen
    joints: tuple[str, ...]
    run: str


def trained_poses(run: str, context: Context) -> TrainedPoses:
    """The auto-encoder of the run folder `run`, of which the run that takes it keeps a copy.

    Raises
    ------
    RunError
        if it is no run of the job 'pose_vae/autoencoder', or its checkpoint does not fit.
    """
    registry = context.registry
    assert registry is not None

    kept = context.inputs.file(f"pose auto-encoder {run}", lambda: files_of(run)).parent
    job = runs.open_run(kept).experiment(registry).one("job")
    if job is None or job.component.factory is not LearnPoses:
        raise RunError(f"{run} trained no pose auto-encoder (experiment=pose_vae/poses).")
    features = PoseFeatures(load_character(job.options.character, registry))
    network = network_of(newest_state(str(kept)), job.options, features)
    return TrainedPoses(network.requires_grad_(False).to(context.device), features.joints, run)


def network_of(state: State, options: LearnPoses.Options, features: PoseFeatures) -> PoseVAE:
    """The network of a checkpoint, which says itself how many numbers a code has."""
    given = state.get("network")
    codes = given.get("code_mean") if isinstance(given, Mapping) else None
    if not isinstance(given, Mapping) or not isinstance(codes, Tensor) or codes.dim() != 1:
        raise RunError("The checkpoint is of no pose auto-encoder: it has no codes.")
    network = PoseVAE(features.size, len(codes), options.hidden)
    for misfit in misshapen(dict(network.state_dict()), given, "network"):
        raise RunError(f"The checkpoint does not fit this auto-encoder: {misfit}.")
    network.load_state_dict(given)
    return network


# ---------------------------------------------------------------------- how good it is


def errors(features: PoseFeatures, pose: Tensor, made: Tensor) -> dict[str, Tensor]:
    """Of poses `made` for `pose`, each (F, J, 4): ``rotation_error`` (F,) in degrees and
    ``position_error`` (F,) in cm."""
    angle = rotations.angle_between(pose.double(), made.double()).mean(1)
    away = (features.places(made) - features.places(pose)).norm(dim=-1).mean(1)
    return {"rotation_error": angle * (180 / math.pi), "position_error": 100 * away}


def explained(x: Tensor) -> Tensor:
    """(D,): the share of the variance of `x` (P, D) that its first principal components cover."""
    values = torch.linalg.svdvals((x - x.mean(0)).double()).square()
    return values.cumsum(0) / values.sum()


def needed(share: Tensor, coverage: float) -> int:
    """How many principal components cover `coverage` of the variance."""
    return int((share < coverage).sum()) + 1


def projected(x: Tensor, y: Tensor, count: int) -> Tensor:
    """`y` (Q, D) from its first `count` principal components of `x` (P, D)."""
    mean = x.mean(0)
    axes = torch.linalg.svd(x - mean, full_matrices=False).Vh[:count]
    return mean + (y - mean) @ axes.T @ axes
