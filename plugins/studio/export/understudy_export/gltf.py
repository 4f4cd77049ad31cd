"""Writes glTF 2.0: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html

The joints are nodes, and the surface is one skinned mesh whose vertices each follow one joint, so
that what reads it makes an armature. The last joints of limbs have a node more at their tips, so that
their bones end there. glTF is y up and faces z, and so are all joints: the armature stands upright
wherever it is read. The file stores float32.
"""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from understudy import __version__
from understudy.errors import FileError
from understudy_export.figure import Figure, figure, notice, origin, printable
from understudy_motion.clip import Clip, Skeleton
from understudy_motion.writing import ClipWriter, Shape, Shown

UP_Y_FACING_Z = [1, 2, 0]
"""(x, y, z) -> (y, z, x): of vectors, and of quaternions' vector parts."""
_SHORTEST = 0.01
"""m: a tip nearer to its joint shows no direction."""

_COMPONENT_TYPES = {"float32": 5126, "uint16": 5123, "uint32": 5125}
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
_GLB_VERSION = 2


def binary(document: dict[str, Any], buffer: bytes) -> bytes:
    """A single binary file."""
    text = json.dumps(document, separators=(",", ":")).encode()
    chunks = b"".join(
        struct.pack("<I4s", len(padded), kind) + padded
        for kind, padded in (
            (b"JSON", text + b" " * (-len(text) % 4)),
            (b"BIN\0", buffer + bytes(-len(buffer) % 4)),
        )
    )
    return struct.pack("<4sII", b"glTF", _GLB_VERSION, 12 + len(chunks)) + chunks


def embedded(document: dict[str, Any], buffer: bytes) -> bytes:
    """A JSON file that contains its buffer."""
    content = base64.b64encode(buffer).decode()
    document["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{content}"
    return (json.dumps(document, indent=1) + "\n").encode()


class GlbWriter(ClipWriter):
    """Writes a single binary file."""

    suffix = ".glb"

    def write(self, clip: Clip, path: Path, shapes: Sequence[Shape] = ()) -> None:
        self.write_all([Shown(clip, shapes)], path)

    def write_all(self, figures: Sequence[Shown], path: Path) -> None:
        path.write_bytes(binary(*_gltf(figures)))


class GltfWriter(ClipWriter):
    """Writes a JSON file that contains its buffer."""

    suffix = ".gltf"

    def write(self, clip: Clip, path: Path, shapes: Sequence[Shape] = ()) -> None:
        self.write_all([Shown(clip, shapes)], path)

    def write_all(self, figures: Sequence[Shown], path: Path) -> None:
        path.write_bytes(embedded(*_gltf(figures)))


class Buffer:
    """The file's one buffer, and the accessors of the arrays in it."""

    VERTICES, FACES = 34962, 34963  #: targets of views

    def __init__(self) -> None:
        self.content = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, array: np.ndarray, target: int | None = None) -> int:
        """The index of the accessor of `array`, (count,) or (count, width); with its bounds."""
        rows = np.ascontiguousarray(array).reshape(len(array), -1)
        self.accessors.append(
            {
                "bufferView": len(self.views),
                "componentType": _COMPONENT_TYPES[array.dtype.name],
                "count": len(rows),
                "type": _TYPES[rows.shape[1]],
                "min": rows.min(axis=0).tolist(),
                "max": rows.max(axis=0).tolist(),
            }
        )
        view = {"buffer": 0, "byteOffset": len(self.content), "byteLength": rows.nbytes}
        self.views.append(view if target is None else {**view, "target": target})
        self.content += rows.tobytes()
        self.content += bytes(-len(self.content) % 4)
        return len(self.accessors) - 1


def _gltf(figures: Sequence[Shown]) -> tuple[dict[str, Any], bytes]:
    """The document, which lacks only its buffer's place, and the buffer."""
    buffer, first = Buffer(), figures[0].clip
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": f"understudy {__version__}", **_copyright(first)},
        "scene": 0,
        "scenes": [{"nodes": []}],
        **{part: [] for part in ("nodes", "skins", "meshes", "materials")},
        "animations": [{"name": printable(first.name), "channels": [], "samplers": []}],
    }
    for shown in figures:
        _add(document, shown, buffer)
    return finished(document, buffer)


def finished(document: dict[str, Any], buffer: Buffer) -> tuple[dict[str, Any], bytes]:
    """The document with what it says of the buffer, and the buffer's bytes."""
    document |= {
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.content)}],
    }
    return document, bytes(buffer.content)


def _add(document: dict[str, Any], shown: Shown, buffer: Buffer) -> None:
    """One more figure: its joints and tips, the node above them, and the surface."""
    clip, body = shown.clip, figure(shown.clip, shown.shapes)
    base, number = len(document["nodes"]), len(document["skins"])
    joints, positions = _joint_nodes(body, shown.shapes, base)
    place = origin(clip) + np.array([0.0, shown.aside, 0.0])
    above = {
        "name": printable(clip.name),
        "children": [base],
        "translation": place[UP_Y_FACING_Z].tolist(),
        "extras": notice(clip),
    }
    surface = {"name": "surface" if number == 0 else f"surface {number + 1}"}
    document["scenes"][0]["nodes"] += [base + len(joints), base + len(joints) + 1]
    document["nodes"] += [*joints, above, {**surface, "mesh": number, "skin": number}]
    document["skins"].append(_skin(positions, base, buffer))
    primitives = _primitives(body, len(document["materials"]), buffer)
    document["meshes"].append({"primitives": primitives})
    document["materials"] += [material(surface.colour) for surface in body.surfaces]
    _animate(document["animations"][0], clip, base, buffer)


