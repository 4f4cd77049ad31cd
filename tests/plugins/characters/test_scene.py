"""Any character as a scene: floor, contacts, limbs, drawing."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from robots import robot_file, robot_xml

from understudy.errors import ConfigError, UnderstudyError
from understudy_characters.layout import Layout
from understudy_characters.scene import CharacterScene


def scene_of(named: str | Path, **options: object) -> CharacterScene:
    return CharacterScene(CharacterScene.Options(str(named), **options))  # type: ignore[arg-type]


def layout(named: str | Path, **options: object) -> Layout:
    return scene_of(named, **options).layout


def test_hands_feet_and_trunk_of_the_humanoid_are_found() -> None:
    found = layout("humanoid")
    assert set(found.end_effectors) == {
        "left_wrist", "right_wrist", "left_ankle", "right_ankle",
    }  # fmt: skip
    assert found.upright == ("root", "chest", "neck")


def test_hands_feet_and_trunk_of_a_robot_are_found(tmp_path: Path) -> None:
    found = layout(robot_file(tmp_path))
    assert set(found.end_effectors) == {"left_hand", "right_hand", "left_foot", "right_foot"}
    assert found.upright == ("pelvis", "chest", "head")
    assert len(found.joint_names) == 11


def test_end_effectors_can_be_chosen(tmp_path: Path) -> None:
    file = robot_file(tmp_path)
    chosen = layout(file, end_effectors=("head", "left_foot"))
    assert chosen.end_effectors == ("head", "left_foot")
    assert chosen.upright == ("pelvis", "chest", "head")  # of that the limbs decide
    with pytest.raises(ConfigError, match=r"no body 'left_fot'\. Did you mean 'left_foot'"):
        layout(file, end_effectors=("left_fot",))


def test_a_model_without_floor_and_light_gets_them(tmp_path: Path) -> None:
    scene = scene_of(robot_file(tmp_path))
    assert mujoco.MjModel.from_xml_string(robot_xml()).ngeom == scene.model.ngeom - 1
    shown = scene.shown().compile()
    assert shown.nlight == 1
    data = mujoco.MjData(scene.model)
    for _ in range(1200):
        mujoco.mj_step(scene.model, data)
    assert 0.0 < data.qpos[2] < 1.0
    assert np.isfinite(data.qpos).all()


def test_physics_has_no_shapes_for_pictures() -> None:
    scene = scene_of("humanoid")
    assert scene.model.ngeom == 16
    assert scene.shown().compile().ngeom > 16


@pytest.mark.parametrize("self_collision", [False, True])
def test_limbs_collide_with_one_another_only_on_request(
    tmp_path: Path, self_collision: bool
) -> None:
    model = scene_of(robot_file(tmp_path), self_collision=self_collision).model
    data = mujoco.MjData(model)
    data.qpos[2] = 3.0
    data.joint("right_hip_x").qpos = 0.4  # into the left leg
    mujoco.mj_forward(model, data)
    assert (data.ncon > 0) == self_collision
    data.qpos[2] = 0.83
    data.joint("right_hip_x").qpos = 0.0
    mujoco.mj_forward(model, data)
    assert data.ncon > 0  # the floor


def test_a_figure_whose_geoms_do_not_collide_still_stands_on_the_floor(tmp_path: Path) -> None:
    file = tmp_path / "ghost.xml"
    file.write_text(
        robot_xml().replace("<motor ctrl", '<geom contype="0" conaffinity="0"/><motor ctrl')
    )
    model = scene_of(file).model
    data = mujoco.MjData(model)
    data.qpos[2] = 0.83
    mujoco.mj_forward(model, data)
    assert data.ncon > 0


def test_the_solver_is_the_models_on_request(tmp_path: Path) -> None:
    file = tmp_path / "slow.xml"
    file.write_text(robot_xml().replace("<default>", '<option iterations="77"/><default>'))
    assert scene_of(file).model.opt.iterations == 6
    assert scene_of(file, solver="model").model.opt.iterations == 77


def test_frames_are_drawn_with_and_without_reference(tmp_path: Path) -> None:
    scene = scene_of(robot_file(tmp_path))
    track = np.repeat(scene.model.qpos0[None], 2, axis=0)
    try:
        without = list(scene.draw({"qpos": track}, 160, 90))
        both = list(scene.draw({"qpos": track, "reference_qpos": track}, 160, 90))
    except UnderstudyError as error:
        pytest.skip(str(error))
    assert without[0].shape == both[0].shape == (90, 160, 3)
    assert len(both) == 2
    assert not np.array_equal(without[0], both[0])


def test_outlines_join_each_link_to_its_parent_and_have_a_head(tmp_path: Path) -> None:
    scene = scene_of(robot_file(tmp_path))
    track = np.repeat(scene.model.qpos0[None], 3, axis=0)
    sticks, none = scene.outlines({"qpos": track})
    assert none is None
    assert sticks is not None
    bones = len(scene.layout.link_names) - 1
    assert (len(sticks), *sticks.shape[2:]) == (3, 2, 3)
    assert sticks.shape[1] > bones
    ring = sticks[0, bones:]
    np.testing.assert_allclose(ring[:, 1], np.roll(ring[:, 0], -1, axis=0), atol=1e-9)  # closed
    assert ring[..., 2].max() > sticks[0, :bones, ..., 2].max()


def test_gains_are_among_the_facts() -> None:
    """Of the humanoid, the released DeepMimic character's."""
    servos = scene_of("humanoid").describe()["servos"]
    assert (
        servos["kp 1000 N m/rad, kd 100 N m s/rad, at most 200 N m"] == "chest_x, chest_y, chest_z"
    )
    assert sum(len(names.split(", ")) for names in servos.values()) == 28
