"""Writes USD with UsdSkel: https://openusd.org/release/api/usd_skel_page_front.html

One skeleton with one animation, and one skinned mesh for each colour of the figure. Metres, z up,
facing x. The animation's values are float32; a time code is a frame.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from understudy.errors import FileError, said
from understudy_export.figure import Figure, Surface, figure, notice, origin, printable
from understudy_motion.clip import Clip, Skeleton
from understudy_motion.writing import ClipWriter, Shape

if TYPE_CHECKING:
    from pxr import Usd, UsdGeom, UsdSkel

_FIGURE = "/Figure"
_SKELETON = f"{_FIGURE}/Skeleton"


class UsdWriter(ClipWriter):
    """Writes a single binary file.

    Raises
    ------
    FileError
        also where the library usd-core is not installed.
    """

    suffix = ".usd"

    def write(self, clip: Clip, path: Path, shapes: Sequence[Shape] = ()) -> None:
        stage = new_stage(f"Clip {path}", *time_codes(clip), notice(clip))
        body = figure(clip, shapes)
        _pose(_skeleton(stage, clip, body), clip, body)
        for number, surface in enumerate(body.surfaces):
            _skin(stage, f"{_FIGURE}/Surface{number}", surface)
        save(stage, f"Clip {path}", path)


class UsdaWriter(UsdWriter):
    """Writes a single text file."""

    suffix = ".usda"


class UsdcWriter(UsdWriter):
    """Writes a single binary file."""

    suffix = ".usdc"


def time_codes(clip: Clip) -> tuple[np.ndarray, float]:
    """The frames' time codes (F,), whole numbers if they are even, and time codes per second."""
    rate = round(clip.frame_rate, 9)
    return np.round(clip.times.numpy() * rate, 6), rate


def joint_paths(skeleton: Skeleton) -> list[str]:
    """Each joint as USD names it: the path from the root, of unique identifiers."""
    from pxr import Tf

    names: list[str] = []
    paths: list[str] = []
    for joint_name, parent in zip(skeleton.joint_names, skeleton.parents, strict=True):
        name = stem = Tf.MakeValidIdentifier(printable(joint_name))
        number = 1
        while name in names:
            number += 1
            name = f"{stem}_{number}"
        names.append(name)
        paths.append(name if parent < 0 else f"{paths[parent]}/{name}")
    return paths


def new_stage(
    what: str, codes: np.ndarray, rate: float, about: dict[str, str] | None = None
) -> Usd.Stage:
    """An empty one with frames at `codes` (F,), `rate` of them a second; `about` says what is to be said of it.

    Raises
    ------
    FileError
        if usd-core is not installed; `what` would be written with it.
    """
    try:
        from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdShade, UsdSkel, Vt  # noqa: F401
    except ImportError as error:
        raise FileError(
            f"{what}: USD is written with usd-core, which is not installed: pip install 'understudy[usd]'."
        ) from error
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(rate)
    stage.SetFramesPerSecond(rate)
    stage.SetStartTimeCode(codes[0])
    stage.SetEndTimeCode(codes[-1])
    stage.GetRootLayer().customLayerData = about or {}
    return stage


def save(stage: Usd.Stage, what: str, path: Path) -> None:
    """To `path`, as its ending says. Raises FileError, where it cannot be written."""
    from pxr import Tf

    try:
        stage.GetRootLayer().Export(str(path))
    except Tf.ErrorException as error:  # one for each block that it tried to write
        reasons = re.findall(r" : '(.*)'$", str(error), re.MULTILINE) or [said(error)]
        raise FileError(f"{what}: cannot be written: {reasons[0]}.") from error
    except UnicodeEncodeError as error:
        raise FileError(f"{what}: USD takes no name that is not UTF-8. Choose another.") from error


def add_mesh(
    stage: Usd.Stage, path: str, points: np.ndarray, faces: np.ndarray, colour: Sequence[float]
) -> UsdGeom.Mesh:
    """Triangles (F, 3) between `points` (V, 3), of one linear RGBA `colour`."""
    from pxr import UsdGeom, Vt

    mesh = UsdGeom.Mesh.Define(stage, path)
    points = points.astype(np.float32)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    mesh.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack((points.min(0), points.max(0)))))
    mesh.CreateFaceVertexCountsAttr(np.full(len(faces), 3))
    mesh.CreateFaceVertexIndicesAttr(np.ascontiguousarray(faces).reshape(-1))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateDisplayColorAttr([tuple(colour[:3])])
    mesh.CreateDisplayOpacityAttr([colour[3]])
    _paint(mesh, colour)
    return mesh


