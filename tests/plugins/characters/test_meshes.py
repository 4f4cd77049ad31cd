"""Meshes of furniture as convex parts; a stranger's file costs no more than its reader."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh

from understudy.errors import FileError
from understudy_characters import meshes
from understudy_characters.meshes import convex_parts
from understudy_mujoco.apart import Limits


@pytest.mark.parametrize("suffix", ["obj", "STL", "ply", "glb"])
def test_a_mesh_becomes_the_hulls_of_its_parts(tmp_path: Path, suffix: str) -> None:
    seat = trimesh.creation.box((40, 40, 5))
    back = trimesh.creation.box((5, 40, 50))
    back.apply_translation((-40.0, 0, 30))
    path = tmp_path / f"chair.{suffix}"
    trimesh.util.concatenate([seat, back]).export(path, file_type=suffix.lower())
    parts = convex_parts(path, scale=0.01)
    assert len(parts) == 2
    sizes = sorted(tuple(np.ptp(part, axis=0).round(4)) for part in parts)
    assert sizes == [(0.05, 0.4, 0.5), (0.4, 0.4, 0.05)]


def test_a_node_that_is_scaled_scales_its_mesh(tmp_path: Path) -> None:
    """As programs export that work in centimetres: small numbers below a node of scale 100."""
    seat = trimesh.creation.box((0.004, 0.004, 0.0005))
    scene = trimesh.Scene()
    scene.add_geometry(seat, transform=np.diag([100.0, 100.0, 100.0, 1.0]))
    scene.export(tmp_path / "chair.glb")
    (part,) = convex_parts(tmp_path / "chair.glb")
    np.testing.assert_allclose(np.ptp(part, axis=0), [0.4, 0.4, 0.05], atol=1e-6)


def test_numbers_of_a_gltf_in_another_file_are_not_read(tmp_path: Path) -> None:
    scene = trimesh.Scene(trimesh.creation.box((0.4, 0.4, 0.05)))
    scene.export(tmp_path / "chair.gltf")
    with pytest.raises(
        FileError, match=r"another file, '.*\.bin', which is not read; export it as one, \.glb"
    ):
        convex_parts(tmp_path / "chair.gltf")


def test_what_is_no_mesh_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="There is no mesh"):
        convex_parts(tmp_path / "nothing.obj")
    broken = tmp_path / "broken.obj"
    broken.write_text("v 1 2\nf 1 2 99\n")
    with pytest.raises(FileError, match=r"broken\.obj"):
        convex_parts(broken)


def endless(folder: Path, count: int) -> Path:
    """A glTF of some hundred bytes, whose accessors without data stand for `count` zeros."""
    zeros = {"componentType": 5126, "count": count, "type": "VEC3"}
    content = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}], "accessors": [zeros], "bufferViews": [],
    }  # fmt: skip
    path = folder / "chair.gltf"
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize(
    ("count", "cpu", "why"),
    [
        (300_000, 1, "cannot be read within 1 s of processor time; make it smaller"),
        (3_000_000, 60, "has more than 300000 faces or vertices; make it coarser"),
        (2_000_000_000, 60, "cannot be read within 4 GiB; make it smaller"),
    ],
)
def test_a_mesh_that_takes_too_much_costs_its_reader_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int, cpu: int, why: str
) -> None:
    monkeypatch.setattr(meshes, "LIMITS", Limits(cpu=cpu, wall=300))
    path = endless(tmp_path, count)
    with pytest.raises(FileError, match=rf"chair\.gltf {why}\.$"):
        convex_parts(path)


def test_archives_are_no_meshes(tmp_path: Path) -> None:
    """Which trimesh would unpack, to any size."""
    trimesh.creation.box().export(tmp_path / "chair.ply")
    with zipfile.ZipFile(tmp_path / "chair.zip", "w") as archive:
        archive.write(tmp_path / "chair.ply", "chair.ply")
    with pytest.raises(FileError, match=r"no format that is read; export it as \.obj"):
        convex_parts(tmp_path / "chair.zip")


@pytest.mark.parametrize(
    ("bound", "most", "why"),
    [("MOST_BYTES", 200, "more than 0 MiB"), ("MOST_FACES", 11, "more than 11 faces or vertices")],
)
def test_large_meshes_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bound: str, most: int, why: str
) -> None:
    path = tmp_path / "chair.ply"
    trimesh.creation.box().export(path)
    monkeypatch.setattr(meshes, bound, most)
    monkeypatch.setattr(meshes, "_read_apart", meshes._hulls)  # where the bounds are the test's
    monkeypatch.setattr(meshes, "_known", {})
    with pytest.raises(FileError, match=why):
        convex_parts(path)
