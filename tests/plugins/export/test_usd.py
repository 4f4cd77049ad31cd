"""USD: what OpenUSD itself reads is the same motion, and it finds nothing wrong with the stage."""

from __future__ import annotations

import os
import resource
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from commands import forked
from hypothesis import given, settings
from motion_files import walker
from moving_figures import angle_error, boxes, clips, position_error
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from worlds import python

from understudy.errors import FileError
from understudy_export.gltf import GlbWriter
from understudy_export.usd import UsdaWriter, UsdcWriter, UsdWriter
from understudy_motion.clip import Clip
from understudy_motion.kinematics import forward_kinematics
from understudy_motion.writing import Shape
from understudy_tensors import rotations

pytest.importorskip("pxr", reason="usd-core is not installed")
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdSkel

WRITERS = [UsdWriter(), UsdaWriter(), UsdcWriter()]


@dataclass
class Read:
    """What OpenUSD's own queries say of a file."""

    stage: Usd.Stage
    cache: UsdSkel.Cache
    skeleton: UsdSkel.SkeletonQuery
    codes: np.ndarray  #: (F,)
    root_positions: np.ndarray  #: (F, 3) m
    joint_rotations: np.ndarray  #: (F, J, 4) wxyz

    @property
    def times(self) -> np.ndarray:
        """(F,) s."""
        return self.codes / self.stage.GetTimeCodesPerSecond()


def read(path: Path) -> Read:
    # A stage of its own, since OpenUSD keeps layers by path.
    stage = Usd.Stage.Open(Sdf.Layer.OpenAsAnonymous(str(path)))
    cache, root = UsdSkel.Cache(), UsdSkel.Root(stage.GetDefaultPrim())
    cache.Populate(root, Usd.PrimDefaultPredicate)
    (binding,) = cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate)
    skeleton = cache.GetSkelQuery(binding.GetSkeleton())
    animation = skeleton.GetAnimQuery()
    codes = animation.GetJointTransformTimeSamples()
    assert codes == sorted(codes)
    to_world = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(skeleton.GetPrim()))
    assert (to_world[:3, :3] == np.eye(3)).all()
    local = np.array([skeleton.ComputeJointLocalTransforms(code) for code in codes])
    turns = Rotation.from_matrix(local[..., :3, :3].swapaxes(-1, -2)).as_quat(scalar_first=True)
    return Read(
        stage, cache, skeleton, np.array(codes), local[:, 0, 3, :3] + to_world[3, :3], turns
    )


def written(folder: Path, clip: Clip, writer: UsdWriter, shapes: Sequence[Shape] = ()) -> Read:
    path = folder / f"clip{writer.suffix}"
    writer.write(clip, path, shapes)
    return read(path)


@pytest.mark.parametrize("writer", WRITERS, ids=lambda w: w.suffix)
@settings(max_examples=25, deadline=None)
@given(clip=clips())
def test_the_motion_is_the_same(
    tmp_path_factory: pytest.TempPathFactory, writer: UsdWriter, clip: Clip
) -> None:
    found = written(tmp_path_factory.mktemp("usd"), clip, writer)
    assert angle_error(found.joint_rotations, clip) < 1e-6
    assert position_error(found.root_positions, clip) < 1e-6
    np.testing.assert_allclose(found.times, clip.times, atol=1e-6)
    assert clip.skeleton is not None
    topology = found.skeleton.GetTopology()
    assert tuple(topology.GetParentIndices()) == clip.skeleton.parents
    assert topology.Validate()
    assert found.skeleton.HasBindPose()
    assert found.skeleton.HasRestPose()


@settings(max_examples=25, deadline=None)
@given(clip=clips())
def test_the_surface_follows_the_joints(
    tmp_path_factory: pytest.TempPathFactory, clip: Clip
) -> None:
    shapes = boxes(clip)
    found = written(tmp_path_factory.mktemp("usd"), clip, UsdcWriter(), shapes)
    positions, turns = forward_kinematics(clip)
    frame = clip.num_frames - 1
    code = found.codes[frame]
    ours: dict[int, list[np.ndarray]] = {row: [] for row in range(len(shapes))}
    for prim in found.stage.Traverse():
        if not prim.IsA(UsdGeom.Mesh):
            continue
        query = found.cache.GetSkinningQuery(prim)
        points = UsdGeom.Mesh(prim).GetPointsAttr().Get()
        assert query.ComputeSkinnedPoints(
            found.skeleton.ComputeSkinningTransforms(code), points, code
        )
        joints = np.array(query.GetJointIndicesPrimvar().Get())
        for row in range(len(shapes)):
            ours[row].append(np.array(points)[joints == row])
    for row, shape in enumerate(shapes):
        vertices = torch.from_numpy(shape.vertices)
        expected = positions[frame, row] + rotations.rotate(turns[frame, row], vertices)
        skinned = np.concatenate(ours[row])
        assert KDTree(expected.numpy()).query(skinned)[0].max() < 1e-4
        assert KDTree(skinned).query(expected.numpy())[0].max() < 1e-4


def test_even_frames_have_whole_time_codes(tmp_path: Path) -> None:
    found = written(tmp_path, walker(frames=50, rate=29.97), UsdaWriter())
    assert found.codes.tolist() == list(range(50))
    assert found.stage.GetTimeCodesPerSecond() == pytest.approx(29.97)
    assert (found.stage.GetStartTimeCode(), found.stage.GetEndTimeCode()) == (0.0, 49.0)


