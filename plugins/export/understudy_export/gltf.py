"""Writes glTF 2.0: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html

The joints are nodes, and the surface is one skinned mesh whose vertices each follow one joint, so
that what reads it makes an armature. glTF is y up and faces z: the figure's node, above the root
joint, turns to that; everything below it stays z up and faces x. The file stores float32.
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
from understudy_motion.clip import Clip
from understudy_motion.writing import ClipWriter, Shape

_UP_Y_FACING_Z = [-0.5, -0.5, -0.5, 0.5]
"""(x, y, z) -> (y, z, x), as an xyzw quaternion."""

_COMPONENT_TYPES = {"float32": 5126, "uint16": 5123, "uint32": 5125}
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
_VERTICES, _FACES = 34962, 34963
_GLB_VERSION = 2


class GlbWriter(ClipWriter):
    """Writes a single binary file."""

    suffix = ".glb"

    def write(self, clip: Clip, path: Path, shapes: Sequence[Shape] = ()) -> None:
        document, buffer = _gltf(clip, shapes)
        text = json.dumps(document, separators=(",", ":")).encode()
        chunks = b"".join(
            struct.pack("<I4s", len(padded), kind) + padded
            for kind, padded in (
                (b"JSON", text + b" " * (-len(text) % 4)),
                (b"BIN\0", buffer + bytes(-len(buffer) % 4)),
            )
        )
        path.write_bytes(struct.pack("<4sII", b"glTF", _GLB_VERSION, 12 + len(chunks)) + chunks)


class GltfWriter(ClipWriter):
    """Writes a JSON file that contains its buffer."""

    suffix = ".gltf"

    def write(self, clip: Clip, path: Path, shapes: Sequence[Shape] = ()) -> None:
        document, buffer = _gltf(clip, shapes)
        content = base64.b64encode(buffer).decode()
        document["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{content}"
        path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


class _Buffer:
    """The file's one buffer, and the accessors of the arrays in it."""

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


def _gltf(clip: Clip, shapes: Sequence[Shape]) -> tuple[dict[str, Any], bytes]:
    """The document, which lacks only its buffer's place, and the buffer."""
    body, buffer = figure(clip, shapes), _Buffer()
    joints = len(clip.joint_names)
    document = {
        "asset": {"version": "2.0", "generator": f"understudy {__version__}", **_copyright(clip)},
        "scene": 0,
        "scenes": [{"nodes": [joints, joints + 1]}],
        "nodes": [
            *_joint_nodes(body),
            {
                "name": printable(clip.name),
                "children": [0],
                "rotation": _UP_Y_FACING_Z,
                "translation": origin(clip)[[1, 2, 0]].tolist(),
                "extras": notice(clip),
            },
            {"name": "surface", "mesh": 0, "skin": 0},
        ],
        "skins": [_skin(body, buffer)],
        "meshes": [{"primitives": _primitives(body, buffer)}],
        "materials": [
            {
                "pbrMetallicRoughness": {
                    "baseColorFactor": list(surface.colour),
                    "metallicFactor": 0.0,
                    "roughnessFactor": 0.7,
                },
                **({"alphaMode": "BLEND"} if surface.colour[3] < 1.0 else {}),
            }
            for surface in body.surfaces
        ],
        "animations": [_animation(clip, buffer)],
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.content)}],
    }
    return document, bytes(buffer.content)


def _copyright(clip: Clip) -> dict[str, str]:
    words = [printable(text) for text in (clip.licence, clip.attribution) if text]
    return {"copyright": "; ".join(words)} if words else {}


def _joint_nodes(body: Figure) -> list[dict[str, Any]]:
    """A node for each joint, in the rest pose."""
    skeleton = body.skeleton
    nodes: list[dict[str, Any]] = [
        {"name": name, "translation": offset.tolist()}
        for name, offset in zip(skeleton.joint_names, skeleton.offsets, strict=True)
    ]
    nodes[0]["translation"] = body.rest_positions[0].tolist()
    for joint, parent in enumerate(skeleton.parents[1:], start=1):
        nodes[parent].setdefault("children", []).append(joint)
    return nodes


def _skin(body: Figure, buffer: _Buffer) -> dict[str, Any]:
    """The skin's inverse bind matrices, which are column-major, undo the rest positions."""
    inverse = np.tile(np.eye(4, dtype=np.float32), (len(body.rest_positions), 1, 1))
    inverse[:, 3, :3] = -body.rest_positions
    return {"joints": list(range(len(inverse))), "inverseBindMatrices": buffer.add(inverse)}


def _primitives(body: Figure, buffer: _Buffer) -> list[dict[str, Any]]:
    found = []
    for material, surface in enumerate(body.surfaces):
        joints = np.zeros((len(surface.joints), 4), np.uint16)
        joints[:, 0] = surface.joints
        weights = np.zeros((len(surface.joints), 4), np.float32)
        weights[:, 0] = 1.0
        attributes = {
            "POSITION": surface.positions.astype(np.float32),
            "NORMAL": surface.normals.astype(np.float32),
            "JOINTS_0": joints,
            "WEIGHTS_0": weights,
        }
        found.append(
            {
                "attributes": {k: buffer.add(v, _VERTICES) for k, v in attributes.items()},
                "indices": buffer.add(surface.faces.astype(np.uint32).reshape(-1), _FACES),
                "material": material,
            }
        )
    return found


def _animation(clip: Clip, buffer: _Buffer) -> dict[str, Any]:
    """The root's translation and every joint's rotation."""
    times = clip.times.numpy().astype(np.float32)
    if not (np.diff(times) > 0.0).all():
        raise FileError(
            f"Clip {clip.source}: its frames lie too close together for the length of the clip: glTF "
            "stores times as float32. Export fewer seconds (--seconds)."
        )
    values = [("translation", 0, clip.root_position.numpy() - origin(clip))]
    quaternions = clip.rotations.numpy()[..., [1, 2, 3, 0]]
    values += [("rotation", joint, quaternions[:, joint]) for joint in range(quaternions.shape[1])]
    at = buffer.add(times)
    return {
        "name": printable(clip.name),
        "channels": [
            {"sampler": sampler, "target": {"node": joint, "path": path}}
            for sampler, (path, joint, _) in enumerate(values)
        ],
        "samplers": [
            {"input": at, "interpolation": "LINEAR", "output": buffer.add(v.astype(np.float32))}
            for _, _, v in values
        ],
    }
