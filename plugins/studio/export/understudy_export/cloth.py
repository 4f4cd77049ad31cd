"""A recorded garment, and the bodies that it meets, as glTF 2.0: the garment is a mesh with a morph target for each
frame after the first, each body a mesh on a node that moves. Metres, y up, facing z, float32. Or as USD: a mesh whose
points are given at each frame, and meshes on transforms; metres, z up, facing x."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from understudy import __version__
from understudy.errors import FileError
from understudy.folders import write_atomically
from understudy.records import runs
from understudy_characters.recording import recorded_scene
from understudy_cloth.scene import Box, Capsule, ClothScene, Grid, Shape, Tool
from understudy_export.figure import printable
from understudy_export.gltf import UP_Y_FACING_Z, Buffer, binary, embedded, finished, material
from understudy_motion.readers.npz import Archive

#: Frames a second, where none are asked for, and most that a file has: each is a mesh of its own.
RATE, MOST = 25.0, 1000
#: Linear RGB of what is drawn likewise (:mod:`understudy_cloth.drawing`).
_CLOTH, _BODY = (0.10, 0.26, 0.57, 1.0), (0.69, 0.34, 0.17, 1.0)
#: By ending: how a document and its buffer become a file.
_ENDINGS = {".glb": binary, ".gltf": embedded}
_STAGES = (".usd", ".usda", ".usdc")


def garment_of(source: str) -> ClothScene | None:
    """Of the run folder `source`, if a garment was recorded: its scene, or the composite's member that is one."""
    file = Path(source) / "recording.npz"
    if not file.is_file() or "cloth_position" not in Archive(file).names:
        return None
    scene = recorded_scene(runs.open_run(source))
    among = (scene, *scene.members.values())
    return next((one for one in among if isinstance(one, ClothScene)), None)


def write_cloth(
    source: str,
    scene: ClothScene,
    path: Path,
    rate: float | None = None,
    seconds: float | None = None,
    licence: str | None = None,
) -> str:
    """Write the recording of the run folder `source` to `path` (.glb, .gltf, .usd, .usda, .usdc), `rate` frames a second; returns a
    line on it.

    Raises
    ------
    FileError
        the recording is damaged, or has too many frames or less than two.
    """
    ending = path.suffix.lower()
    if ending not in (*_ENDINGS, *_STAGES):
        raise FileError(
            f"{path}: a garment is written to {', '.join((*_ENDINGS, *_STAGES[:-1]))} and {_STAGES[-1]} files, which have "
            "meshes that change shape."
        )
    file = Path(source) / "recording.npz"
    model, archive = scene.model(), Archive(file)
    dt, count = archive.number("control_dt"), int(archive.number("first_episode"))
    cloth = archive.floats("cloth_position", None, len(model.positions), 3)[: max(0, count)]
    if seconds is not None:
        cloth = cloth[: 1 + int(seconds / dt + 1e-6)]
    step = max(1, round(1.0 / (dt * (rate or RATE))))
    shown = slice(0, len(cloth), step)
    frames = len(cloth[shown])
    if not 2 <= frames <= MOST:
        raise FileError(
            f"{file}: {frames} frames at {1 / (dt * step):g} Hz cannot be written, only 2 to {MOST} frames: change --rate or "
            "--seconds."
        )
    tools: list[tuple[Tool, np.ndarray, np.ndarray]] = []
    if {"tool_position", "tool_orientation"} <= archive.names:
        many = len(model.tools)
        lead = (many,) if many > 1 else ()
        at = archive.floats("tool_position", None, *lead, 3)[: len(cloth)][shown]
        turn = archive.floats("tool_orientation", None, *lead, 4)[: len(cloth)][shown]
        at, turn = at.reshape(frames, -1, 3), turn.reshape(frames, -1, 4)
        tools = [(tool, at[:, i], turn[:, i]) for i, tool in enumerate(model.tools)]
    times = dt * step * np.arange(frames)
    if ending in _STAGES:
        _write_stage(path, cloth[shown], np.asarray(model.faces), tools, 1.0 / (dt * step), licence)
    else:
        document, buffer = _document(cloth[shown], np.asarray(model.faces), tools, times)
        if licence:
            document["asset"]["copyright"] = printable(licence)
        write_atomically(path, _ENDINGS[ending](document, buffer))
    return (
        f"{path}: {frames} frames at {1 / (dt * step):g} Hz · {times[-1]:.2f} s · a garment of {cloth.shape[1]} vertices "
        f"and {len(tools)} bodies"
    )


