"""Characters of random models: what a clip says is what MuJoCo does, both ways."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from random_characters import random_model, random_poses
from scipy.spatial.transform import Rotation
from worlds import all_plugins

from understudy.errors import ConfigError, FileError
from understudy_characters.character import Character, load_character
from understudy_characters.shapes import shapes
from understudy_motion.kinematics import forward_kinematics
from understudy_tensors import rotations


def seconds(qpos: torch.Tensor) -> torch.Tensor:
    return torch.arange(len(qpos), dtype=torch.float64)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000))
def test_qpos_becomes_a_clip_and_the_same_pose_again(seed: int) -> None:
    model = random_model(seed)
    character = Character("random", model)
    qpos = random_poses(model, seed)
    clip = character.clip(qpos, seconds(qpos), name="random")
    again = character.clip(character.qpos(clip), clip.times, name="again")
    assert torch.allclose(again.root_position, clip.root_position)
    assert rotations.angle_between(again.rotations, clip.rotations).max() < 1e-6


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000))
def test_the_clips_kinematics_are_mujocos(seed: int) -> None:
    model = random_model(seed)
    character, data = Character("random", model), mujoco.MjData(model)
    qpos = random_poses(model, seed)
    positions, world = forward_kinematics(character.clip(qpos, seconds(qpos), name="random"))
    for frame, row in enumerate(qpos.numpy()):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        for index, joint in enumerate(character.joints):
            body = joint.body
            origin = data.xpos[body] if index == 0 else data.xanchor[model.body_jntadr[body]]
            np.testing.assert_allclose(positions[frame, index], origin, atol=1e-9)
            turned = Rotation.from_quat(world[frame, index].numpy(), scalar_first=True)
            matrix = (turned * character.rest_rotations[index]).as_matrix()
            np.testing.assert_allclose(matrix, data.xmat[body].reshape(3, 3), atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_clearance_is_the_distance_to_mujocos_floor(seed: int) -> None:
    character = Character("random", random_model(seed))
    qpos = random_poses(character.model, seed)
    clearance = character.clearance(qpos)
    for frame, row in enumerate(qpos):
        data = mujoco.MjData(character.model)
        data.qpos[:] = row
        mujoco.mj_kinematics(character.model, data)
        lowest = np.full(len(character.joints), np.inf)
        for geom in character.geoms:
            distance = _above_plane(character.model, data, geom.id)
            lowest[geom.joint] = min(lowest[geom.joint], distance)
        np.testing.assert_allclose(clearance[frame], lowest, atol=1e-5)


def _above_plane(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    """The height of the geom's lowest point, as MuJoCo's collision with a plane finds it."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], margin=50)
    quaternion = Rotation.from_matrix(data.geom_xmat[geom].reshape(3, 3)).as_quat(scalar_first=True)
    body = spec.worldbody.add_body(pos=data.geom_xpos[geom], quat=quaternion)
    body.add_freejoint()
    body.add_geom(type=model.geom_type[geom], size=model.geom_size[geom])
    alone = spec.compile()
    state = mujoco.MjData(alone)
    mujoco.mj_forward(alone, state)
    return min(contact.dist for contact in state.contact)


def test_clearance_of_a_mesh() -> None:
    tetrahedron = (
        "<mujoco><asset><mesh name='m' vertex='0 0 0  1 0 0  0 1 0  0 0 1'/></asset>"
        "<worldbody><body pos='0 0 3'><freejoint/><geom type='mesh' mesh='m'/></body></worldbody></mujoco>"
    )
    character = Character("mesh", mujoco.MjModel.from_xml_string(tetrahedron))
    qpos = torch.tensor(character.model.qpos0)[None]
    assert character.clearance(qpos).item() == pytest.approx(3.0, abs=1e-6)


def test_shapes_are_where_the_geoms_are() -> None:
    character = Character("random", random_model(3))
    lowest = {shape.joint: np.inf for shape in shapes(character)}
    for shape in shapes(character):
        row = character.joint_names.index(shape.joint)
        rest = shape.vertices + character.rest_positions[row]
        lowest[shape.joint] = min(lowest[shape.joint], rest[:, 2].min())
    level = torch.tensor(character.model.qpos0)[None]
    at = character.root_address
    level[0, at : at + 7] = torch.tensor([0.0, 0, 0, 1, 0, 0, 0])
    clearance = character.clearance(level)[0]
    for name, height in lowest.items():
        assert height == pytest.approx(
            clearance[character.joint_names.index(name)].item(), abs=0.01
        )


