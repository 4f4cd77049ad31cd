"""Models as strangers write them: each is a character, on one floor, as MuJoCo has it."""

from __future__ import annotations

import os
import re
import shutil
import warnings
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from robots import robot_xml

from understudy.errors import ConfigError, FileError
from understudy.setup.plugins import installed
from understudy_characters.character import Character, load_character
from understudy_characters.scene import CharacterScene
from understudy_mujoco.mjcf import read_mjcf
from understudy_mujoco.trial import not_finite, spec_of

TETRAHEDRON = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
MESH = (
    '<asset><mesh name="m" file="m.obj"/></asset>',
    '<geom type="mesh" mesh="m" mass=".1" contype="0" conaffinity="0"/>',
)


def load(path: Path | str) -> Character:
    return load_character(str(path), installed().registry)


def scene(folder: Path, text: str) -> CharacterScene:
    (folder / "robot.xml").write_text(text)
    return CharacterScene(CharacterScene.Options(str(folder / "robot.xml")))


def added(before: str, text: str) -> str:
    """The robot's file with `text` before the first `before`."""
    return robot_xml().replace(before, text + before, 1)


def floors(model: mujoco.MjModel) -> list[str]:
    """Names of the geoms that stand still and collide."""
    still = [g for g in range(model.ngeom) if model.body_weldid[model.geom_bodyid[g]] == 0]
    return [model.geom(g).name for g in still if model.geom_contype[g]]


def test_hinges_of_one_body_apart(tmp_path: Path) -> None:
    """MuJoCo's own humanoid has its ankles' hinges 4 cm apart."""
    shifted = robot_xml().replace('_ankle_x" axis', '_ankle_x" pos="0 0 .04" axis')
    character = scene(tmp_path, shifted).character
    assert character.model.jnt_pos[:, 2].max() == pytest.approx(0.04)
    plain = scene(tmp_path, robot_xml()).character
    assert character.joint_names == plain.joint_names
    np.testing.assert_allclose(character.rest_positions, plain.rest_positions)


def test_a_reference_of_hinges_apart_is_where_mujoco_has_it(tmp_path: Path) -> None:
    shifted = robot_xml().replace('_ankle_x" axis', '_ankle_x" pos="0 0 .2" axis')
    one = scene(tmp_path, shifted)
    qpos = torch.tensor(one.model.qpos0)[None]
    qpos[:, 7:] = 0.4
    found = one.poses.state(qpos)
    data = mujoco.MjData(one.model)
    data.qpos[:] = qpos[0]
    mujoco.mj_kinematics(one.model, data)
    mujoco.mj_comPos(one.model, data)
    com = data.subtree_com[one.layout.root_body]
    np.testing.assert_allclose(found["com_position"][0], com, atol=1e-9)


BALL = '<body name="ball" pos="2 0 1"><freejoint/><geom size=".1"/></body>'
CART = """<body name="cart" pos="2 0 1"><freejoint/><geom size=".1"/><body name="wheel">
    <joint name="wheel"/><geom size=".1"/></body></body>"""


@pytest.mark.parametrize("prop", [BALL, CART, BALL + CART.replace('pos="2', 'pos="4')])
def test_the_character_is_what_has_the_most_joints(tmp_path: Path, prop: str) -> None:
    before = scene(tmp_path, added('<body name="pelvis"', prop))
    after = scene(tmp_path, robot_xml().replace("</worldbody>", prop + "</worldbody>"))
    for one in (before, after):
        assert one.character.joint_names == scene(tmp_path, robot_xml()).character.joint_names
    assert [before.model.actuator(k).name for k in range(before.model.nu)] == [
        after.model.actuator(k).name for k in range(after.model.nu)
    ]


def test_a_prop_alone_is_no_character(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="nothing hangs on its free body 'ball' by a joint"):
        scene(tmp_path, f"<mujoco><worldbody>{BALL}</worldbody></mujoco>")


@pytest.mark.parametrize(
    ("floor", "height"),
    [
        ('<geom name="floor" type="plane" size="5 5 1"/>', 0.0),
        ('<geom name="ground" type="plane" size="0 0 1" pos="0 0 -.79"/>', 0.0),
        ('<geom name="sky" type="box" size="5 5 .1"/>', -0.1),
        (
            '<body name="floor" pos="0 0 .2"><geom name="sun" type="plane" size="5 5 1"/></body>',
            0.0,
        ),
        ('<geom name="floor" type="plane" size="5 5 1" contype="0" conaffinity="0"/>', 0.0),
        ('<geom name="slab" type="cylinder" size="4 .5" pos="0 0 -3"/>', -0.5),
        ('<geom name="strip" type="box" fromto="0 0 -3 0 0 -2" size="4"/>', -0.5),
    ],
)
def test_a_floor_that_is_there_is_kept_and_is_at_zero(
    tmp_path: Path, floor: str, height: float
) -> None:
    model = scene(tmp_path, added('<body name="pelvis"', floor)).model
    (name,) = floors(model)
    assert f'name="{name}"' in floor
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    assert data.geom(name).xpos[2] == pytest.approx(height, abs=1e-6)


@pytest.mark.parametrize(
    "other",
    [
        '<geom name="floor" type="plane" size="5 5 1" zaxis="1 0 0" pos="-3 0 0"/>',  # a wall
        '<geom name="floor" type="box" size=".1 .1 .1" pos="1 0 .1"/>',  # a box beside it
        '<geom name="floor" type="box" size="5 5 .1" pos="0 0 3"/>',  # a ceiling
        '<body name="floor"><freejoint/><geom name="floor" type="sphere" size=".1"/></body>',
    ],
)
def test_what_is_no_floor_gets_one_of_another_name(tmp_path: Path, other: str) -> None:
    assets = """<asset><texture name="floor" type="2d" builtin="flat" width="2" height="2"/>
        <texture name="sky" type="2d" builtin="flat" width="2" height="2"/>
        <material name="floor"/></asset>"""
    text = added('<body name="pelvis"', other).replace("<worldbody>", assets + "<worldbody>", 1)
    model = scene(tmp_path, text).model
    assert "floor_2" in floors(model)
    assert model.geom("floor_2").type == mujoco.mjtGeom.mjGEOM_PLANE