def _document(
    cloth: np.ndarray,
    faces: np.ndarray,
    tools: Sequence[tuple[Tool, np.ndarray, np.ndarray]],
    times: np.ndarray,
) -> tuple[dict[str, Any], bytes]:
    """`cloth` (T, V, 3) m, of each tool where it is (T, 3) and how it is turned (T, 4) wxyz, at `times` (T,) s."""
    buffer = Buffer()
    at = buffer.add(times.astype(np.float32))
    places = cloth[..., UP_Y_FACING_Z].astype(np.float32)
    garment = {
        **_primitive(places[0], faces, 0, buffer),
        "targets": [{"POSITION": buffer.add(place - places[0])} for place in places[1:]],
    }
    first = np.zeros(len(places) - 1)
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": f"understudy {__version__}"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "garment", "mesh": 0}],
        "meshes": [{"primitives": [garment], "weights": first.tolist()}],
        "materials": [{**material(_CLOTH), "doubleSided": True}, material(_BODY)],
        "animations": [{"name": "recording", "channels": [], "samplers": []}],
    }
    shares = np.eye(len(places), dtype=np.float32)[:, 1:].reshape(-1)  # one target a frame
    _animate(document, at, 0, "weights", buffer.add(shares))
    for number, (tool, place, turn) in enumerate(tools):
        surface = _surface(tool)
        if surface is None:
            continue
        node = len(document["nodes"])
        vertices, faces = surface
        vertices = vertices[:, UP_Y_FACING_Z].astype(np.float32)
        document["scenes"][0]["nodes"].append(node)
        document["nodes"].append({"name": f"body {number}", "mesh": len(document["meshes"])})
        primitive = _primitive(vertices, faces, 1, buffer)
        document["meshes"].append({"primitives": [primitive]})
        moved = place[:, UP_Y_FACING_Z].astype(np.float32)
        turned = turn[:, [2, 3, 1, 0]].astype(np.float32)  # wxyz as xyzw, turned as vectors are
        _animate(document, at, node, "translation", buffer.add(moved))
        _animate(document, at, node, "rotation", buffer.add(turned))
    return finished(document, buffer)


def _write_stage(
    path: Path,
    cloth: np.ndarray,
    faces: np.ndarray,
    tools: Sequence[tuple[Tool, np.ndarray, np.ndarray]],
    rate: float,
    licence: str | None,
) -> None:
    """The same as USD, of which a time code is a frame."""
    from understudy_export.usd import add_mesh, new_stage, save

    codes = np.arange(len(cloth), dtype=float)
    about = {"copyright": printable(licence)} if licence else {}
    stage = new_stage(str(path), codes, round(rate, 9), about)
    from pxr import Gf, UsdGeom, Vt

    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Recording").GetPrim())
    garment = add_mesh(stage, "/Recording/Garment", cloth[0], faces, _CLOTH)
    garment.CreateDoubleSidedAttr(True)
    for code, points in zip(codes.tolist(), cloth.astype(np.float32), strict=True):
        ends = np.stack((points.min(0), points.max(0)))
        garment.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(points), code)
        garment.GetExtentAttr().Set(Vt.Vec3fArray.FromNumpy(ends), code)
    for number, (tool, place, turn) in enumerate(tools):
        surface = _surface(tool)
        if surface is None:
            continue
        body = UsdGeom.Xform.Define(stage, f"/Recording/Body{number}")
        moved, turned = body.AddTranslateOp(), body.AddOrientOp()
        for code, p, q in zip(codes.tolist(), place.tolist(), turn.tolist(), strict=True):
            moved.Set(Gf.Vec3d(*p), code)
            turned.Set(Gf.Quatf(*q), code)
        add_mesh(stage, f"/Recording/Body{number}/Shape", *surface, _BODY)
    with tempfile.TemporaryDirectory() as folder:  # all or nothing
        whole = Path(folder) / path.name
        save(stage, str(path), whole)
        write_atomically(path, whole.read_bytes())


def _surface(tool: Tool) -> tuple[np.ndarray, np.ndarray] | None:
    """Vertices (V, 3) m in the tool's frame and triangles (F, 3); none where nothing is to be seen."""
    meshes = [_mesh(shape) for shape in tool.shapes if not isinstance(shape, Grid)]
    if not meshes:
        return None
    return trimesh.util.append_faces(
        [np.asarray(mesh.vertices) for mesh in meshes],
        [np.asarray(mesh.faces) for mesh in meshes],
    )


def _primitive(vertices: np.ndarray, faces: np.ndarray, of: int, buffer: Buffer) -> dict[str, Any]:
    """Triangles without normals, which readers then compute anew in every frame."""
    return {
        "attributes": {"POSITION": buffer.add(vertices, Buffer.VERTICES)},
        "indices": buffer.add(faces.astype(np.uint32).reshape(-1), Buffer.FACES),
        "material": of,
    }


def _animate(document: dict[str, Any], times: int, node: int, what: str, values: int) -> None:
    animation = document["animations"][0]
    target = {"node": node, "path": what}
    animation["channels"].append({"sampler": len(animation["samplers"]), "target": target})
    animation["samplers"].append({"input": times, "interpolation": "LINEAR", "output": values})


def _mesh(shape: Shape) -> trimesh.Trimesh:
    """A box, or the hull of the spheres at a capsule's ends, in its tool's frame."""
    if isinstance(shape, Box):
        mesh = trimesh.creation.box(extents=2 * np.asarray(shape.half_extents))
    else:
        assert not isinstance(shape, Grid)
        radii = (shape.radius,) * 2 if isinstance(shape, Capsule) else shape.radii
        ends = zip(radii, (-shape.half_length, shape.half_length), strict=True)
        balls = [
            np.add(
                trimesh.creation.icosphere(subdivisions=2, radius=radius).vertices,
                (0.0, 0.0, height),
            )
            for radius, height in ends
        ]
        mesh = trimesh.convex.convex_hull(np.concatenate(balls))
    place = trimesh.transformations.quaternion_matrix(shape.orientation)
    place[:3, 3] = shape.position
    return mesh.apply_transform(place)