HEAD = "<mujoco><worldbody><body name='r'>{root}<geom size='.1'/><body name='a'>{joints}<geom size='.1'/></body></body></worldbody></mujoco>"


@pytest.mark.parametrize(
    ("root", "joints", "reason"),
    [
        ("", "<joint/>", "has a freejoint"),
        (
            "<freejoint/>",
            "<joint name='j' type='slide'/>",
            "'a' has the joint 'j', along which it slides",
        ),
        ("<freejoint/>", "<joint/><joint type='ball'/>", "'a' has joints other than one ball"),
        ("<freejoint/>", "<joint/><joint/><joint/><joint/>", "more than three hinges"),
    ],
)
def test_what_is_no_character(root: str, joints: str, reason: str) -> None:
    model = mujoco.MjModel.from_xml_string(HEAD.format(root=root, joints=joints))
    with pytest.raises(ConfigError, match=reason):
        Character("odd", model)


def test_hinges_that_no_clip_can_be_mapped_on() -> None:
    joints = "<joint axis='1 0 0'/><joint axis='1 1 0'/><joint axis='0 0 1'/>"
    model = mujoco.MjModel.from_xml_string(HEAD.format(root="<freejoint/>", joints=joints))
    character = Character("odd", model)
    qpos = random_poses(model, 0)
    clip = character.clip(qpos, seconds(qpos), name="odd")
    with pytest.raises(ConfigError, match="'a' are not at right angles"):
        character.qpos(clip)


def test_two_hinges_may_be_at_any_angle() -> None:
    joints = "<joint axis='1 0 0'/><joint axis='1 1 0'/>"
    model = mujoco.MjModel.from_xml_string(HEAD.format(root="<freejoint/>", joints=joints))
    character = Character("odd", model)
    qpos = random_poses(model, 0)
    clip = character.clip(qpos, seconds(qpos), name="odd")
    again = character.clip(character.qpos(clip), clip.times, name="again")
    assert rotations.angle_between(again.rotations, clip.rotations).max() < 1e-6


def test_of_equivalent_angles_those_in_range() -> None:
    joints = "<joint axis='1 0 0' range='-90 90'/><joint axis='0 1 0' range='100 170'/><joint axis='0 0 1' range='-90 90'/>"
    model = mujoco.MjModel.from_xml_string(HEAD.format(root="<freejoint/>", joints=joints))
    character = Character("odd", model)
    qpos = random_poses(model, 1, count=50)
    clip = character.clip(qpos, seconds(qpos), name="odd")
    torch.testing.assert_close(character.qpos(clip)[:, 7:], qpos[:, 7:])


def test_a_clip_of_another_skeleton() -> None:
    one = Character("one", random_model(1))
    qpos = random_poses(one.model, 1)
    clip = one.clip(qpos, seconds(qpos), name="one")
    model = mujoco.MjModel.from_xml_string(HEAD.format(root="<freejoint/>", joints="<joint/>"))
    with pytest.raises(FileError, match=r"has no joint 'a'.*motion retarget"):
        Character("odd", model).qpos(clip)


def test_loading_by_name_and_file(tmp_path: Path) -> None:
    registry = all_plugins().registry
    assert load_character("humanoid", registry).model.nv == 34
    jumper = load_character("jumper", registry)
    assert jumper.model.body_mass.sum() == pytest.approx(60.0)
    assert jumper.joint_names == load_character("humanoid", registry).joint_names
    with pytest.raises(ConfigError, match="Did you mean 'humanoid'"):
        load_character("humanoit", registry)
    with pytest.raises(FileError, match="cannot be read"):
        load_character(str(tmp_path / "none.xml"), registry)
    broken = tmp_path / "broken.xml"
    broken.write_text(HEAD.format(root="<freejoint/>", joints="<joint/>").replace(".1", "0"))
    with pytest.raises(FileError, match="does not compile"):
        load_character(str(broken), registry)