def test_names_of_servos_are_free(tmp_path: Path) -> None:
    text = """<mujoco><worldbody><body name="r"><freejoint/><geom size=".1"/>
        <body name="a"><joint name="a" type="ball"/><geom size=".1"/>
        <body name="b"><joint name="a_x"/><geom size=".1"/>
        <body name="c"><joint/><geom size=".1"/><body name="d"><joint name="joint3"/><geom size=".1"/>
        </body></body></body></body></body></worldbody></mujoco>"""
    model = scene(tmp_path, text).model
    assert model.nu == 6
    assert len({model.actuator(k).name for k in range(model.nu)}) == 6


def test_without_gravity_servos_are_as_strong_as_on_earth(tmp_path: Path) -> None:
    def strength(gravity: str) -> np.ndarray:
        text = robot_xml().replace(' ctrlrange="-1 1"', "").replace(
            "<default>", f'<option gravity="{gravity}"/><default>'
        )  # fmt: skip
        return scene(tmp_path, text).model.actuator_forcerange

    np.testing.assert_allclose(strength("0 0 0"), strength("0 0 -9.81"))


# ------------------------------------------------------------------------------- files


@pytest.mark.parametrize("name", ["robot.XML", "robot.mjcf", "ROBOT.MJCF", "robot", "robot.txt"])
def test_the_content_decides_not_the_name(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text(robot_xml())
    assert load(tmp_path / name).joint_names[0] == "pelvis"


def test_a_file_that_is_no_model(tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_text("HIERARCHY\n")
    with pytest.raises(FileError, match="no XML"):
        load(tmp_path / "walk.bvh")
    with pytest.raises(FileError, match="cannot be read: there is no file"):
        load(tmp_path / "none.MJCF")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ('<sdf version="1.7"><model name="m"/></sdf>', "<sdf> is neither MJCF .* nor URDF"),
        ("<html><body>404</body></html>", "<html> is neither"),
        ('<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro"><xacro:property name="a"/></robot>', "expand it"),
        ("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n", "git lfs pull"),
        (robot_xml().replace("<default>", '<option gravity="0 -9.81 0"/><default>'), "gravity is .* z is up"),
    ],
)  # fmt: skip
def test_what_is_near_to_a_model_is_named(tmp_path: Path, content: str, said: str) -> None:
    (tmp_path / "robot.xml").write_text(content)
    with pytest.raises((FileError, ConfigError), match=said):
        load(tmp_path / "robot.xml")


def test_a_mesh_that_is_a_pointer_or_differs_in_capitals_is_named(tmp_path: Path) -> None:
    xml = robot_xml().replace(
        "<default>", '<asset><mesh name="m" file="foot.obj"/></asset><default>'
    )
    (tmp_path / "robot.xml").write_text(xml)
    (tmp_path / "Foot.OBJ").write_text(TETRAHEDRON)
    with pytest.raises(FileError, match=r"foot\.obj\. There is Foot\.OBJ"):
        load(tmp_path / "robot.xml")
    (tmp_path / "foot.obj").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\n")
    with pytest.raises(FileError, match=r"foot\.obj only points to a file of Git LFS"):
        load(tmp_path / "robot.xml")


NAMED = '<mujoco model="bipède 步">'


@pytest.mark.parametrize(
    ("encoding", "declared"),
    [
        ("latin-1", "ISO-8859-1"), ("cp1252", "windows-1252"), ("gb18030", "GB18030"),
        ("utf-16", "UTF-16"), ("utf-16", ""), ("utf-8-sig", ""), ("utf-8", "utf-8"), ("latin-1", ""),
    ],
)  # fmt: skip
def test_encodings(tmp_path: Path, encoding: str, declared: str) -> None:
    header = f'<?xml version="1.0" encoding="{declared}"?>\n' if declared else ""
    text = header + robot_xml().strip().replace('<mujoco model="robot">', NAMED)
    (tmp_path / "robot.xml").write_bytes(text.encode(encoding, errors="ignore"))
    assert load(tmp_path / "robot.xml").joint_names[0] == "pelvis"


@pytest.mark.parametrize("said", ["utf-16", "UTF-16", "UTF_16", "utf-32", "UCS-2"])
def test_what_says_utf_16_in_plain_bytes_is_utf_8(tmp_path: Path, said: str) -> None:
    """As programs write that keep text in UTF-16 and say so of the file."""
    text = f'<?xml version="1.0" encoding="{said}"?>' + robot_xml().replace(
        '<mujoco model="robot">', NAMED
    )
    (tmp_path / "robot.xml").write_text(text, encoding="utf-8")
    assert load(tmp_path / "robot.xml").joint_names[0] == "pelvis"
    for encoding in ("utf-16-le", "utf-16-be"):  # without a mark
        (tmp_path / "robot.xml").write_bytes(text.encode(encoding))
        assert load(tmp_path / "robot.xml").joint_names[0] == "pelvis"


@pytest.mark.parametrize("start", ["\n\n", "<!DOCTYPE mujoco>", "<!-- a -- b -->\n", " \t"])
def test_what_mujocos_parser_takes_at_the_start(tmp_path: Path, start: str) -> None:
    (tmp_path / "robot.xml").write_text(start + '<?xml version="1.0"?>' + robot_xml())
    assert load(tmp_path / "robot.xml").joint_names[0] == "pelvis"


def test_a_nested_include_is_looked_for_in_the_models_folder_then_beside(tmp_path: Path) -> None:
    (tmp_path / "xml").mkdir()
    (tmp_path / "robot.xml").write_text("<mujoco><include file='xml/main.xml'/></mujoco>")
    main = robot_xml().replace("<worldbody>", "<include file='extra.xml'/><worldbody>", 1)
    (tmp_path / "xml" / "main.xml").write_text(main)
    text = "<mujocoinclude><statistic extent='{}'/></mujocoinclude>"
    (tmp_path / "xml" / "extra.xml").write_text(text.format(2))
    assert load(tmp_path / "robot.xml").model.stat.extent == 2
    (tmp_path / "extra.xml").write_text(text.format(3))
    assert load(tmp_path / "robot.xml").model.stat.extent == 3
    file = str(tmp_path / "robot.xml")
    assert mujoco.MjModel.from_xml_path(file).stat.extent == 3