def _skeleton(stage: Usd.Stage, clip: Clip, body: Figure) -> UsdSkel.Skeleton:
    from pxr import Gf, Sdf, UsdGeom, UsdSkel, Vt

    root = UsdSkel.Root.Define(stage, _FIGURE)
    stage.SetDefaultPrim(root.GetPrim())
    UsdGeom.Xformable(root).AddTranslateOp().Set(Gf.Vec3d(*origin(clip).tolist()))
    local = body.skeleton.offsets.copy()
    local[0] = body.rest_positions[0]

    def translations(vectors: np.ndarray) -> Vt.Matrix4dArray:
        matrices = (Gf.Matrix4d().SetTranslate(Gf.Vec3d(*v)) for v in vectors.tolist())
        return Vt.Matrix4dArray(list(matrices))

    skeleton = UsdSkel.Skeleton.Define(stage, _SKELETON)
    skeleton.CreateJointsAttr(joint_paths(body.skeleton))
    skeleton.CreateJointNamesAttr([printable(name) for name in clip.joint_names])
    skeleton.CreateRestTransformsAttr(translations(local))
    skeleton.CreateBindTransformsAttr(translations(body.rest_positions))
    binding = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    binding.CreateAnimationSourceRel().SetTargets([Sdf.Path(f"{_SKELETON}/Animation")])
    return skeleton


def _pose(skeleton: UsdSkel.Skeleton, clip: Clip, body: Figure) -> None:
    from pxr import UsdSkel, Vt

    stage = skeleton.GetPrim().GetStage()
    animation = UsdSkel.Animation.Define(stage, f"{_SKELETON}/Animation")
    animation.CreateJointsAttr(skeleton.GetJointsAttr().Get())
    joints = len(clip.joint_names)
    animation.CreateScalesAttr(Vt.Vec3hArray.FromNumpy(np.ones((joints, 3), np.float16)))
    translations, rotations = animation.CreateTranslationsAttr(), animation.CreateRotationsAttr()
    local = np.repeat(body.skeleton.offsets[None], clip.num_frames, axis=0)
    local[:, 0] = clip.root_position.numpy() - origin(clip)
    local = local.astype(np.float32)
    quaternions = clip.rotations.numpy()[..., [1, 2, 3, 0]].astype(np.float32)
    for frame, code in enumerate(time_codes(clip)[0].tolist()):
        translations.Set(Vt.Vec3fArray.FromNumpy(local[frame]), code)
        rotations.Set(Vt.QuatfArray.FromNumpy(quaternions[frame]), code)


def _skin(stage: Usd.Stage, path: str, surface: Surface) -> None:
    from pxr import Sdf, UsdGeom, UsdSkel, Vt

    mesh = add_mesh(stage, path, surface.positions, surface.faces, surface.colour)
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(surface.normals.astype(np.float32)))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([Sdf.Path(_SKELETON)])
    one = {"constant": False, "elementSize": 1}
    binding.CreateJointIndicesPrimvar(**one).Set(surface.joints.astype(np.int32))
    binding.CreateJointWeightsPrimvar(**one).Set(np.ones(len(surface.joints), np.float32))


def _paint(mesh: UsdGeom.Mesh, colour: Sequence[float]) -> None:
    """Bind a material of that colour, for what does not look at display colours."""
    from pxr import Gf, Sdf, UsdShade

    stage, path = mesh.GetPrim().GetStage(), f"{mesh.GetPath()}/Material"
    material = UsdShade.Material.Define(stage, path)
    shader = UsdShade.Shader.Define(stage, f"{path}/Shader")
    shader.CreateIdAttr("UsdPreviewSurface")
    types = Sdf.ValueTypeNames
    shader.CreateInput("diffuseColor", types.Color3f).Set(Gf.Vec3f(*colour[:3]))
    shader.CreateInput("opacity", types.Float).Set(colour[3])
    shader.CreateInput("roughness", types.Float).Set(0.7)
    output = shader.CreateOutput("surface", types.Token)
    material.CreateSurfaceOutput().ConnectToSource(output)
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
