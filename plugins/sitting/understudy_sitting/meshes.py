"""Meshes of furniture as convex parts, which is what a physics engine collides."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import trimesh

from understudy.errors import FileError

#: Parts, and vertices of one of them, that a simulation on a GPU still carries easily.
MOST_PARTS, MOST_VERTICES = 16, 64


def convex_parts(path: Path, scale: float = 1.0) -> list[np.ndarray]:
    """The convex hulls, (V, 3) m each, of the connected parts of a mesh file (OBJ, STL, PLY, glTF).

    A chair whose seat, back and legs are parts of their own is as it looks; parts that are not convex
    become their hulls.

    Raises
    ------
    FileError
        if it is missing, no mesh, empty, or has more than ``MOST_PARTS`` parts.
    """
    if not path.is_file():
        raise FileError(f"There is no mesh {path}.")
    try:
        # From memory, so that what the file refers to is not followed.
        kind = path.suffix.removeprefix(".")
        scene = trimesh.load(io.BytesIO(path.read_bytes()), file_type=kind, skip_materials=True)
        mesh = scene.to_mesh() if isinstance(scene, trimesh.Scene) else scene
        assert isinstance(mesh, trimesh.Trimesh)
        mesh.merge_vertices()
        parts = mesh.split(only_watertight=False)
        hulls = [_coarse(part.convex_hull) for part in parts if len(part.vertices) >= 4]
    except Exception as error:  # whatever the reader of that format raises
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise FileError(f"The mesh {path} cannot be used: {reason}") from error
    if not hulls:
        raise FileError(f"The mesh {path} has no part with a volume.")
    if len(hulls) > MOST_PARTS:
        raise FileError(
            f"The mesh {path} has {len(hulls)} parts; {MOST_PARTS} is the most. Join some of them."
        )
    return [np.asarray(hull.vertices, dtype=np.float64) * scale for hull in hulls]


def _coarse(hull: trimesh.Trimesh) -> trimesh.Trimesh:
    """The hull of at most so many of its vertices, those farthest out in evenly spread directions."""
    if len(hull.vertices) <= MOST_VERTICES:
        return hull
    index = np.arange(MOST_VERTICES) + 0.5
    polar, turn = np.arccos(1 - 2 * index / MOST_VERTICES), np.pi * (1 + 5**0.5) * index
    out = np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)])
    chosen = np.unique((hull.vertices @ out).argmax(axis=0))
    return trimesh.convex.convex_hull(hull.vertices[chosen])