def test_a_nested_include_may_go_up_within_the_models_folder(tmp_path: Path) -> None:
    (tmp_path / "xml" / "parts").mkdir(parents=True)
    (tmp_path / "robot.xml").write_text("<mujoco><include file='xml/parts/main.xml'/></mujoco>")
    inner = "<mujocoinclude><include file='{}'/></mujocoinclude>"
    (tmp_path / "xml" / "parts" / "main.xml").write_text(inner.format("../robot.xml"))
    (tmp_path / "xml" / "robot.xml").write_text(robot_xml())
    assert load(tmp_path / "robot.xml").joint_names[0] == "pelvis"
    (tmp_path.parent / "outside.xml").write_text(robot_xml())
    (tmp_path / "xml" / "parts" / "main.xml").write_text(inner.format("../../../outside.xml"))
    with pytest.raises(FileError, match="refers to other files"):
        load(tmp_path / "robot.xml")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<mujoco><include/></mujoco>", "an <include> names no file"),
        ("<mujoco><include file=''/></mujoco>", "an <include> names no file"),
        ("<mujoco><asset><mesh name='m' file=''/></asset></mujoco>", "a mesh or texture names no file"),
        ("<mujoco><include file='xml'/></mujoco>", "there is no file .*/xml. It is a folder."),
        ("<mujoco><include file='pipe.xml'/></mujoco>", "there is no file .*/pipe.xml. It is a pipe or a device."),
    ],
)  # fmt: skip
def test_a_file_that_is_not_named_is_said(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "xml").mkdir()
    os.mkfifo(tmp_path / "pipe.xml")
    (tmp_path / "robot.xml").write_text(text)
    with pytest.raises(FileError, match=said):
        load(tmp_path / "robot.xml")


def package(folder: Path, text: str) -> Path:
    """A package with a model in ``mjcf`` whose mesh is in ``meshes``."""
    for name in ("mjcf", "meshes"):
        (folder / "package" / name).mkdir(parents=True)
    (folder / "package" / "meshes" / "m.obj").write_text(TETRAHEDRON)
    path = folder / "package" / "mjcf" / "robot.xml"
    path.write_text(text)
    return path


def with_mesh(compiler: str = "") -> str:
    text = robot_xml().replace("<default>", MESH[0] + "<default>", 1).replace("angle=", f"{compiler} angle=")  # fmt: skip
    return text.replace("<freejoint/>", "<freejoint/>" + MESH[1], 1)


def test_a_double_slash_names_the_folder_that_a_model_may_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = package(tmp_path, with_mesh('meshdir="../meshes"'))
    with pytest.raises(FileError, match="refers to other files") as refused:
        load(path)
    advice = str(refused.value).split()[-1]  # what the message says to write works
    assert load(advice).model.nmesh == 1
    monkeypatch.chdir(tmp_path / "package")
    assert load(".//mjcf/robot.xml").model.nmesh == 1
    monkeypatch.chdir(tmp_path)
    assert load("package//mjcf/robot.xml").model.nmesh == 1


def test_beyond_the_double_slash_nothing_is_read(tmp_path: Path) -> None:
    package(tmp_path, with_mesh('meshdir="../../elsewhere"'))
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "m.obj").write_text(TETRAHEDRON)
    with pytest.raises(FileError, match="refers to other files"):
        load(f"{tmp_path}/package//mjcf/robot.xml")
    os.symlink(tmp_path / "elsewhere", tmp_path / "package" / "linked")
    path = tmp_path / "package" / "mjcf" / "robot.xml"
    path.write_text(with_mesh('meshdir="../linked"'))
    with pytest.raises(FileError, match="refers to other files"):
        load(f"{tmp_path}/package//mjcf/robot.xml")


URDF = """<?xml version="1.0"?><robot name="biped">
  <link name="pelvis"><inertial><mass value="10"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="package://description/meshes/none.dae"/></geometry></visual>
    <collision><geometry><mesh filename="{mesh}"/></geometry></collision></link>
  <link name="thigh"><inertial><mass value="2"/><inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><cylinder radius=".05" length=".4"/></geometry></collision></link>
  <joint name="hip" type="revolute"><parent link="pelvis"/><child link="thigh"/><origin xyz="0 0 -.3"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="33" velocity="3"/></joint>
  <link name="camera"/><joint name="fixed" type="fixed"><parent link="thigh"/><child link="camera"/></joint>
</robot>"""  # fmt: skip


@pytest.mark.parametrize(
    ("mesh", "place"),
    [
        ("package://description/meshes/m.obj", "//urdf/robot.urdf"),
        ("../meshes/m.obj", "//urdf/robot.urdf"),
        ("m.obj", "/robot.urdf"),
        ("meshes/m.obj", "/robot.urdf"),
        ("package://description/m.obj", "/robot.urdf"),
        ("elsewhere/m.obj", "/robot.urdf"),
        ("model://description/meshes/m.obj", "//urdf/robot.urdf"),
        ("file://$(find description)/meshes/m.obj", "//urdf/robot.urdf"),
        ("package://named_otherwise/meshes/m.obj", "//urdf/robot.urdf"),
        ("meshes/m.obj", "//urdf/robot.urdf"),
        ("..\\meshes\\m.obj", "//urdf/robot.urdf"),
        ("file://{folder}/meshes/m.obj", "//urdf/robot.urdf"),
        ("{folder}/meshes/m.obj", "//urdf/robot.urdf"),
    ],
)
def test_a_urdf_is_a_character_with_a_free_first_link(
    tmp_path: Path, mesh: str, place: str
) -> None:
    folder = tmp_path / "description"
    for name in ("urdf", "meshes"):
        (folder / name).mkdir(parents=True)
    for where in ("m.obj", "meshes/m.obj"):
        (folder / where).write_text(TETRAHEDRON)
    for where in ("robot.urdf", "urdf/robot.urdf"):
        (folder / where).write_text(URDF.format(mesh=mesh.format(folder=folder)))
    character = load(f"{folder}{place}")
    assert character.joint_names == ("pelvis", "thigh")
    model = CharacterScene(CharacterScene.Options(f"{folder}{place}")).model
    assert (model.nmesh, model.nu) == (1, 1)
    np.testing.assert_allclose(model.actuator_forcerange[0], [-33, 33])
    np.testing.assert_allclose(model.jnt_range[1], [-1, 1])


