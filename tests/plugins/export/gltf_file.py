"""Reads glTF 2.0 for tests, by the specification alone, and holds files to its rules."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

_DTYPES = {5123: np.dtype("<u2"), 5125: np.dtype("<u4"), 5126: np.dtype("<f4")}
_WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class GltfFile:
    """The document and the arrays of its accessors, each (count, width)."""

    def __init__(self, path: Path) -> None:
        content = path.read_bytes()
        if path.suffix == ".glb":
            self.document, self.buffer = _chunks(content)
        else:
            self.document = json.loads(content)
            kind, encoded = self.document["buffers"][0]["uri"].split(",")
            assert kind == "data:application/octet-stream;base64"
            self.buffer = base64.b64decode(encoded, validate=True)
        length = self.document["buffers"][0]["byteLength"]
        assert 0 <= len(self.buffer) - length <= 3
        self.arrays = [self._array(accessor) for accessor in self.document["accessors"]]

    def _array(self, accessor: dict[str, Any]) -> np.ndarray:
        view = self.document["bufferViews"][accessor["bufferView"]]
        dtype, width = _DTYPES[accessor["componentType"]], _WIDTHS[accessor["type"]]
        offset = view["byteOffset"] + accessor.get("byteOffset", 0)
        size = accessor["count"] * width * dtype.itemsize
        assert offset % dtype.itemsize == 0
        assert accessor.get("byteOffset", 0) + size <= view["byteLength"]
        assert view["byteOffset"] + view["byteLength"] <= len(self.buffer)
        return np.frombuffer(self.buffer[offset : offset + size], dtype).reshape(-1, width)

    # ------------------------------------------------------------------ the motion

    def world(self, node: int, frame: int | None = None) -> np.ndarray:
        """(4, 4): from the frame of `node` to the world, in the rest pose or a frame of animation."""
        item = dict(self.document["nodes"][node])
        if frame is not None:
            item |= {
                channel["target"]["path"]: self._output(channel)[frame].astype(float)
                for channel in self.document["animations"][0]["channels"]
                if channel["target"]["node"] == node
            }
        local = np.eye(4)
        local[:3, :3] = Rotation.from_quat(item.get("rotation", [0, 0, 0, 1])).as_matrix()
        local[:3, 3] = item.get("translation", [0, 0, 0])
        above = [
            parent
            for parent, other in enumerate(self.document["nodes"])
            if node in other.get("children", ())
        ]
        return self.world(above[0], frame) @ local if above else local

    def _output(self, channel: dict[str, Any]) -> np.ndarray:
        sampler = self.document["animations"][0]["samplers"][channel["sampler"]]
        return self.arrays[sampler["output"]]

    @property
    def times(self) -> np.ndarray:
        """(F,) s."""
        return self.arrays[self.document["animations"][0]["samplers"][0]["input"]][:, 0]

    def root_positions(self) -> np.ndarray:
        """(F, 3) m, z up."""
        path = [self.world(0, frame)[:3, 3] for frame in range(len(self.times))]
        return np.array(path)[:, [2, 0, 1]]

    def joint_rotations(self) -> np.ndarray:
        """(F, J, 4) wxyz of the joints' nodes, which come first; the root's in a world with z up."""
        channels = self.document["animations"][0]["channels"]
        turns = {
            c["target"]["node"]: self._output(c).astype(float)
            for c in channels
            if c["target"]["path"] == "rotation"
        }
        return np.stack([turns[node] for node in range(len(turns))], axis=1)[..., [3, 2, 0, 1]]

    def skinned(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """World positions (V, 3), y up, and joint (V,) of all vertices in `frame`."""
        skin = self.document["skins"][0]
        inverse = self.arrays[skin["inverseBindMatrices"]].reshape(-1, 4, 4).transpose(0, 2, 1)
        matrices = np.array([self.world(j, frame) for j in skin["joints"]]) @ inverse
        positions, joints = [], []
        for primitive in self.document["meshes"][0]["primitives"]:
            attributes = {k: self.arrays[v] for k, v in primitive["attributes"].items()}
            of, weights = attributes["JOINTS_0"], attributes["WEIGHTS_0"]
            blended = np.einsum("vk,vkab->vab", weights, matrices[of])
            vertices = np.pad(attributes["POSITION"], ((0, 0), (0, 1)), constant_values=1.0)
            positions.append(np.einsum("vab,vb->va", blended, vertices)[:, :3])
            joints.append(of[np.arange(len(of)), weights.argmax(axis=1)])
        return np.concatenate(positions), np.concatenate(joints)

    # ------------------------------------------------------------------ the rules

    def check(self) -> None:
        """What the specification demands of the parts that are used here."""
        document = self.document
        assert document["asset"]["version"] == "2.0"
        for accessor, array in zip(document["accessors"], self.arrays, strict=True):
            assert accessor["min"] == array.min(axis=0).tolist()
            assert accessor["max"] == array.max(axis=0).tolist()
            assert np.isfinite(array).all()
        self._check_tree()
        self._check_meshes()
        self._check_animation()

    def _check_tree(self) -> None:
        children = [c for n in self.document["nodes"] for c in n.get("children", ())]
        assert len(set(children)) == len(children)
        roots = self.document["scenes"][self.document["scene"]]["nodes"]
        assert sorted(roots + children) == list(range(len(self.document["nodes"])))
        for node in self.document["nodes"]:
            assert np.linalg.norm(node.get("rotation", [1.0])) == 1.0

    def _check_meshes(self) -> None:
        document = self.document
        targets: dict[int, int] = {}
        skin = document["skins"][0]
        assert len(self.arrays[skin["inverseBindMatrices"]]) == len(skin["joints"])
        for primitive in document["meshes"][0]["primitives"]:
            attributes = primitive["attributes"]
            assert len({len(self.arrays[a]) for a in attributes.values()}) == 1
            targets |= dict.fromkeys(attributes.values(), 34962) | {primitive["indices"]: 34963}
            indices = self.arrays[primitive["indices"]]
            assert indices.size % 3 == 0
            assert indices.max() < len(self.arrays[attributes["POSITION"]])
            assert document["accessors"][attributes["JOINTS_0"]]["componentType"] == 5123
            assert self.arrays[attributes["JOINTS_0"]].max() < len(skin["joints"])
            assert (self.arrays[attributes["WEIGHTS_0"]].sum(axis=1) == 1.0).all()
            lengths = np.linalg.norm(self.arrays[attributes["NORMAL"]], axis=1)
            assert np.allclose(lengths, 1.0, atol=1e-5)
            assert primitive["material"] < len(document["materials"])
        for number, accessor in enumerate(document["accessors"]):
            view = document["bufferViews"][accessor["bufferView"]]
            assert view.get("target") == targets.get(number)
            assert view["byteOffset"] % 4 == 0

    def _check_animation(self) -> None:
        animation = self.document["animations"][0]
        ends = [(c["target"]["node"], c["target"]["path"]) for c in animation["channels"]]
        assert len(set(ends)) == len(ends)
        assert (np.diff(self.times) > 0).all()
        assert self.times[0] >= 0
        for channel in animation["channels"]:
            sampler = animation["samplers"][channel["sampler"]]
            assert sampler["interpolation"] == "LINEAR"
            values = self._output(channel)
            assert len(values) == len(self.arrays[sampler["input"]])
            if channel["target"]["path"] == "rotation":
                assert np.allclose(np.linalg.norm(values, axis=1), 1.0, atol=1e-6)


def _chunks(content: bytes) -> tuple[dict[str, Any], bytes]:
    magic, version, length = struct.unpack_from("<4sII", content)
    assert (magic, version, length) == (b"glTF", 2, len(content))
    found, at = {}, 12
    while at < len(content):
        size, kind = struct.unpack_from("<I4s", content, at)
        assert size % 4 == 0
        found[kind] = content[at + 8 : at + 8 + size]
        at += 8 + size
    assert list(found) == [b"JSON", b"BIN\0"]
    return json.loads(found[b"JSON"]), found[b"BIN\0"]
