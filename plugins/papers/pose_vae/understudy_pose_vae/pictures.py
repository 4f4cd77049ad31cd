"""Poses as pictures: what a run keeps of them, and drawings of it that need nothing but SVG."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from understudy.folders import write_atomically
from understudy_pose_vae.features import PoseFeatures

#: In the run folder: where joints and tips are of the poses shown, and what is said of them.
FILE = "pose_pictures.npz"
#: How many poses are drawn from the codes' distribution, rebuilt, and shown along each code.
SAMPLES, PAIRS, STEPS = 40, 10, 5

#: From the right front and a little above: pictures' axes right, up and towards whoever looks.
_TURN, _TILT = np.deg2rad(-55.0), np.deg2rad(12.0)
_PIXELS = 84.0  #: for a metre


def save(
    path: Path,
    features: PoseFeatures,
    poses: Mapping[str, Tensor],
    about: Mapping[str, np.ndarray],
) -> None:
    """Write the places of the `poses`, each (F, J, 4), the figure's bones and `about` as plain arrays."""
    arrays: dict[str, Any] = {
        f"places/{name}": features.places(pose).numpy() for name, pose in poses.items()
    }
    file = io.BytesIO()
    arrays |= {"bones": np.array(_bones(features)), **about}
    np.savez(file, **arrays)
    write_atomically(path, file.getvalue())


def _bones(features: PoseFeatures) -> list[tuple[int, int]]:
    """Rows of the places of :meth:`PoseFeatures.places` that bones connect; -1 is the root."""
    skeleton = features.character.skeleton
    joints = [(parent - 1, row) for row, parent in enumerate(skeleton.parents[1:])]
    count = len(skeleton.joint_names) - 1
    tips = enumerate(skeleton.joint_names.index(name) - 1 for name in skeleton.tips)
    return [*joints, *((joint, count + tip) for tip, joint in tips)]


def figure(
    places: np.ndarray, bones: Sequence[tuple[int, int]], colour: str = "var(--learned)"
) -> str:
    """The paths of one figure, `places` (P, 3) m about its root, about the origin of the picture.

    What is farther away is fainter and drawn first, so that limbs in front cover it.
    """
    points = np.vstack([places, np.zeros(3)])  # the root's row is -1
    seen = points @ _view().T
    segments = np.array([[seen[a], seen[b]] for a, b in bones])
    depth = segments[..., 2].mean(1)
    reach = max(0.3, float(np.abs(seen[:, 2]).max()))
    parts = []
    for row in np.argsort(depth):
        (x, y, _), (u, v, _) = _PIXELS * segments[row]
        shade = 0.68 + 0.32 * float(np.clip(depth[row] / reach, -1, 1))
        line = f"M{x:.1f} {-y:.1f}L{u:.1f} {-v:.1f}"
        parts.append(
            f'<path d="{line}" stroke="var(--card)" stroke-width="11"/>'
            f'<path d="{line}" stroke="{colour}" stroke-width="7.5" opacity="{shade:.2f}"/>'
        )
    return f'<g fill="none" stroke-linecap="round">{"".join(parts)}</g>'


def _view() -> np.ndarray:
    """(3, 3): rows are right, up, and towards the viewer, in the root's frame (x forward, z up)."""
    to = np.array([np.cos(_TILT) * np.cos(_TURN), np.cos(_TILT) * np.sin(_TURN), np.sin(_TILT)])
    right = np.cross([0.0, 0.0, 1.0], to)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(to, right), to])


def sheet(figures: Sequence[str], columns: int, label: str, cell: tuple[int, int]) -> str:
    """An ``<svg>`` of `figures`, each in a cell of (width, height) pixels, row by row."""
    width, height = cell
    rows = -(-len(figures) // columns)
    placed = "".join(
        f'<g transform="translate({(i % columns + 0.5) * width:g} {(i // columns + 0.52) * height:g})">'
        f"{one}</g>"
        for i, one in enumerate(figures)
    )
    return (
        f'<svg viewBox="0 0 {columns * width} {rows * height}" role="img" aria-label="{label}" '
        f'xmlns="http://www.w3.org/2000/svg">{placed}</svg>'
    )