def urdf(folder: Path, *changes: tuple[str, str]) -> Path:
    """A file of a URDF without meshes."""
    text = URDF.format(mesh="")
    for old, new in (
        ('<collision><geometry><mesh filename=""/></geometry></collision>', ""),
        *changes,
    ):
        assert old in text
        text = text.replace(old, new)
    path = folder / "robot.urdf"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    "change",
    [
        ('<link name="camera"/>', '<xacro:leg side="left"/><link name="camera"/>'),
        ('radius=".05"', 'radius="${r}"'),
        ('radius=".05"', 'radius="$(arg r)"'),
    ],
)
@pytest.mark.parametrize("bound", [True, False])
def test_a_template_of_a_urdf_says_so(tmp_path: Path, change: tuple[str, str], bound: bool) -> None:
    space = ' xmlns:xacro="http://www.ros.org/wiki/xacro"' if bound else ""
    path = urdf(tmp_path, change, ('name="biped"', f'name="biped"{space}'))
    with pytest.raises(
        FileError, match=r"a template: expand it first, by xacro FILE > robot\.urdf"
    ):
        load(path)


@pytest.mark.parametrize(
    ("change", "nu", "ranges"),
    [
        (('name="biped"', 'name="biped" xmlns:xacro="http://www.ros.org/wiki/xacro"'), 1, [-1, 1]),
        (('"revolute"', '"continuous"'), 1, [0, 0]),
        (('<link name="pelvis">', '<link name="world"/><joint name="root" type="floating"><parent link="world"/>'
          '<child link="pelvis"/></joint><link name="pelvis">'), 1, [-1, 1]),
        (('<link name="pelvis">', '<material name="m"><texture filename="none.png"/></material><link name="pelvis">'),
         1, [-1, 1]),
        (('</robot>', '<gazebo/><transmission name="t"/><ros2_control/></robot>'), 1, [-1, 1]),
        (('</robot>', '<gazebo><plugin name="p" filename="p.so"/></gazebo><ros2_control><hardware><plugin>p</plugin>'
          '</hardware></ros2_control></robot>'), 1, [-1, 1]),
        (('name="biped"', 'name="biped" xmlns="http://www.ros.org"'), 1, [-1, 1]),
        (('<link name="pelvis">', '<link name="base"/><joint name="root" type="fixed"><parent link="base"/>'
          '<child link="pelvis"/></joint><link name="pelvis">'), 1, [-1, 1]),
    ],
    ids=["namespace", "continuous", "floating", "texture", "gazebo", "plugins", "default-namespace", "frame"],
)  # fmt: skip
def test_urdf_as_programs_write_it(
    tmp_path: Path, change: tuple[str, str], nu: int, ranges: list[float]
) -> None:
    model = CharacterScene(CharacterScene.Options(str(urdf(tmp_path, change)))).model
    assert (model.nu, model.nv) == (nu, 6 + nu)
    np.testing.assert_allclose(model.jnt_range[1], ranges)


@pytest.mark.parametrize(("kind", "joint"), [("prismatic", "hip"), ("planar", "hip_TX")])
def test_a_joint_that_slides_is_named_with_what_to_do(
    tmp_path: Path, kind: str, joint: str
) -> None:
    path = urdf(tmp_path, ('"revolute"', f'"{kind}"'))
    with pytest.raises(
        ConfigError,
        match=f"body 'thigh' has the joint '{joint}', along which it slides, .* type=\"fixed\"",
    ):
        load(path)
    more = '<link name="finger"/><joint name="grip" type="fixed"><parent link="thigh"/><child link="finger"/></joint>'
    fixed = urdf(tmp_path, ("</robot>", more + "</robot>"))
    assert load(fixed).joint_names == ("pelvis", "thigh")  # what the message says to write works


def test_a_joint_that_follows_another_is_said(tmp_path: Path) -> None:
    path = urdf(tmp_path, ("</joint>", '<mimic joint="knee"/></joint>'))
    with pytest.warns(
        UserWarning, match=r"follow others \(mimic\); here each moves by itself: hip"
    ):
        load(path)


def test_an_effort_below_zero(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="joint 'hip' has an effort of -33"):
        load(urdf(tmp_path, ('effort="33"', 'effort="-33"')))


def test_a_mesh_as_written_on_windows(tmp_path: Path) -> None:
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets" / "m.obj").write_text(TETRAHEDRON)
    text = with_mesh().replace('file="m.obj"', 'file="assets\\m.obj"')
    (tmp_path / "robot.xml").write_text(text)
    assert load(tmp_path / "robot.xml").model.nmesh == 1


def test_a_urdf_with_a_range_upside_down(tmp_path: Path) -> None:
    upside_down = URDF.format(mesh="").replace(
        '<collision><geometry><mesh filename=""/></geometry></collision>', ""
    )
    (tmp_path / "robot.urdf").write_text(
        upside_down.replace('lower="-1" upper="1"', 'lower="1" upper="-1"')
    )
    with pytest.raises(
        FileError, match="joint 'hip' has the lower limit 1, above its upper one of -1"
    ):
        load(tmp_path / "robot.urdf")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('pos="0 0.09 0"', 'pos="0 inf 0"', "body_pos of 'left_thigh'"),
        ('damping=".2"', 'damping="nan"', "dof_damping of '"),
        ('range="0 2.5"', 'range="0 nan"', "jnt_range of 'left_knee'"),
        ("<default>", '<option wind="0 nan 0"/><default>', "wind"),
        ("<default>", '<default><geom friction="inf 1 1"/>', "geom_friction"),
    ],
)
def test_numbers_that_are_none_are_named(old: str, new: str, said: str) -> None:
    """MuJoCo compiles them."""
    assert old in robot_xml()
    model = mujoco.MjModel.from_xml_string(robot_xml().replace(old, new, 1))
    assert re.match(said, not_finite(model))


