"""Meshes of furniture as convex parts, which physics engines can collide.

A mesh may be a stranger's, and a few bytes of glTF can make its reader compute for minutes or allocate without
end. So it is read in a process of its own, within limits.
"""

from __future__ import annotations

import hashlib
import io
import json
import sys
from pathlib import Path

import numpy as np
import trimesh

from understudy.errors import FileError
from understudy_mujoco.apart import Limits, read_apart, serve

__all__ = ["convex_parts"]

#: Formats that are read: no archives, which unpack to any size.
FORMATS = (".obj", ".stl", ".ply", ".gltf", ".glb")
#: Parts, and vertices of one of them, that a simulation on a GPU still carries easily.
MOST_PARTS, MOST_VERTICES = 16, 64
#: Bytes of a file, and faces (and vertices) in it: more than any chair needs.
MOST_BYTES, MOST_FACES = 128 * 2**20, 300_000
#: For reading it.
LIMITS = Limits(cpu=30, wall=300)

#: By the digest of format and content: the hulls, which are asked for at each building of the scene.
_known: dict[bytes, list[np.ndarray]] = {}


def convex_parts(path: Path, scale: float = 1.0) -> list[np.ndarray]:
    """The convex hulls, (V, 3) m each, of the connected parts of a mesh file (OBJ, STL, PLY, glTF).

    A chair whose seat, back and legs are separate parts keeps its shape; parts that are not convex become their
    hulls.

    Raises
    ------
    FileError
        if it is missing, of another format, no mesh, empty, not read within the limits, or has more
        than ``MOST_PARTS`` parts.
    """
    if not path.is_file():
        raise FileError(f"There is no mesh {path}.")
    kind = path.suffix.lower()
    if kind not in FORMATS:
        raise FileError(
            f"The mesh {path} is of no format that is read; export it as {', '.join(FORMATS)}."
        )
    try:
        too_large = path.stat().st_size > MOST_BYTES
        content = b"" if too_large else path.read_bytes()
    except OSError as error:
        raise FileError(f"The mesh {path} cannot be read: {error.strerror}.") from error
    if too_large:
        raise FileError(f"The mesh {path} has more than {MOST_BYTES >> 20} MiB; make it smaller.")
    digest = hashlib.sha256(kind.encode() + b"\0" + content).digest()
    if digest not in _known:
        _known[digest] = _read_apart(path, content)
    return [hull * scale for hull in _known[digest]]


def _read_apart(path: Path, content: bytes) -> list[np.ndarray]:
    """:func:`_hulls`, in a process of its own."""
    found = read_apart(__name__, path, f"The mesh {path} cannot be read", LIMITS, content)
    return [np.array(hull, dtype=np.float64) for hull in json.loads(found)]


def _hulls(path: Path, content: bytes) -> list[np.ndarray]:
    """The hulls of the parts of the mesh `content`, whose name is `path`."""
    try:
        if elsewhere := _elsewhere(path, content):
            raise FileError(
                f"The mesh {path} has its numbers in another file, {elsewhere}, which is not read; export it as one, .glb."
            )
        # From memory, so that what the file refers to is not followed.
        kind = path.suffix.lower().removeprefix(".")
        scene = trimesh.load(io.BytesIO(content), file_type=kind, skip_materials=True)
        mesh = scene.to_mesh() if isinstance(scene, trimesh.Scene) else scene
        if not isinstance(mesh, trimesh.Trimesh):
            raise FileError(f"The mesh {path} has no faces.")
        if max(len(mesh.faces), len(mesh.vertices)) > MOST_FACES:
            raise FileError(
                f"The mesh {path} has more than {MOST_FACES} faces or vertices; make it coarser."
            )
        mesh.merge_vertices()
        parts = [p for p in mesh.split(only_watertight=False) if len(p.vertices) >= 4]
        if not parts:
            raise FileError(f"The mesh {path} has no part with a volume.")
        if len(parts) > MOST_PARTS:
            raise FileError(
                f"The mesh {path} has {len(parts)} parts; {MOST_PARTS} is the most. Join some of them."
            )
        return [np.asarray(_coarse(part.convex_hull).vertices) for part in parts]
    except FileError:
        raise
    except MemoryError as error:
        raise FileError(
            f"The mesh {path} cannot be read within {LIMITS.memory >> 30} GiB; make it smaller."
        ) from error
    except Exception as error:  # whatever the reader of that format raises
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise FileError(f"The mesh {path} cannot be used: {reason}") from error


def _elsewhere(path: Path, content: bytes) -> str:
    """The file in which the glTF `content` has its numbers, nothing if they are in it."""
    if path.suffix.lower() != ".gltf":
        return ""
    told = json.loads(content)
    buffers = told.get("buffers", []) if isinstance(told, dict) else []
    named = [str(b.get("uri", "")) for b in buffers if isinstance(b, dict)]
    return next((repr(n[:80]) for n in named if n and not n.startswith("data:")), "")


def _coarse(hull: trimesh.Trimesh) -> trimesh.Trimesh:
    """The hull of at most so many of its vertices, those farthest out in evenly spread directions."""
    if len(hull.vertices) <= MOST_VERTICES:
        return hull
    index = np.arange(MOST_VERTICES) + 0.5
    polar, turn = np.arccos(1 - 2 * index / MOST_VERTICES), np.pi * (1 + 5**0.5) * index
    out = np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)])
    chosen = np.unique((hull.vertices @ out).argmax(axis=0))
    return trimesh.convex.convex_hull(hull.vertices[chosen])


def _told(path: Path) -> str:
    return json.dumps([hull.tolist() for hull in _hulls(path, sys.stdin.buffer.read())])


if __name__ == "__main__":
    serve(_told)
