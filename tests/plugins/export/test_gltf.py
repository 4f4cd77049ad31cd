"""glTF: valid by the specification, and the same motion when read back."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from gltf_file import GltfFile
from hypothesis import given, settings
from motion_files import walker
from moving_figures import angle_error, boxes, clips, position_error
from scipy.spatial import cKDTree

from understudy.errors import FileError
from understudy_export.gltf import GlbWriter, GltfWriter
from understudy_motion.clip import Clip
from understudy_motion.kinematics import forward_kinematics
from understudy_motion.writers.bvh import BvhWriter
from understudy_motion.writing import Shape, Shown
from understudy_tensors import rotations

WRITERS = pytest.mark.parametrize("writer", [GlbWriter(), GltfWriter()], ids=lambda w: w.suffix)
SLOWLY = settings(max_examples=30, deadline=None)


def written(
    folder: Path, clip: Clip, writer: GlbWriter | GltfWriter, shapes: Sequence[Shape] = ()
) -> GltfFile:
    path = folder / f"clip{writer.suffix}"
    writer.write(clip, path, shapes)
    return GltfFile(path)


@WRITERS
@SLOWLY
@given(clip=clips())
def test_the_motion_is_the_same(
    tmp_path_factory: pytest.TempPathFactory, writer: GlbWriter | GltfWriter, clip: Clip
) -> None:
    file = written(tmp_path_factory.mktemp("gltf"), clip, writer)
    file.check()
    assert angle_error(file.joint_rotations(), clip) < 1e-6
    assert position_error(file.root_positions(), clip) < 1e-6
    np.testing.assert_allclose(file.times, clip.times, atol=1e-6)
    assert [n["name"] for n in file.document["nodes"][: len(clip.joint_names)]] == list(
        clip.joint_names
    )


@SLOWLY
@given(clip=clips())
def test_the_surface_follows_the_joints(
    tmp_path_factory: pytest.TempPathFactory, clip: Clip
) -> None:
    shapes = boxes(clip)
    file = written(tmp_path_factory.mktemp("gltf"), clip, GlbWriter(), shapes)
    file.check()
    positions, turns = forward_kinematics(clip)
    for frame in (0, clip.num_frames - 1):
        found, joints = file.skinned(frame)
        for row, shape in enumerate(shapes):
            vertices = torch.from_numpy(shape.vertices)
            expected = positions[frame, row] + rotations.rotate(turns[frame, row], vertices)
            ours, theirs = found[joints == row][:, [2, 0, 1]], expected.numpy()
            assert cKDTree(theirs).query(ours)[0].max() < 1e-4
            assert cKDTree(ours).query(theirs)[0].max() < 1e-4


@pytest.mark.parametrize("away", [100.0, 99_000.0])
def test_far_from_the_origin_a_short_path_stays_exact(tmp_path: Path, away: float) -> None:
    clip = walker(frames=60)
    clip = replace(clip, root_position=clip.root_position + away)
    file = written(tmp_path, clip, GlbWriter())
    assert position_error(file.root_positions(), clip) < 1e-6


def test_a_path_of_a_hundred_metres_is_exact_to_six_micrometres(tmp_path: Path) -> None:
    clip = walker(frames=60)
    clip = replace(clip, root_position=clip.root_position * 100.0 / clip.duration)
    file = written(tmp_path, clip, GlbWriter())
    assert position_error(file.root_positions(), clip) < 6e-6


def test_it_faces_z_with_y_up(tmp_path: Path) -> None:
    still = replace(walker(), rotations=torch.tensor([1.0, 0, 0, 0]).repeat(6, 6, 1))
    file = written(tmp_path, still, GlbWriter())
    root, thigh = file.world(0, 5)[:3, 3], file.world(2, 5)[:3, 3]
    np.testing.assert_allclose(root, [0.0, 0.9, 5 / 30], atol=1e-6)  # it walked along z
    np.testing.assert_allclose(thigh - root, [0.1, 0.0, 0.0], atol=1e-6)  # its left is x


def test_in_the_rest_pose_it_stands_on_the_ground(tmp_path: Path) -> None:
    file = written(tmp_path, walker(), GlbWriter())
    lows = [
        file.document["accessors"][p["attributes"]["POSITION"]]["min"]
        for p in file.document["meshes"][0]["primitives"]
    ]
    assert np.array(lows)[:, 1].min() == pytest.approx(0.0, abs=1e-6)
    foot = file.world(file.document["skins"][0]["joints"][3])[:3, 3]
    assert foot[1] == pytest.approx(0.45, abs=0.01)


def test_the_licence_is_in_the_file(tmp_path: Path) -> None:
    clip = replace(
        walker(), attribution="By Ada\n and Grace.", url="https://example.org", loop=True
    )
    file = written(tmp_path, clip, GltfWriter())
    assert file.document["asset"]["copyright"] == "CC0; By Ada and Grace."
    extras = next(n["extras"] for n in file.document["nodes"] if "extras" in n)
    assert extras == {
        "clip": "walker",
        "licence": "CC0",
        "attribution": "By Ada and Grace.",
        "source": "generated",
        "url": "https://example.org",
        "loop": True,
        "frame_rate": pytest.approx(30.0),
    }


def test_colours_are_materials(tmp_path: Path) -> None:
    clip = walker()
    shapes = [replace(s, colour=(1.0, 0.0, 0.0, 0.5)) for s in boxes(clip)[:2]] + boxes(clip)[2:3]
    materials = written(tmp_path, clip, GlbWriter(), shapes).document["materials"]
    assert [m["pbrMetallicRoughness"]["baseColorFactor"] for m in materials] == [
        [1.0, 0.0, 0.0, 0.5],
        [0.2, 0.2, 0.3, 1.0],
    ]
    assert [m.get("alphaMode", "OPAQUE") for m in materials] == ["BLEND", "OPAQUE"]


@WRITERS
def test_other_readers_accept_it(tmp_path: Path, writer: GlbWriter | GltfWriter) -> None:
    clip = walker()
    ours = written(tmp_path, clip, writer, boxes(clip))
    path = tmp_path / f"clip{writer.suffix}"
    trimesh = pytest.importorskip("trimesh")
    scene = trimesh.load_scene(io.BytesIO(path.read_bytes()), file_type=writer.suffix[1:])
    assert sum(len(g.faces) for g in scene.geometry.values()) == 12 * len(clip.joint_names)
    for row, name in enumerate(clip.joint_names):
        np.testing.assert_allclose(scene.graph.get(name)[0], ours.world(row), atol=1e-9)
    pygltflib = pytest.importorskip("pygltflib", reason="pygltflib is not installed")
    document = pygltflib.GLTF2().load(str(path))
    assert [node.name for node in document.nodes[:6]] == list(clip.joint_names)
    assert len(document.animations[0].channels) == 7


def test_limbs_end_at_their_tips(tmp_path: Path) -> None:
    """By another reader: each last joint has a node below it, in the skin, where its tip is."""
    pygltflib = pytest.importorskip("pygltflib", reason="pygltflib is not installed")
    clip = walker()
    written(tmp_path, clip, GlbWriter())
    document = pygltflib.GLTF2().load(str(tmp_path / "clip.glb"))
    names = [node.name for node in document.nodes]
    assert clip.skeleton is not None
    for name, (x, y, z) in clip.skeleton.tips.items():
        tip = names.index(f"{name}_tip")
        assert tip in document.nodes[names.index(name)].children
        assert tip in document.skins[0].joints
        np.testing.assert_allclose(document.nodes[tip].translation, [y, z, x])
    assert len(document.skins[0].joints) == len(clip.joint_names) + len(clip.skeleton.tips)


def test_a_limb_without_a_tip_ends_with_its_shapes_or_goes_on(tmp_path: Path) -> None:
    clip = walker()
    assert clip.skeleton is not None
    bare = replace(clip, skeleton=replace(clip.skeleton, tips={}))
    for shapes in (boxes(clip), []):
        file = written(tmp_path, bare, GlbWriter(), shapes)
        file.check()
        names = [node["name"] for node in file.document["nodes"]]
        for name in ("chest", "l_shin", "r_shin"):
            tip = file.document["nodes"][names.index(f"{name}_tip")]["translation"]
            assert np.linalg.norm(tip) > 0.01


def test_the_armature_stands_upright(tmp_path: Path) -> None:
    """No node but the joints turns, and at rest the figure is y up by its bones alone."""
    file = written(tmp_path, walker(), GlbWriter())
    assert not any("rotation" in node for node in file.document["nodes"])
    chest, head = (file.world(node)[:3, 3] for node in (1, 6))
    np.testing.assert_allclose(head - chest, [0.0, 0.55, 0.0], atol=1e-6)


def test_two_figures_move_in_one_file(tmp_path: Path) -> None:
    one, other = walker(), replace(walker(), name="other")
    GlbWriter().write_all([Shown(one), Shown(other, (), 1.5)], tmp_path / "two.glb")
    file = GltfFile(tmp_path / "two.glb")
    names = [node["name"] for node in file.document["nodes"]]
    first, second = names.index("hips"), len(names) - names[::-1].index("hips") - 1
    for frame in (0, 5):
        apart = file.world(second, frame)[:3, 3] - file.world(first, frame)[:3, 3]
        np.testing.assert_allclose(apart, [1.5, 0.0, 0.0], atol=1e-6)
    pygltflib = pytest.importorskip("pygltflib", reason="pygltflib is not installed")
    document = pygltflib.GLTF2().load(str(tmp_path / "two.glb"))
    assert len(document.skins) == len(document.meshes) == 2
    assert len(document.animations) == 1
    assert len(document.animations[0].channels) == 2 * (1 + len(one.joint_names))
    with pytest.raises(FileError, match=r"hold one motion; write \.glb"):
        BvhWriter().write_all([Shown(one), Shown(other)], tmp_path / "two.bvh")


def test_a_clip_without_a_skeleton_or_with_too_close_frames_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="no skeleton"):
        GlbWriter().write(replace(walker(), skeleton=None), tmp_path / "a.glb")
    late = torch.cat((torch.zeros(1), 1e5 + 1e-3 * torch.arange(5, dtype=torch.float64)))
    with pytest.raises(FileError, match="fewer seconds"):
        GlbWriter().write(replace(walker(), times=late), tmp_path / "a.glb")