def material(colour: tuple[float, float, float, float]) -> dict[str, Any]:
    """A dull material of linear RGBA `colour`."""
    look = {"baseColorFactor": list(colour), "metallicFactor": 0.0, "roughnessFactor": 0.7}
    return {"pbrMetallicRoughness": look, **({"alphaMode": "BLEND"} if colour[3] < 1.0 else {})}


def _copyright(clip: Clip) -> dict[str, str]:
    words = [printable(text) for text in (clip.licence, clip.attribution) if text]
    return {"copyright": "; ".join(words)} if words else {}


def _joint_nodes(
    body: Figure, shapes: Sequence[Shape], base: int
) -> tuple[list[dict[str, Any]], np.ndarray]:
    """A node for each joint, then for each tip, in the rest pose, and where they are there, (N, 3)."""
    skeleton = body.skeleton
    tips = _tips(skeleton, shapes)
    places = [*body.rest_positions, *(body.rest_positions[j] + tip for j, tip in tips.items())]
    steps = [body.rest_positions[0], *skeleton.offsets[1:], *tips.values()]
    names = [*skeleton.joint_names]
    for joint in tips:
        name = f"{skeleton.joint_names[joint]}_tip"
        while name in names:
            name += "_"
        names.append(name)
    nodes: list[dict[str, Any]] = [
        {"name": name, "translation": step[UP_Y_FACING_Z].tolist()}
        for name, step in zip(names, steps, strict=True)
    ]
    for node, parent in enumerate([*skeleton.parents[1:], *tips], start=1):
        nodes[parent].setdefault("children", []).append(base + node)
    return nodes, np.array(places)


def _tips(skeleton: Skeleton, shapes: Sequence[Shape]) -> dict[int, np.ndarray]:
    """By joint on which none hangs: the end of what it carries (3,) m in its frame, as the skeleton says,
    else the farthest point of its shapes, else a little farther along its own bone."""
    tips = {}
    for joint, name in enumerate(skeleton.joint_names):
        if joint in skeleton.parents:
            continue
        own = [shape.vertices for shape in shapes if shape.joint == name]
        points = np.concatenate(own) if own else np.zeros((1, 3))
        choices = (
            skeleton.tips.get(name, np.zeros(3)),
            points[np.linalg.norm(points, axis=1).argmax()],
            0.5 * skeleton.offsets[joint],
        )
        long = (tip for tip in choices if np.linalg.norm(tip) > _SHORTEST)
        tips[joint] = np.asarray(next(long, np.array([0.0, 0.0, 10 * _SHORTEST])))
    return tips


def _skin(positions: np.ndarray, base: int, buffer: Buffer) -> dict[str, Any]:
    """The skin's inverse bind matrices, which are column-major, undo the rest positions (N, 3)."""
    inverse = np.tile(np.eye(4, dtype=np.float32), (len(positions), 1, 1))
    inverse[:, 3, :3] = -positions[:, UP_Y_FACING_Z]
    nodes = list(range(base, base + len(positions)))
    return {"joints": nodes, "inverseBindMatrices": buffer.add(inverse)}


def _primitives(body: Figure, material: int, buffer: Buffer) -> list[dict[str, Any]]:
    """The surfaces, whose materials are `material` and those after it."""
    found = []
    for number, surface in enumerate(body.surfaces, start=material):
        joints = np.zeros((len(surface.joints), 4), np.uint16)
        joints[:, 0] = surface.joints
        weights = np.zeros((len(surface.joints), 4), np.float32)
        weights[:, 0] = 1.0
        attributes = {
            "POSITION": surface.positions[:, UP_Y_FACING_Z].astype(np.float32),
            "NORMAL": surface.normals[:, UP_Y_FACING_Z].astype(np.float32),
            "JOINTS_0": joints,
            "WEIGHTS_0": weights,
        }
        found.append(
            {
                "attributes": {k: buffer.add(v, Buffer.VERTICES) for k, v in attributes.items()},
                "indices": buffer.add(surface.faces.astype(np.uint32).reshape(-1), Buffer.FACES),
                "material": number,
            }
        )
    return found


def _animate(animation: dict[str, Any], clip: Clip, base: int, buffer: Buffer) -> None:
    """Add the root's translation and every joint's rotation."""
    times = clip.times.numpy().astype(np.float32)
    if not (np.diff(times) > 0.0).all():
        raise FileError(
            f"Clip {clip.source}: its frames lie too close together for the length of the clip: glTF "
            "stores times as float32. Export fewer seconds (--seconds)."
        )
    path = clip.root_position.numpy() - origin(clip)
    quaternions = clip.rotations.numpy()[..., [2, 3, 1, 0]]  # wxyz as xyzw, turned as vectors are
    values = [("translation", 0, path[:, UP_Y_FACING_Z])]
    values += [("rotation", joint, quaternions[:, joint]) for joint in range(quaternions.shape[1])]
    at = buffer.add(times)
    for what, joint, value in values:
        sampler = {"input": at, "interpolation": "LINEAR"}
        target = {"node": base + joint, "path": what}
        animation["channels"].append({"sampler": len(animation["samplers"]), "target": target})
        animation["samplers"].append({**sampler, "output": buffer.add(value.astype(np.float32))})
