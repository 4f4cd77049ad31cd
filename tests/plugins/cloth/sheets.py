"""Pieces of cloth, and a simulator of one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from understudy.task import Context
from understudy_cloth.scene import ClothModel, ClothScene
from understudy_cloth.simulator import ClothSimulator

EDGE = 0.0225


class Scene(ClothScene):
    def __init__(self, model: ClothModel) -> None:
        self._model = model

    def model(self) -> ClothModel:
        return self._model


def sheet(n: int, m: int, edge: float = EDGE, z: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n · m, 3) in the plane z, row by row along x, and triangles that face up."""
    x = np.array([[i * edge, j * edge, z] for j in range(m) for i in range(n)])
    faces = []
    for j in range(m - 1):
        for i in range(n - 1):
            p = j * n + i
            q, s, t = p + 1, p + n, p + n + 1
            faces += [(p, q, t), (p, t, s)] if (i + j) % 2 == 0 else [(p, q, s), (q, t, s)]
    return x, np.array(faces)


def tube(
    around: int, rows: int, radius: float, edge: float = EDGE
) -> tuple[np.ndarray, np.ndarray]:
    """A tube along x, its triangles face out."""
    a = 2 * np.pi * np.arange(around) / around
    ring = np.stack([np.zeros(around), np.cos(a), np.sin(a)], 1)
    x = np.concatenate([radius * ring + (edge * r, 0, 0) for r in range(rows)])
    faces = []
    for r in range(rows - 1):
        for k in range(around):
            p, q = r * around + k, r * around + (k + 1) % around
            s, t = p + around, q + around
            faces += [(p, q, t), (p, t, s)] if (r + k) % 2 == 0 else [(p, q, s), (q, t, s)]
    return x, np.array(faces)


def simulator(
    model: ClothModel,
    worlds: int = 1,
    device: str = "cpu",
    substeps: int = 20,
    period: float = 0.01,
    **options: Any,
) -> ClothSimulator:
    context = Context(0, torch.device(device), worlds, period, substeps, scene=Scene(model))
    return ClothSimulator(ClothSimulator.Options(**options), context)


def control(found: ClothSimulator, *values: float) -> Tensor:
    """The same for all worlds; zeros beyond what is given."""
    n = found.read("cloth_position").shape[0]
    full = list(values) + [0.0] * (found.control_size - len(values))
    return torch.tensor([full] * n, device=found.read("cloth_position").device)


def run(found: ClothSimulator, periods: int, *values: float) -> np.ndarray:
    """Positions (V, 3) of the first world afterwards."""
    target = control(found, *values)
    for _ in range(periods):
        found.step(target)
    return found.read("cloth_position")[0].double().cpu().numpy()


def along(ends: tuple[Sequence[float], Sequence[float]]) -> dict[str, Any]:
    """Position, orientation and half length of a capsule between two points."""
    a, b = np.asarray(ends[0], float), np.asarray(ends[1], float)
    d = (b - a) / np.linalg.norm(b - a)
    q = np.array([1 + d[2], -d[1], d[0], 0.0]) if d[2] > -0.999 else np.array([0.0, 1, 0, 0])
    return {
        "position": tuple(0.5 * (a + b)),
        "orientation": tuple(q / np.linalg.norm(q)),
        "half_length": 0.5 * float(np.linalg.norm(b - a)),
    }


#: Parameters in which worlds may differ.
VARY = ["gravity", "friction", "density", "stretch", "shear", "bending"]
#: Into the floor and through the sheet, both grips closed for two tools.
PUSH = [0.0, 0.1, 0.02, 0.1, 0.2, 0.3, 0.0, 0.0, -0.12, 0.0, 0.0, 0.0, 1.0, 1.0]


def pushed(found: ClothSimulator) -> Tensor:
    return control(found, *PUSH[: found.control_size])
