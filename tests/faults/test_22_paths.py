"""Fault 22: what a model refers to cannot leave the model's own folder."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import trimesh

from understudy.errors import FileError
from understudy_mujoco import mjcf
from understudy_mujoco.scene import MjcfFile

MODEL = """
<mujoco>{compiler}
  <asset>{asset}</asset>
  <worldbody><body><freejoint/><geom type="mesh" mesh="box"/></body></worldbody>
</mujoco>"""
INCLUDED = "<mujocoinclude><geom size='.3'/></mujocoinclude>"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A model's folder with a mesh, and beside it what must not be reached."""
    folder = tmp_path / "model"
    (folder / "meshes").mkdir(parents=True)
    box = trimesh.creation.box(extents=(1, 2, 3))
    box.export(folder / "meshes" / "box.stl")
    box.export(tmp_path / "box.stl")
    (folder / "part.xml").write_text(INCLUDED)
    (tmp_path / "part.xml").write_text(INCLUDED)
    return folder


def model(folder: Path, asset: str, compiler: str = "") -> MjcfFile:
    file = folder / "model.xml"
    file.write_text(MODEL.format(asset=asset, compiler=compiler))
    return MjcfFile(MjcfFile.Options(str(file)))


@pytest.mark.parametrize(
    ("asset", "compiler"),
    [
        ("<mesh name='box' file='meshes/box.stl'/>", ""),
        ("<mesh file='meshes/box.stl'/>", ""),
        ("<mesh file='box.stl'/>", "<compiler meshdir='meshes'/>"),
        ("<mesh file='box.stl'/>", "<compiler meshdir='elsewhere'/><compiler meshdir='meshes'/>"),
        ("<mesh file='box.stl'/>", "<compiler assetdir='meshes'/>"),
        ("<mesh file='C:\\meshes\\box.stl'/>", "<compiler strippath='true' meshdir='meshes'/>"),
        ("<mesh file='../model/meshes/box.stl'/>", ""),
    ],
)
def test_meshes_of_the_folder_are_read(folder: Path, asset: str, compiler: str) -> None:
    compiled = model(folder, asset, compiler).spec().compile()
    assert compiled.mesh(0).name == "box"
    assert sorted(compiled.geom_size[0]) == pytest.approx([0.5, 1.0, 1.5])


def test_includes_of_the_folder_are_read(folder: Path) -> None:
    (folder / "asset.xml").write_text("<mujoco><mesh file='meshes/box.stl'/></mujoco>")
    file = folder / "model.xml"
    text = MODEL.format(asset="<include file='asset.xml'/>", compiler="")
    file.write_text(text.replace("<worldbody>", "<worldbody><include file='part.xml'/>"))
    compiled = MjcfFile(MjcfFile.Options(str(file))).spec().compile()
    assert (compiled.ngeom, compiled.nmesh) == (2, 1)


@pytest.mark.parametrize(
    ("asset", "compiler"),
    [
        ("<mesh name='box' file='../box.stl'/>", ""),
        ("<mesh name='box' file='meshes/../../box.stl'/>", ""),
        ("<mesh name='box' file='&#46;&#46;/box.stl'/>", ""),
        ("<mesh name='box' file='{outside}/box.stl'/>", ""),
        ("<mesh name='box' file='{outside}/model/meshes/box.stl'/>", ""),
        ("<mesh name='box' file='box.stl'/>", "<compiler meshdir='..'/>"),
        ("<mesh name='box' file='box.stl'/>", "<compiler assetdir='{outside}'/>"),
        ("<mesh name='box' file='..\\box.stl'/>", ""),
        ("<mesh name='box' file='linked.stl'/>", ""),
        ("<mesh name='box' file='out/box.stl'/>", ""),
        ("<texture name='t' type='skybox' file='../box.stl'/>", ""),
        ("<texture name='t' type='cube' fileright='../box.stl'/>", ""),
        ("<hfield name='h' file='../box.stl' size='1 1 1 1'/>", ""),
        ("<include file='../part.xml'/>", ""),
        ("<include file='{outside}/part.xml'/>", ""),
        ("<model name='m' file='../part.xml'/>", ""),
        ("<model name='m' file='{outside}/part.xml'/>", ""),
        ("<model name='m' file='out/part.xml'/>", ""),
        ("<mesh name='box' vertex='0 0 0'><plugin plugin='x'/></mesh>", ""),
        ("", "<extension><plugin plugin='mujoco.elasticity.cable'/></extension>"),
    ],
)
def test_nothing_outside_is_reached(folder: Path, asset: str, compiler: str) -> None:
    (folder / "linked.stl").symlink_to(folder.parent / "box.stl")
    (folder / "out").symlink_to(folder.parent)
    outside = str(folder.parent)
    with pytest.raises(FileError, match="refers to other files than those of its own folder"):
        model(folder, asset.replace("{outside}", outside), compiler.replace("{outside}", outside))


