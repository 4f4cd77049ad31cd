"""The auto-encoder whose features a style is made of (Holden et al. 2016; thesis, section 3.3.3), as a
job: ``understudy train experiment=styles/autoencoder``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from understudy import distributed
from understudy.errors import ConfigError, RunError
from understudy.options import check_range
from understudy.random import WorldStreams, private_rng
from understudy.records import runs
from understudy.records.checkpoint import misshapen
from understudy.records.runs import newest_state
from understudy.setup.building import build_scene, device_of
from understudy.setup.config import Experiment
from understudy.setup.registry import Registry
from understudy_characters.scene import CharacterScene
from understudy_motion import library
from understudy_motion.clip import Clip
from understudy_motion.origin import terms_of
from understudy_networks.supervised import NetworkJob
from understudy_reinforcement.evaluation import Evaluation, Measured
from understudy_styles.features import clip_features


class MotionAutoEncoder(nn.Module):
    """Windows of frames (B, K, D) to features (B, C, K) by one convolution over time and ReLU, and back.

    Holden et al. have 256 features of 25 frames at 60 Hz, and halve the frame rate by pooling; here
    the frame rate is the control's, so there is nothing to halve.
    """

    mean: Tensor
    deviation: Tensor

    def __init__(self, size: int, channels: int, width: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("deviation", torch.ones(size))
        self.encoder = nn.Conv1d(size, channels, width, padding="same")
        self.decoder = nn.Conv1d(channels, size, width, padding="same")

    def normalised(self, frames: Tensor) -> Tensor:
        """(B, D, K)"""
        return ((frames - self.mean) / self.deviation).mT

    def features(self, frames: Tensor) -> Tensor:
        """(B, C, K)"""
        return self.encoder(self.normalised(frames)).relu()

    def gram(self, frames: Tensor) -> Tensor:
        """(B, C, C): Φ Φᵀ / K, what the features do together, whenever they do it."""
        features = self.features(frames)
        return torch.bmm(features, features.mT) / frames.shape[1]


class LearnFeatures(NetworkJob[MotionAutoEncoder]):
    """Trains the auto-encoder on windows of clips, from frames with noise on them, by Adam on the mean
    squared error of normalised frames.

    A sample is a window. The last fifth of each clip is kept for evaluations; where that is shorter
    than a window, evaluations see what training does.
    """

    @dataclass(frozen=True)
    class Options:
        clips: tuple[str, ...]  #: names of generated clips, or clip files
        window: int = 32  #: K, how many frames a window has, from 2
        channels: int = 64  #: C, how many features a frame has
        width: int = 9  #: frames that the convolution spans; 0.3 s at 30 Hz
        batch: int = 64  #: windows in an optimiser step, from 1
        learning_rate: float = 1e-3  #: learning rate of Adam, above 0
        noise: float = 0.1  #: noise that is added to the input, in its standard deviations

        def __post_init__(self) -> None:
            check_range(self, "window", least=2, most=10_000)
            check_range(self, "channels", "width", "batch", least=1, most=10_000)
            check_range(self, "learning_rate", above=0)
            check_range(self, "noise", least=0)
            if not self.clips:
                raise ValueError("clips must not be empty.")

    def __init__(self, options: Options, experiment: Experiment) -> None:
        self.options, root = options, experiment.root
        self._seed, self.device = root.seed, device_of(root.device)
        self._dt = 1.0 / root.control.frequency
        scene = build_scene(experiment, {}).scene
        if not isinstance(scene, CharacterScene):
            raise ConfigError("job 'styles/autoencoder' needs a character (scene=humanoid).")
        self._scene, self._registry = scene, experiment.registry
        self.network = new_network(options, scene, root.seed).to(self.device)
        self._windows: dict[str, Tensor] = {}
        self._clips: list[Clip] = []

    def prepare(self) -> None:
        self._load()
        seen = self._windows["training"].flatten(0, 1)
        self.network.mean.copy_(seen.mean(0))
        self.network.deviation.copy_(seen.std(0).clamp(min=1e-2))
        self.begin(self.options.learning_rate, self._seed, "windows")

    def _load(self) -> None:
        """All windows, (W, K, D)."""
        if self._windows:
            return
        window = self.options.window
        found: dict[str, list[Tensor]] = {"training": [], "held_out": []}
        for source in self.options.clips:
            clip = library.find(source, self._registry)
            self._clips.append(clip)
            frames = clip_features(clip, self._scene, self._dt, window, source)
            split = len(frames) - max(len(frames) // 5, 0)
            parts = (frames[:split], frames[split:])
            if min(map(len, parts)) < window:
                parts = (frames, frames)
            for part, name in zip(parts, found, strict=True):
                found[name].append(part.unfold(0, window, 1).mT)
        self._windows = {name: torch.cat(w).to(self.device) for name, w in found.items()}

    def sources(self) -> Mapping[str, Any]:
        return {"clips": terms_of(self._clips)}

    def iterate(self, samples: int) -> dict[str, Any]:
        windows, batch = self._windows["training"], self.options.batch
        rows = torch.randint(len(windows), (batch,), generator=self.generator, device=self.device)
        frames = windows[rows]
        noise = torch.randn(frames.shape, generator=self.generator, device=self.device)
        noisy = frames + self.options.noise * self.network.deviation * noise
        loss = self._errors(frames, noisy).mean()
        self.descend(loss, loss.view(1))
        return {"consumed": batch * distributed.size(), "loss": float(loss.detach())}

    def _errors(self, frames: Tensor, given: Tensor) -> Tensor:
        """(B,) mean squared errors of `frames` (B, K, D) rebuilt from `given`, in deviations²."""
        rebuilt = self.network.decoder(self.network.features(given))
        return (rebuilt - self.network.normalised(frames)).square().mean(dim=(1, 2))

    @torch.no_grad()
    def evaluate(
        self, draw: str, episodes: int, *, give_up_below: float | None = None
    ) -> Evaluation:
        """The root mean square error over `episodes` windows, in standard deviations of the frames."""
        self._load()
        windows = self._windows["held_out"]
        u = WorldStreams(self._seed, f"windows/{draw}", episodes, self.device).uniform(1)[:, 0]
        frames = windows[(u * len(windows)).long()]
        error = self._errors(frames, frames).sqrt()
        return Evaluation(
            episodes=episodes,
            measures={"error": Measured.of("last", error.cpu())},
            objective="error",
        )


def new_network(
    options: LearnFeatures.Options, scene: CharacterScene, seed: int
) -> MotionAutoEncoder:
    """Untrained, its weights drawn from the seed alone."""
    size = 3 * len(scene.layout.link_names) + 5
    with private_rng(seed, "autoencoder"):
        return MotionAutoEncoder(size, options.channels, options.width)


def trained_network(run: str, scene: CharacterScene, registry: Registry) -> MotionAutoEncoder:
    """The frozen auto-encoder of the run folder `run`.

    Raises
    ------
    RunError
        it is no run of the job 'styles/autoencoder', or one of another character.
    """
    job = runs.open_run(run).experiment(registry).one("job")
    if job is None or job.component.factory is not LearnFeatures:
        raise RunError(f"{run} trained no auto-encoder of motions (experiment=styles/autoencoder).")
    network = new_network(job.options, scene, 0)
    state: Any = newest_state(run).get("network")
    for misfit in misshapen(dict(network.state_dict()), state, "network"):
        raise RunError(f"The auto-encoder of {run} is of another character: {misfit}.")
    network.load_state_dict(state)
    return network.requires_grad_(False)
