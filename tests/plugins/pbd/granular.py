"""Small scenes of particles, for the tests of the solver."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
import warp as wp
from torch import Tensor

from understudy.task import Context
from understudy_pbd.rules import Particles, Rule
from understudy_pbd.scene import ParticleModel, ParticleScene, Springs
from understudy_pbd.simulator import ParticleSimulator

#: m, kg, s
RADIUS, MASS, PERIOD = 0.01, 0.01, 1 / 60


class Scene(ParticleScene):
    def __init__(self, model: ParticleModel) -> None:
        self._model = model

    def model(self) -> ParticleModel:
        return self._model


def lattice(counts: tuple[int, int, int], spacing: float, corner: tuple[float, ...]) -> np.ndarray:
    axes = [np.arange(count) * spacing for count in counts]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3) + np.array(corner)


def disturbed(positions: np.ndarray, by: float, seed: int = 0) -> np.ndarray:
    return positions + np.random.default_rng(seed).uniform(-by, by, positions.shape)


def tied(positions: np.ndarray, reach: float, **options: Any) -> Springs:
    """Springs between all that are within `reach`."""
    distances = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
    i, j = np.nonzero(np.triu(distances < reach, 1))
    return Springs(np.stack([i, j], axis=1), distances[i, j], **options)


def simulator(
    model: ParticleModel, worlds: int = 1, device: str = "cpu", substeps: int = 4, **options: Any
) -> ParticleSimulator:
    context = Context(0, torch.device(device), worlds, PERIOD, substeps, scene=Scene(model))
    return ParticleSimulator(ParticleSimulator.Options(**options), context)


def control(found: ParticleSimulator, *pose: float) -> Tensor:
    """The same target pose in all worlds."""
    worlds = len(found.read("particle_position"))
    device = found.read("particle_position").device
    return torch.tensor([pose], device=device).view(1, -1).repeat(worlds, 1).float()


def run(found: ParticleSimulator, periods: int, *pose: float) -> Tensor:
    """Positions (N, P, 3) after so many control periods."""
    target = control(found, *pose)
    for _ in range(periods):
        found.step(target)
    return found.read("particle_position")


@wp.kernel
def _yield(
    position: wp.array2d(dtype=wp.vec3),  # pyright: ignore[reportInvalidTypeForm]
    partner: wp.array3d(dtype=int),  # pyright: ignore[reportInvalidTypeForm]
    length: wp.array3d(dtype=float),  # pyright: ignore[reportInvalidTypeForm]
    broken: wp.array2d(dtype=int),  # pyright: ignore[reportInvalidTypeForm]
    break_at: float,
    yield_at: float,
):
    world, i = wp.tid()
    for k in range(partner.shape[2]):
        j = partner[world, i, k]
        if j >= 0:
            d = wp.length(position[world, i] - position[world, j])
            if d > break_at:
                partner[world, i, k] = -1
                broken[world, i] += 1
            elif wp.abs(d / length[world, i, k] - 1.0) > yield_at:
                length[world, i, k] = d


class Yielding(Rule):
    """Springs that break, and that keep a length far from their own."""

    reach = 3 * RADIUS

    def __init__(self, break_at: float, yield_at: float) -> None:
        self._limits = (break_at, yield_at)

    def build(self, particles: Particles) -> None:
        self._broken = wp.zeros((particles.worlds, particles.count), dtype=int)

    def before(self, particles: Particles) -> None:
        wp.launch(
            _yield,
            dim=(particles.worlds, particles.count),
            inputs=[
                particles.position,
                particles.spring_partner,
                particles.spring_length,
                self._broken,
                *self._limits,
            ],
        )

    def state(self) -> dict[str, Tensor]:
        return {"broken": wp.to_torch(self._broken)}