def test_nothing_is_read_from_where_the_program_runs(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder.parent)
    with pytest.raises(FileError, match="there is no file"):
        model(folder, "<mesh name='box' file='box.stl'/>")


@pytest.mark.parametrize("name", ["", "meshes", "none.stl", "a" * 5000, "a\x01b"])
def test_what_is_no_file(folder: Path, name: str) -> None:
    with pytest.raises(FileError):
        model(folder, f"<mesh name='box' file='{name}'/>")


def test_an_include_of_itself(folder: Path) -> None:
    (folder / "one.xml").write_text("<mujoco><include file='two.xml'/></mujoco>")
    (folder / "two.xml").write_text("<mujoco><include file='one.xml'/></mujoco>")
    with pytest.raises(FileError, match="includes itself"):
        model(folder, "<include file='one.xml'/>")


def test_includes_that_multiply(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mjcf, "MAX_FILES", 50)
    for level in range(10):
        twice = f"<include file='{level + 1}.xml'/>" * 2
        (folder / f"{level}.xml").write_text(f"<mujoco>{twice}</mujoco>")
    (folder / "10.xml").write_text("<mujoco/>")
    with pytest.raises(FileError, match="more than 50 files"):
        model(folder, "<include file='0.xml'/>")


@pytest.mark.parametrize("within", ["", "<body>" * 150], ids=["flat", "deep"])
def test_includes_within_includes(folder: Path, within: str) -> None:
    for level in range(1100):
        include = f"{within}<include file='{level + 1}.xml'/>{within.replace('<', '</')}"
        (folder / f"{level}.xml").write_text(f"<mujoco>{include}</mujoco>")
    with pytest.raises(FileError, match="nested more than 200 deep"):
        model(folder, "<include file='0.xml'/>")


@pytest.mark.parametrize(
    "text",
    [
        b"<!DOCTYPE x [<!ENTITY a 'b'><!ENTITY b '&a;&a;'>]><mujoco>&b;</mujoco>",
        "<!DOCTYPE x [<!ENTITY a 'b'>]><mujoco>&a;</mujoco>".encode("utf-16"),
        b"<?xml version='1.0' encoding='hex'?><mujoco/>",
        b"<a>" * 100_000 + b"</a>" * 100_000,
        b"\xff\xfe",
        b"",
    ],
    ids=["entities", "utf-16", "encoding", "depth", "bytes", "empty"],
)
def test_what_is_no_model(folder: Path, text: bytes) -> None:
    file = folder / "model.xml"
    file.write_bytes(text)
    with pytest.raises(FileError, match="does not load"):
        MjcfFile(MjcfFile.Options(str(file)))


def test_assets_are_bounded(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    size = os.path.getsize(folder / "meshes" / "box.stl")
    monkeypatch.setattr(mjcf, "MAX_ASSET_BYTES", size - 1)
    with pytest.raises(FileError, match="is larger than"):
        model(folder, "<mesh name='box' file='meshes/box.stl'/>")