def test_a_model_with_a_number_that_is_none_is_refused(tmp_path: Path) -> None:
    assert not_finite(mujoco.MjModel.from_xml_string(robot_xml())) == ""
    (tmp_path / "robot.xml").write_text(robot_xml().replace('damping=".2"', 'damping="nan"'))
    with pytest.raises(
        FileError, match=r"robot\.xml does not compile: its dof_damping of '.*' is no finite number"
    ):
        load(tmp_path / "robot.xml")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('damping=".2"', 'damping="-1"', "dof_damping of 'left_hip_x' is -1; let it be 0 or more"),
        ('armature=".01"', 'armature="-1"', "dof_armature of '.*' is -1"),
        ("<default>", '<default><geom friction="1 -1 0"/>', "geom_friction.* is -1"),
        ("<default>", '<option viscosity="-1"/><default>', "viscosity is -1"),
        ('range="0 2.5"', 'range="2.5 0"', "jnt_range of 'left_knee' begins at 2.5, above its end at 0"),
        ('mass="6"', 'mass="6e9"', "body_mass of 'pelvis' is 6e[+]09 kg, more than 1e[+]06; lengths are metres"),
        ("<default>", '<option gravity="0 0 -1e30"/><default>', "gravity of 1e[+]30 m/s² is more than 10000"),
    ],
)  # fmt: skip
def test_numbers_that_nothing_has_are_named(tmp_path: Path, old: str, new: str, said: str) -> None:
    """MuJoCo compiles them: a joint that drives itself, or one whose limits are none."""
    assert old in robot_xml()
    (tmp_path / "robot.xml").write_text(robot_xml().replace(old, new, 1))
    with pytest.raises(FileError, match=f"does not compile: its {said}"):
        load(tmp_path / "robot.xml")


def test_a_figure_in_millimetres_is_named(tmp_path: Path) -> None:
    """With masses of its own it weighs what it should."""
    text = re.sub(
        r'(pos|fromto|size)="([^"]*)"',
        lambda found: f'{found[1]}="{" ".join(str(1000 * float(x)) for x in found[2].split())}"',
        robot_xml(),
    )
    (tmp_path / "robot.xml").write_text(text)
    with pytest.raises(
        ConfigError, match=r"m apart\. Lengths of a model are metres; if its unit is the millimetre"
    ):
        load(tmp_path / "robot.xml")


def test_more_joints_than_a_clip_may_have(tmp_path: Path) -> None:
    """At once; the servos of each would be worked out for minutes."""
    more = "".join('<body><joint/><geom size=".01"/></body>' for _ in range(1000))
    (tmp_path / "robot.xml").write_text(added('<body name="left_shin"', more))
    with pytest.raises(ConfigError, match="of its bodies move, and a clip has at most 1000 joints"):
        load(tmp_path / "robot.xml")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('<body name="left_shin"', '<body name="empty"><joint/></body><body name="left_shin"', "(element 'empty')"),
        ("<mujoco", "<mujoco bogus='1'", "'bogus' (element 'mujoco')"),
        ('<body name="left_shin"', '<body name="empty"><joint/></body><body name="left_shin"', "; give it a mass"),
    ],
)  # fmt: skip
def test_what_mujoco_refuses_is_named(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in robot_xml()
    (tmp_path / "robot.xml").write_text(robot_xml().replace(old, new, 1))
    with pytest.raises(FileError, match=re.escape(said)) as caught:
        load(tmp_path / "robot.xml")
    assert "\n" not in str(caught.value)


def test_a_mesh_that_mujoco_does_not_read_says_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "m.dae").write_text("<COLLADA/>")
    (tmp_path / "robot.urdf").write_text(URDF.format(mesh="m.dae"))
    with pytest.raises(FileError, match=r"'m\.dae'.*; export the mesh as STL or OBJ"):
        load(tmp_path / "robot.urdf")


def test_a_text_of_a_mesh_says_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "m.stl").write_text("solid m\n" + "facet normal 0 0 1\n" * 20)
    (tmp_path / "robot.urdf").write_text(URDF.format(mesh="m.stl"))
    with pytest.raises(FileError, match=r"'m\.stl'.*; export the mesh as a binary STL or an OBJ"):
        load(tmp_path / "robot.urdf")


def test_a_urdf_reads_nothing_outside(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "m.obj").write_text(TETRAHEDRON)
    (tmp_path / "robot").mkdir()
    for mesh in ("package://other/m.obj", "../other/m.obj", f"{tmp_path}/other/m.obj"):
        path = tmp_path / "robot" / "robot.urdf"
        path.write_text(URDF.format(mesh=mesh))
        with pytest.raises(FileError, match=r"refers to other files|there is no file"):
            load(path)


ARM = """<body name="arm" pos="2 0 1"><joint name="lift" type="slide"/><geom size=".1"/><body name="hand">
    <joint name="grip"/><geom size=".1"/></body></body>"""


@pytest.mark.parametrize(
    ("other", "said"),
    [(CART, r"'cart' \(1 joint\)"), (ARM, r"'arm' \(2 joints\)"), (ARM + CART, "'arm'.*'cart'")],
    ids=["on a free body", "on the world", "both"],
)
@pytest.mark.parametrize("first", [True, False])
def test_another_robot_is_said(tmp_path: Path, other: str, said: str, first: bool) -> None:
    """It is simulated, and no action moves it."""
    before = '<body name="pelvis"' if first else "</worldbody>"
    with pytest.warns(UserWarning, match=rf"than the character 'pelvis': {said}"):
        scene(tmp_path, added(before, other))