def test_at_rest_it_is_as_it_was_bound(tmp_path: Path) -> None:
    found = written(tmp_path, walker(), UsdcWriter())
    rest = found.skeleton.ComputeJointSkelTransforms(Usd.TimeCode.Default(), atRest=True)
    bound = UsdSkel.Skeleton(found.skeleton.GetPrim()).GetBindTransformsAttr().Get()
    np.testing.assert_allclose(np.array(rest), np.array(bound), atol=1e-12)
    assert np.array(bound)[3, 3, 2] == pytest.approx(0.45, abs=0.01)  # a knee above the ground


def test_metres_z_up_and_a_default_prim(tmp_path: Path) -> None:
    stage = written(tmp_path, walker(), UsdaWriter()).stage
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert stage.GetDefaultPrim().GetTypeName() == "SkelRoot"


def test_far_from_the_origin_a_short_path_stays_exact(tmp_path: Path) -> None:
    clip = replace(walker(60), root_position=walker(60).root_position + 99_000.0)
    assert position_error(written(tmp_path, clip, UsdcWriter()).root_positions, clip) < 1e-6


def test_the_licence_is_in_the_file(tmp_path: Path) -> None:
    clip = replace(walker(), attribution="By Ada.\x00", loop=True)
    data = written(tmp_path, clip, UsdaWriter()).stage.GetRootLayer().customLayerData
    assert data["licence"] == "CC0"
    assert data["attribution"] == "By Ada."
    assert data["loop"] is True
    assert data["frame_rate"] == pytest.approx(30.0)


def test_colours_are_materials(tmp_path: Path) -> None:
    clip = walker()
    shapes = [replace(shape, colour=(1.0, 0.0, 0.0, 0.5)) for shape in boxes(clip)]
    stage = written(tmp_path, clip, UsdcWriter(), shapes).stage
    (mesh,) = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    material = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()[0]
    shader = material.ComputeSurfaceSource()[0]
    assert tuple(shader.GetInput("diffuseColor").Get()) == (1.0, 0.0, 0.0)
    assert shader.GetInput("opacity").Get() == 0.5


def test_joints_of_any_name_are_told_apart(tmp_path: Path) -> None:
    clip = walker()
    assert clip.skeleton is not None
    names = ("mixamorig:Hips", "mixamorig_Hips", "腰", "左", "1", "")
    named = replace(
        clip, joint_names=names, skeleton=replace(clip.skeleton, joint_names=names, tips={})
    )
    found = written(tmp_path, named, UsdaWriter())
    assert len({path.rpartition("/")[2] for path in found.skeleton.GetJointOrder()}) == 6
    prim = UsdSkel.Skeleton(found.skeleton.GetPrim())
    assert tuple(prim.GetJointNamesAttr().Get()) == names


def test_openusd_finds_nothing_wrong(tmp_path: Path) -> None:
    clip = walker()
    path = tmp_path / "clip.usdc"
    UsdcWriter().write(clip, path, boxes(clip))
    validation = pytest.importorskip("pxr.UsdValidation")
    stage = Usd.Stage.Open(str(path))
    context = validation.ValidationContext(validation.ValidationRegistry().GetOrLoadAllValidators())
    assert [error.GetMessage() for error in context.Validate(stage)] == []
    assert isinstance(stage.GetDefaultPrim().GetAttribute("xformOp:translate").Get(), Gf.Vec3d)


def test_without_usd_core_it_says_what_to_install(tmp_path: Path) -> None:
    """Other formats are written all the same."""
    code = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parents[2])!r})
sys.modules["pxr"] = None
from pathlib import Path
from motion_files import walker
from understudy.errors import FileError
from understudy.setup.plugins import installed
from understudy_motion.writing import write_clip
write_clip(walker(), Path("clip.glb"), installed().registry)
try:
    write_clip(walker(), Path("clip.usdc"), installed().registry)
except FileError as error:
    print(error)
"""
    done = forked(code, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "pip install 'understudy[usd]'" in done.stdout
    assert [file.name for file in tmp_path.iterdir()] == ["clip.glb"]


def test_a_clip_without_a_skeleton_is_refused(tmp_path: Path) -> None:
    for writer in (UsdcWriter(), GlbWriter()):
        with pytest.raises(FileError, match="no skeleton"):
            writer.write(replace(walker(), skeleton=None), tmp_path / f"a{writer.suffix}")


@pytest.mark.parametrize("writer", WRITERS, ids=lambda w: w.suffix)
def test_what_does_not_fit_is_said_once(tmp_path: Path, writer: UsdWriter) -> None:
    """OpenUSD has a line for each block that it tried to write."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        with pytest.raises(FileError, match=r"cannot be written: .*File too large") as caught:
            writer.write(walker(frames=50), tmp_path / f"clip{writer.suffix}")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300


def test_a_name_that_is_not_utf_8_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="USD takes no name that is not UTF-8"):
        UsdcWriter().write(walker(frames=5), tmp_path / os.fsdecode(b"\xff.usdc"))


#: Carries out the command where a stop signal comes while OpenUSD is being imported, which goes on as if nothing
#: were: what Python code raises in there is printed and forgotten.
_SWALLOWS = """
import contextlib, os, signal, sys, types
from importlib.abc import MetaPathFinder
from understudy.command.cli import main

class Swallows(MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == "pxr":
            sys.meta_path.remove(self)
            with contextlib.suppress(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGTERM)

for name in [n for n in sys.modules if n.partition(".")[0] == "pxr"]:
    del sys.modules[name]
sys.meta_path.insert(0, Swallows())
sys.exit(main())
"""


def test_a_signal_while_it_is_imported_is_answered(tmp_path: Path) -> None:
    ended = python(_SWALLOWS, "export", "walk", "walk.usda", "--seconds", "0.5", cwd=tmp_path)
    assert ended.returncode == 75, ended.stderr
    assert ended.stderr == "understudy: Stopped by SIGTERM. Give the same command again.\n"
    assert not list(tmp_path.iterdir())