def test_things_beside_a_robot_are_not_spoken_of(tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not scene(tmp_path, added("</worldbody>", BALL)).character.company


@pytest.mark.parametrize(
    "size", ['memory="1K"', 'memory="20K"', 'nconmax="1" njmax="1"', 'nstack="10"']
)
def test_sizes_of_a_model_leave_no_contact_out(tmp_path: Path, size: str) -> None:
    """What does not fit into them, MuJoCo leaves out, or it ends; they knew nothing of the floor that is added."""
    model = scene(tmp_path, added("<compiler", f"<size {size}/>")).model
    plain = scene(tmp_path, robot_xml()).model
    ends = []
    for one in (model, plain):
        data = mujoco.MjData(one)
        data.qpos[2] = 0.1  # lying in the floor: as many contacts as there can be
        for _ in range(50):
            mujoco.mj_step(one, data)
        assert not any(warning.number for warning in data.warning)
        ends.append(data.qpos.copy())
    np.testing.assert_array_equal(*ends)


def test_a_model_may_ask_for_more_memory(tmp_path: Path) -> None:
    assert scene(tmp_path, added("<compiler", '<size memory="40M"/>')).model.narena == 40 * 2**20


@pytest.mark.parametrize(
    "option",
    [
        '<option><flag contact="disable"/></option>',
        '<option><flag constraint="disable"/></option>',
        '<option><flag actuation="disable"/></option>',
        '<option actuatorgroupdisable="0"/>',
    ],
)
def test_a_model_in_which_nothing_stands_or_moves_is_refused(tmp_path: Path, option: str) -> None:
    """As one that was only looked at: it fell through the floor, or its servos did nothing, in silence."""
    named = re.sub(r"</?option>|<option |/>$|=.*", "", option)
    with pytest.raises(
        ConfigError, match="switches off what a character stands and moves by"
    ) as no:
        scene(tmp_path, added("<compiler", option))
    assert named in str(no.value)


@pytest.mark.parametrize(
    "other", ['<option actuatorgroupdisable="3"/>', '<option><flag gravity="disable"/></option>']
)
def test_what_switches_off_something_else_is_as_the_model_has_it(
    tmp_path: Path, other: str
) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene(tmp_path, added("<compiler", other))


@pytest.mark.parametrize(
    ("tie", "tied"),
    [
        ('<weld body1="pelvis"/>', True),
        ('<connect body1="left_foot" anchor="0 0 0"/>', True),
        ('<weld body1="pelvis" body2="post"/>', True),
        ('<weld site1="there" site2="here"/>', True),
        ('<weld body1="pelvis" body2="crane"/>', True),
        ('<weld body1="pelvis" active="false"/>', False),
        ('<weld body1="left_foot" body2="right_foot"/>', False),
        ('<joint joint1="left_knee" joint2="right_knee"/>', False),
    ],
)
def test_a_figure_that_hangs_on_the_world_is_said(tmp_path: Path, tie: str, tied: bool) -> None:
    post = '<body name="post"><geom size=".1"/></body><body name="crane" mocap="true"/><site name="there"/>'
    text = added("</worldbody>", post).replace("<freejoint/>", '<freejoint/><site name="here"/>', 1)
    text = text.replace("<compiler", f"<equality>{tie}</equality><compiler", 1)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene(tmp_path, text)
    said = [str(one.message) for one in caught]
    assert any("to the world (<equality>), so it cannot fall" in one for one in said) == tied, said


@pytest.mark.parametrize(
    ("unit", "reach", "said"),
    [
        ("degree", 1.57, "none of its hinges turn by more than 2.5 degrees"),
        ("degree", 90.0, ""),
        ("radian", 1.57, ""),
        ("radian", 90.0, "most of its hinges turn by 90 radians"),
    ],
)
def test_ranges_of_the_other_unit_of_angles_are_said(
    tmp_path: Path, unit: str, reach: float, said: str
) -> None:
    """MJCF's unit is the degree where a model says none: radians then hold each hinge fast, and degrees for radians leave it
    free, in silence."""
    text = re.sub(
        r'(<joint name="[^"]*" axis="[01 ]*")/>', rf'\1 range="-{reach} {reach}"/>', robot_xml()
    )
    text = text.replace('angle="radian"', f'angle="{unit}"')
    (tmp_path / "robot.xml").write_text(text)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load(tmp_path / "robot.xml")
    found = [str(one.message) for one in caught if "hinges turn by" in str(one.message)]
    assert bool(found) == bool(said)
    assert said in "".join(found)


@pytest.mark.parametrize(
    ("servo", "said"),
    [
        (
            'position kp="50" ctrlrange="-90 90"',
            "targets be 90 radians from zero. If these are degrees",
        ),
        ('position kp="50" ctrlrange="-90 90" gear="100"', ""),
        ('position kp="50" ctrlrange="-1.57 1.57"', ""),
        ('position kp="50" ctrlrange="-90 90" ctrllimited="false"', ""),
        ('motor ctrlrange="-90 90"', ""),
        ('velocity kv="5" ctrlrange="-90 90"', ""),
    ],
)
@pytest.mark.parametrize("unit", ["degree", "radian"])
def test_targets_in_degrees_are_said(tmp_path: Path, unit: str, servo: str, said: str) -> None:
    """A control range is in radians whatever the compiler's angle is: targets in degrees went round and round, in silence."""
    text = robot_xml().replace('angle="radian"', f'angle="{unit}"')
    text = text.replace("</mujoco>", f'<actuator><{servo} joint="left_knee"/></actuator></mujoco>')
    (tmp_path / "robot.xml").write_text(text)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load(tmp_path / "robot.xml")
    found = [str(one.message) for one in caught if "servos' targets" in str(one.message)]
    assert bool(found) == bool(said)
    assert said in "".join(found)


@pytest.mark.parametrize(
    ("unnamed", "other"), [("pelvis", "head"), ("left_thigh", "head"), ("left_thigh", "left_shin")]
)
def test_a_body_without_a_name_gets_one_that_is_free(
    tmp_path: Path, unnamed: str, other: str
) -> None:
    """MuJoCo numbers bodies in the file's order: the pelvis is 1, the left thigh 2."""
    number = {"pelvis": 1, "left_thigh": 2}[unnamed]
    text = robot_xml().replace(f'name="{unnamed}" ', "", 1)
    character = scene(tmp_path, text.replace(f'"{other}"', f'"body{number}"', 1)).character
    assert len(set(character.joint_names)) == len(character.joints) == 12
    assert character.joint_names[number - 1] == f"body{number}_"


def test_a_hinge_without_a_name_gets_one_that_is_free(tmp_path: Path) -> None:
    text = (
        robot_xml()
        .replace('name="left_hip_x" ', "", 1)
        .replace('<motor joint="left_hip_x" gear="120"/>', "")
    )
    (tmp_path / "robot.xml").write_text(text.replace('"waist"', '"joint1"'))
    assert len(load(tmp_path / "robot.xml").hinges) == 21


def test_a_floor_in_a_frame_that_is_turned_is_lowered_straight_down(tmp_path: Path) -> None:
    floor = """<frame pos="0 0 .3" euler="1.5707963 0 0"><frame pos="2 0 0">
        <geom name="ground" type="plane" size="0 0 1" euler="-1.5707963 0 0"/></frame></frame>"""
    model = scene(tmp_path, added('<body name="pelvis"', floor)).model
    np.testing.assert_allclose(model.geom("ground").pos, [2.0, 0.0, 0.0], atol=1e-7)


def test_of_a_model_that_collides_by_pairs_only_what_is_in_one_does(tmp_path: Path) -> None:
    """As the models for MuJoCo's GPU simulators are, of which the feet touch the floor and nothing else."""
    text = added(
        "</mujoco>",
        '<contact><pair geom1="sole" geom2="ground" friction=".7 .7 .1 .1 .1"/></contact>',
    )
    text = text.replace("<default>", '<default><geom contype="0" conaffinity="0"/>', 1)
    text = text.replace(
        '<geom type="box" size=".1 .045', '<geom name="sole" type="box" size=".1 .045', 1
    )
    text = text.replace(
        '<body name="pelvis"',
        '<geom name="ground" type="plane" size="0 0 1"/><body name="pelvis"',
        1,
    )
    (tmp_path / "whole.xml").write_text(robot_xml())
    found = scene(tmp_path, text).character
    model = found.model
    assert [model.geom(g.id).name for g in found.geoms] == ["sole"]
    assert floors(model) == ["ground"]
    assert model.geom_contype.astype(bool).sum() == 2
    assert model.body_subtreemass[found.root] == pytest.approx(41.8)
    assert found.length > 0.8 * load(tmp_path / "whole.xml").length


def test_of_two_compilers_the_last_says_whether_paths_are_stripped(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "m.obj").write_text(TETRAHEDRON)
    text = added("<worldbody>", '<asset><mesh name="m" file="a/m.obj"/></asset>')
    text = text.replace("<compiler", '<compiler strippath="true"/><compiler strippath="false"', 1)
    assert len(scene(tmp_path, text).character.joints) == 12


ARM = """<mujoco model="arm"><compiler angle="radian" meshdir="shapes"/><default><joint damping="3"/></default>
<asset><mesh name="m" file="m.obj"/></asset><worldbody><body name="upper" pos="0 0 .1">
<joint name="shoulder" axis="0 1 0" range="-1 1"/><geom type="capsule" size=".04" fromto="0 0 0 .3 0 0" mass="1"/>
<body name="lower" pos=".3 0 0"><joint name="elbow" axis="0 1 0" range="0 2"/>{more}
<geom type="mesh" mesh="m" mass=".5"/></body></body></worldbody>
<actuator><motor name="m" joint="elbow"/></actuator></mujoco>"""
TORSO = """<mujoco model="torso"><asset><model {name}file="{file}"/></asset><worldbody>
<body name="torso" pos="0 0 1"><freejoint/><geom type="box" size=".1 .1 .2" mass="5"/>
<frame pos="0 .2 .2"><attach model="arm" body="upper" prefix="l_"/></frame>
<frame pos="0 -.2 .2"><attach model="arm" {body}prefix="r_"/></frame>{more}</body></worldbody></mujoco>"""
BODY = 'body="upper" '


def attaching(
    tmp_path: Path, arm: str = ARM, torso: str = TORSO, file: str = "parts/arm.xml",
    name: str = 'name="arm" ', body: str = BODY, more: str = "", of_arm: str = "",
) -> Path:  # fmt: skip
    """A model that attaches two of another one, with a mesh, from a folder of its own."""
    (tmp_path / "own" / "parts" / "shapes").mkdir(parents=True)
    (tmp_path / "own" / "parts" / "shapes" / "m.obj").write_text(TETRAHEDRON)
    (tmp_path / "own" / "parts" / "arm.xml").write_text(arm.replace("{more}", of_arm))
    text = torso
    for key, value in {"file": file, "name": name, "body": body, "more": more}.items():
        text = text.replace("{" + key + "}", value)
    (tmp_path / "own" / "torso.xml").write_text(text)
    return tmp_path / "own" / "torso.xml"


def alike(one: mujoco.MjModel, other: mujoco.MjModel) -> None:
    names = [[m.joint(k).name for k in range(m.njnt)] for m in (one, other)]
    assert names[0] == names[1]
    for key in (
        "jnt_range",
        "dof_damping",
        "body_pos",
        "body_mass",
        "body_inertia",
        "qpos0",
        "geom_size",
    ):
        np.testing.assert_allclose(getattr(one, key), getattr(other, key), atol=1e-12)


@pytest.mark.parametrize(("name", "body"), [('name="arm" ', BODY), ("", BODY), ('name="arm" ', "")])
def test_a_model_that_attaches_others_is_what_mujoco_makes_of_it(
    tmp_path: Path, name: str, body: str
) -> None:
    """It was refused."""
    path = attaching(tmp_path, name=name, body=body)
    found = spec_of(read_mjcf(path))
    alike(found.compile(), mujoco.MjSpec.from_file(str(path)).compile())
    alike(found.copy().compile(), found.compile())
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # each model has its own unit of angles
        character = load(path)
    assert list(character.hinges) == ["l_shoulder", "l_elbow", "r_shoulder", "r_elbow"]


@pytest.mark.parametrize(
    "more",
    [
        '<replicate count="3" euler="0 0 40" sep="-"><attach model="arm" body="upper" prefix="x_"/></replicate>',
        '<replicate count="2" offset="0 0 .1"><body name="mid" pos=".2 0 0"><joint name="bend"/><geom size=".03"/>'
        '<attach model="arm" prefix="x_"/></body></replicate>',
        '<replicate count="2" sep="_" euler="0 0 90"><replicate count="11" offset=".1 0 0"><attach model="arm" body="upper" '
        'prefix="x_"/></replicate><attach model="arm" body="upper" prefix="y_"/></replicate>',
    ],
)
def test_models_attached_within_replicate_are_what_mujoco_makes_of_them(
    tmp_path: Path, more: str
) -> None:
    """They were refused."""
    path = attaching(tmp_path, more=more)
    found, own = spec_of(read_mjcf(path)).compile(), mujoco.MjModel.from_xml_path(str(path))
    alike(found, own)
    assert [found.actuator(k).name for k in range(found.nu)] == [
        own.actuator(k).name for k in range(own.nu)
    ]
    assert own.nu > 3
    np.testing.assert_allclose(found.body_quat, own.body_quat, atol=1e-12)
    assert len(load(path).hinges) == own.njnt - 1


def test_a_key_of_a_model_that_attaches_others_is_of_its_own_joints(tmp_path: Path) -> None:
    """Attached bodies came after the others of their parent, so that a key's numbers were of other joints than its author
    meant."""
    more = '<body name="head"><joint name="neck" axis="0 0 1"/><geom size=".1"/></body>'
    text = TORSO.replace(
        "</worldbody>",
        '</worldbody><keyframe><key qpos="0 0 1 1 0 0 0 .1 .2 .3 .4 .5"/></keyframe>',
    )
    found = spec_of(read_mjcf(attaching(tmp_path, torso=text, more=more))).compile()
    at = {found.joint(k).name: int(found.jnt_qposadr[k]) for k in range(1, found.njnt)}
    assert [*at] == ["l_shoulder", "l_elbow", "r_shoulder", "r_elbow", "neck"]
    assert found.key_qpos[0, at["neck"]] == 0.5


def test_a_copy_of_it_needs_no_other_folder(tmp_path: Path) -> None:
    path = attaching(tmp_path)
    read = read_mjcf(path)
    (tmp_path / "copy").mkdir()
    read.write(tmp_path / "copy" / "torso.xml")
    shutil.rmtree(path.parent)
    again = read_mjcf(tmp_path / "copy" / "torso.xml")
    alike(spec_of(again).compile(), spec_of(read).compile())
    assert sorted(p.name for p in (tmp_path / "copy").glob("*.xml")) == [
        "attached-1.xml",
        "torso.xml",
    ]


def test_models_attach_others_that_attach_others(tmp_path: Path) -> None:
    path = attaching(
        tmp_path, arm=ARM.replace("<asset>", '<asset><model name="hand" file="hand.xml"/>'),
        of_arm='<frame pos=".3 0 0"><attach model="hand" body="palm" prefix="h_"/></frame>',
    )  # fmt: skip
    hand = '<mujoco><worldbody><body name="palm"><joint name="wrist" axis="0 0 1"/><geom size=".05"/></body></worldbody></mujoco>'
    (path.parent / "parts" / "hand.xml").write_text(hand)
    found = spec_of(read_mjcf(path)).compile()
    assert [found.joint(k).name for k in range(1, found.njnt)] == [
        f"{side}_{name}" for side in "lr" for name in ("shoulder", "elbow", "h_wrist")
    ]


OUTSIDE = '<mujoco model="arm"><worldbody><body name="upper"><geom size=".1"/></body></worldbody></mujoco>'


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"file": "../outside.xml"}, "refers to other files than those of its own folder"),
        ({"file": "/etc/passwd"}, "refers to other files than those of its own folder"),
        ({"file": "parts/none.xml"}, r"there is no file .*none\.xml"),
        ({"file": ""}, r"a <model> names no file"),
        ({"file": "torso.xml"}, "attaches itself"),
        ({"arm": ARM.replace("m.obj", "../../../outside.xml")}, "refers to other files than those of its own folder"),
        ({"arm": ARM.replace('meshdir="shapes"', 'meshdir="/etc"')}, "refers to other files than those of its own folder"),
        ({"arm": ARM.replace("<asset>", '<extension><plugin plugin="x"/></extension><asset>')}, "or to plugins"),
        ({"arm": ARM.replace("<asset>", '<asset><model name="up" file="../torso.xml"/>')}, "attaches itself"),
        ({"arm": ARM.replace("<asset>", '<asset><model name="up" file="../../outside.xml"/>')}, "refers to other files"),
        ({"arm": "<robot name='arm'><link name='upper'/></robot>"}, "attaches the URDF"),
        ({"arm": "no XML"}, "no XML"),
        ({"body": 'body="none" '}, "the model 'arm' that it attaches has no body 'none'"),
        ({"name": 'name="other" '}, "it attaches the model 'arm', which it does not name"),
        ({"more": '<replicate count="600"><attach model="arm" body="upper" prefix="x"/></replicate>'}, "more than 500 models in all"),
        ({"more": '<attach model="arm" body="upper" prefix="l_"/>'}, "does not (load|compile)"),
    ],
)  # fmt: skip
def test_what_a_model_may_not_attach_is_said(
    tmp_path: Path, changes: dict[str, str], said: str
) -> None:
    """A stranger's model reads nothing but its own folder, whoever attaches what."""
    (tmp_path / "outside.xml").write_text(OUTSIDE)
    path = attaching(tmp_path, **changes)
    with pytest.raises(FileError, match=said):
        load(path)


def test_models_attached_without_end_are_refused_soon(tmp_path: Path) -> None:
    """Each attaches the next one sixteen times: a quarter of a thousand million bodies, of a few lines."""
    for k in range(8):
        inner = f'<asset><model name="m" file="m{k + 1}.xml"/></asset>' if k < 7 else ""
        body = (
            "".join(f'<attach model="m" body="b" prefix="{p}"/>' for p in range(16))
            if k < 7
            else ""
        )
        (tmp_path / f"m{k}.xml").write_text(
            f'<mujoco>{inner}<worldbody><body name="b"><joint/><geom size=".1"/>{body}</body></worldbody></mujoco>'
        )
    with pytest.raises(FileError, match="more than 500 models in all"):
        load(tmp_path / "m0.xml")


def test_models_attached_too_deep_are_said(tmp_path: Path) -> None:
    for k in range(12):
        (tmp_path / f"m{k}.xml").write_text(
            f'<mujoco><asset><model name="m" file="m{k + 1}.xml"/></asset><worldbody><body name="b"><joint/><geom size=".1"/>'
            '<attach model="m" body="b" prefix="p"/></body></worldbody></mujoco>'
        )
    with pytest.raises(FileError, match="attached more than 8 deep"):
        load(tmp_path / "m0.xml")


@pytest.mark.parametrize(
    ("turn", "said"), [("0 1.5707963 0", True), ("1.5707963 0 0", False), ("0 0 1", False)]
)
def test_a_root_that_has_no_heading_is_said(tmp_path: Path, turn: str, said: bool) -> None:
    text = robot_xml().replace('pos="0 0 .84"', f'pos="0 0 .84" euler="{turn}"', 1)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene(tmp_path, text)
    assert (
        any("the x axis of its root 'pelvis' is vertical" in str(w.message) for w in caught) is said
    )
