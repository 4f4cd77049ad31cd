"""Servos: kept where a model has them, made where it has not, as strong as the model says."""

from __future__ import annotations

import importlib.util
import warnings
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from robots import MOTORS, robot_file, robot_xml

from understudy.errors import ConfigError
from understudy.setup.plugins import installed
from understudy.task import Context
from understudy_characters.character import Character, character_spec
from understudy_characters.scene import CharacterScene
from understudy_characters.servos import (
    ServoOptions,
    drive,
    drives,
    free_inertia,
    gains,
    has_servos,
    lags,
    steadying_rotors,
    torque_limits,
)
from understudy_humanoid.character import build_spec

HUMANOID = build_spec().compile()


def scene_of(named: str | Path, **options: object) -> CharacterScene:
    return CharacterScene(CharacterScene.Options(str(named), **options))  # type: ignore[arg-type]


def test_a_models_own_servos_are_kept() -> None:
    model = scene_of("humanoid").model
    for name in ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange", "actuator_gear"):
        np.testing.assert_allclose(getattr(model, name), getattr(HUMANOID, name), atol=1e-9)
    np.testing.assert_allclose(lags(model), 0.1)


def test_motors_become_servos_as_strong_as_they_were(tmp_path: Path) -> None:
    character = Character("robot", mujoco.MjModel.from_xml_string(robot_xml()))
    assert not has_servos(character)
    model = scene_of(robot_file(tmp_path)).model
    assert model.nu == model.nv - 6
    assert has_servos(Character("robot", model))
    for joint, gear in MOTORS.items():
        for side in ("left", "right"):
            assert model.actuator(f"{side}_{joint}").forcerange.tolist() == [-gear, gear]
    assert not model.actuator_ctrllimited.any()


def test_strength_that_no_model_states_is_near_the_known_humanoids() -> None:
    spec = build_spec()
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    character = Character("humanoid", spec.compile())
    ratio = (
        torque_limits(character)
        / HUMANOID.actuator_forcerange[
            [
                HUMANOID.actuator(f"{HUMANOID.joint(j).name}{axis}").id
                for j, axis in _axes(HUMANOID)
            ],
            1,
        ]
    )
    assert (ratio < 2.5).all()
    assert (ratio > 1 / 2.5).all()


def test_gains_from_strength_are_near_the_known_humanoids() -> None:
    character = Character("humanoid", HUMANOID)
    order = [HUMANOID.actuator(f"{HUMANOID.joint(j).name}{axis}").id for j, axis in _axes(HUMANOID)]
    kp, kd = gains(character, torque_limits(character), ServoOptions())
    ratio = kp / HUMANOID.actuator_gainprm[order, 0]
    assert (ratio < 2.1).all()
    assert (ratio > 0.5).all()
    np.testing.assert_allclose(kd, 0.1 * kp)


def _axes(model: mujoco.MjModel) -> list[tuple[int, str]]:
    ball = mujoco.mjtJoint.mjJNT_BALL
    return [
        (joint, axis)
        for joint in range(1, model.njnt)
        for axis in (("_x", "_y", "_z") if model.jnt_type[joint] == ball else ("",))
    ]


def test_joint_limits_of_force_hold(tmp_path: Path) -> None:
    text = robot_xml().replace('name="left_knee"', 'name="left_knee" actuatorfrcrange="-15 15"')
    file = tmp_path / "weak.xml"
    file.write_text(text)
    assert scene_of(file).model.actuator("left_knee").forcerange[1] == 15.0
    assert scene_of(file).model.actuator("right_knee").forcerange[1] == MOTORS["knee"]


def test_unlimited_strong_and_single_motors_are_replaced(tmp_path: Path) -> None:
    """A position actuator on one joint only is no servo of all; what senses it goes with it."""
    text = robot_xml()
    start, end = text.index("<actuator>"), text.index("</actuator>")
    text = text[:start] + '<actuator><position name="p" joint="waist" kp="50"/>' + text[end:]
    text = text.replace("</mujoco>", '<sensor><actuatorpos actuator="p"/></sensor></mujoco>')
    file = tmp_path / "one.xml"
    file.write_text(text)
    model = scene_of(file).model
    assert (model.nu, model.nsensor) == (model.nv - 6, 0)


@pytest.mark.parametrize("target", [0.4, -0.3])
def test_a_servo_holds_a_hinge_on_its_target_without_overshoot(
    tmp_path: Path, target: float
) -> None:
    spec = scene_of(robot_file(tmp_path)).spec()
    spec.option.gravity = [0, 0, 0]
    model = spec.compile()
    data = mujoco.MjData(model)
    knee = model.joint("left_elbow" if target > 0 else "left_shoulder_x")
    data.ctrl[model.actuator(knee.name).id] = target
    track = []
    for _ in range(1200):
        mujoco.mj_step(model, data)
        track.append(float(data.qpos[knee.qposadr[0]]))
    assert track[-1] == pytest.approx(target, abs=0.02)
    assert max(np.sign(target) * np.array(track)) < 1.1 * abs(target)


def test_servos_keep_their_damping_at_other_time_steps() -> None:
    spec = build_spec(timestep=1 / 600)
    before = {a.name: -a.biasprm[2] for a in spec.actuators}
    drive(spec, Character("humanoid", spec.compile()), 1 / 300, ServoOptions())
    for actuator in spec.actuators:
        expected = before[actuator.name] + actuator.gainprm[0] / 600
        assert -actuator.biasprm[2] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (('axis="0 0 1"/>\n    <geom type="box" size=".08', 'type="slide"/>\n    <geom type="box" size=".08'), "the joint 'waist', along which it slides"),
        (("<freejoint/>", '<joint name="rail" type="slide" axis="1 0 0"/>'), "none of its bodies has a freejoint"),
        (('name="waist"', 'name="waist" ref="0.3"'), "reference angle .* Let ref be 0"),
    ],
)  # fmt: skip
def test_what_is_no_character_is_refused(
    tmp_path: Path, change: tuple[str, str], reason: str
) -> None:
    assert change[0] in robot_xml()
    file = tmp_path / "odd.xml"
    file.write_text(robot_xml().replace(*change))
    with pytest.raises(ConfigError, match=reason):
        scene_of(file)


def test_a_root_without_a_freejoint_is_freed(tmp_path: Path) -> None:
    """As of a model to be mounted: it stood fixed in the world, and was refused."""
    spec = mujoco.MjSpec.from_string(robot_xml())
    hinges = spec.compile().nq - 7
    key = f'<keyframe><key name="home" qpos="{" ".join(["0.1"] * hinges)}"/></keyframe></mujoco>'
    file = tmp_path / "mounted.xml"
    file.write_text(robot_xml().replace("<freejoint/>", "").replace("</mujoco>", key))
    with pytest.warns(UserWarning, match="Model 'mounted' has no freejoint"):
        model = character_spec(str(file), installed().registry)[1].compile()
    assert model.nq == 7 + hinges
    assert model.key("home").qpos[7:].tolist() == pytest.approx([0.1] * hinges)
    assert model.key("home").qpos[3:7].tolist() == [1.0, 0.0, 0.0, 0.0]


def test_a_light_limb_does_not_shake(tmp_path: Path) -> None:
    """Targets that jump by more than where a servo's torque ends, which takes away its implicit damping,
    move a hand of 50 g not much farther than where they are."""
    text = robot_xml().replace('size=".04" mass=".4"/>', 'size=".04" mass=".05"/>')
    text = text.replace('damping=".2" armature=".01"', 'armature="0"')
    text = text.replace(
        '<body name="left_hand" pos="0 0 -.25">',
        '<body name="left_hand" pos="0 0 -.25"><joint name="left_wrist" axis="1 0 0"/>',
    )
    file = tmp_path / "light.xml"
    file.write_text(text)
    model = scene_of(file).model
    data = mujoco.MjData(model)
    rng, address = np.random.default_rng(0), int(model.joint("left_wrist").qposadr[0])
    wrist, largest = model.actuator("left_wrist").id, 0.0
    for step in range(600):
        if step % 20 == 0:
            data.ctrl[wrist] = 0.2 * rng.choice([-1.0, 1.0])
        mujoco.mj_step(model, data)
        largest = max(largest, abs(data.qpos[address]))
    assert largest < 0.3


# ---------------------------------------------------------------------- at coarse time steps


def at_hertz(named: str | Path, hertz: int, speed: float | None = 10.0) -> mujoco.MjModel:
    context = Context(0, torch.device("cpu"), 1, control_dt=1 / 30, substeps=hertz // 30)
    options = CharacterScene.Options(str(named), servos=ServoOptions(step_speed=speed))
    return CharacterScene(options, context).model


def shaken(model: mujoco.MjModel, hertz: int, worlds: int = 8, decisions: int = 8) -> np.ndarray:
    """(W, nv - 6) rad: where the joints are after targets of 0.15 rad of noise, drawn 30 times a second."""
    data, found = mujoco.MjData(model), []
    for world in range(worlds):
        rng = np.random.default_rng(world)
        mujoco.mj_resetData(model, data)
        for _ in range(decisions):
            data.ctrl[:] = 0.15 * rng.normal(size=model.nu)
            mujoco.mj_step(model, data, hertz // 30)
        away = np.zeros(model.nv)
        mujoco.mj_differentiatePos(model, away, 1.0, model.qpos0, data.qpos)
        found.append(away[6:])
    return np.array(found)


@pytest.mark.parametrize("named", [*installed().registry.names("character"), "robot"])
def test_servos_track_at_any_time_step_as_they_do_at_a_fine_one(tmp_path: Path, named: str) -> None:
    """Root mean square over worlds, of the worst joint, away from where it is at 2400 Hz."""
    source = robot_file(tmp_path) if named == "robot" else named
    fine = shaken(at_hertz(source, 2400), 2400)
    for hertz in (60, 90, 150, 240, 300, 600):
        away = shaken(at_hertz(source, hertz), hertz) - fine
        assert np.sqrt((away**2).mean(axis=0)).max() < 0.15, hertz


def from_package(package: str, path: str) -> Path:
    found = importlib.util.find_spec(package)
    if found is None or not found.submodule_search_locations:
        pytest.skip(f"{package}, which has {Path(path).name}, is not installed")
    return Path(found.submodule_search_locations[0]) / path


@pytest.mark.parametrize(
    ("package", "path", "coarsest"),
    [
        ("gymnasium", "envs/mujoco/assets/humanoid.xml", 90),  # at 60 Hz: 0.16 rad
        ("mjlab", "asset_zoo/robots/unitree_g1/xmls/g1.xml", 60),
        ("mjlab", "asset_zoo/robots/unitree_go1/xmls/go1.xml", 60),
    ],
)
def test_robots_from_packages_track_as_well(package: str, path: str, coarsest: int) -> None:
    robot = from_package(package, path)
    fine = shaken(at_hertz(robot, 2400), 2400)
    for hertz in (60, 90, 150, 240, 300, 600):
        away = shaken(at_hertz(robot, hertz), hertz) - fine
        if hertz >= coarsest:
            assert np.sqrt((away**2).mean(axis=0)).max() < 0.15, hertz


def test_a_time_step_that_is_too_long_for_a_servo_is_warned_of() -> None:
    with pytest.warns(UserWarning, match=r"joint 'right_hip'.*control\.substeps.*step_speed=10"):
        at_hertz("humanoid", 150, None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        at_hertz("humanoid", 150)
        at_hertz("humanoid", 600, None)


def test_a_finer_step_tries_the_same_model() -> None:
    """Rotors are chosen for the task's step: half of it changes nothing but the step and its damping."""
    masses = []
    for substeps in (5, 10):
        context = Context(0, torch.device("cpu"), 1, control_dt=1 / 30, substeps=substeps, own_substeps=5)  # fmt: skip
        options = CharacterScene.Options("humanoid", servos=ServoOptions(step_speed=10.0))
        masses.append(CharacterScene(options, context).model.dof_armature)
    np.testing.assert_array_equal(*masses)
    assert (masses[0] > at_hertz("humanoid", 300).dof_armature + 1e-6).any()


def test_without_rotors_servos_at_their_limits_do_not_hold_at_a_coarse_step() -> None:
    fine = shaken(at_hertz("humanoid", 2400), 2400)
    away = shaken(at_hertz("humanoid", 150, None), 150) - fine
    assert np.sqrt((away**2).mean(axis=0)).max() > 0.3


@pytest.mark.parametrize("speed", [5.0, 10.0])
def test_no_servo_turns_its_joint_faster_than_stated_in_one_step(speed: float) -> None:
    """By its whole torque, alone and from rest."""
    model = at_hertz("humanoid", 150, speed)
    character = Character("humanoid", model)
    for one, inertia in zip(drives(character), free_inertia(character), strict=True):
        limits = [
            model.actuator_forcerange[a, 1]
            for a in range(model.nu)
            if model.actuator_trnid[a, 0] == one.joint and model.actuator_gear[a, one.axis] == 1
        ]
        assert limits[0] / 150 / inertia < 1.001 * speed


def test_at_their_own_time_step_servos_stay_as_they_are() -> None:
    np.testing.assert_array_equal(at_hertz("humanoid", 600).dof_armature[6:], 0.01)
    np.testing.assert_array_equal(at_hertz("humanoid", 150, None).dof_armature[6:], 0.01)


def test_what_a_rotor_lacks_by_hand() -> None:
    """A joint of 0.01 kg m^2 and 3 N m turns by 3 rad/s in 1/100 s; to turn by 2 it needs 0.015."""
    spec = mujoco.MjSpec.from_string("""<mujoco><compiler inertiagrouprange="0 5"/><worldbody>
      <body><freejoint/><inertial pos="0 0 0" mass="1e6" diaginertia="1e6 1e6 1e6"/>
      <body><joint axis="0 0 1"/><inertial pos="0 0 0" mass="1" diaginertia=".01 .01 .01"/></body></body>
      </worldbody></mujoco>""")
    character = Character("arm", spec.compile())
    assert free_inertia(character) == pytest.approx([0.01], rel=1e-6)
    for limit, lacks in ((3.0, 0.005), (1.0, 0.0), (np.inf, 0.0)):
        found = steadying_rotors(character, np.array([limit]), 0.01, 2.0)
        assert found == pytest.approx([lacks], abs=1e-8)


def with_actuators(folder: Path, actuator: str) -> CharacterScene:
    """The robot with an `actuator` of each of its hinges, HINGE in its text."""
    motors, text = [], robot_xml()
    for joint in ("waist", *(f"{side}_{name}" for side in ("left", "right") for name in MOTORS)):
        motors.append(actuator.replace("HINGE", joint))
    start, _, _ = text.partition("<actuator>")
    path = folder / "robot.xml"
    path.write_text(
        f"{start}<actuator>{''.join(motors)}</actuator></mujoco>".replace(
            '<motor ctrlrange="-1 1"/>', "", 1
        )
    )
    return scene_of(path)


def test_a_damping_ratio_is_the_damping_that_mujoco_makes_of_it(tmp_path: Path) -> None:
    servo = '<position joint="HINGE" kp="100" RATIO forcerange="-80 80"/>'
    model = with_actuators(tmp_path, servo.replace("RATIO", 'dampratio="1.5"')).model
    said = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    damping = -said.actuator_biasprm[:, 2]
    assert (damping > 1.0).all()
    by_step = 100.0 * (model.opt.timestep - said.opt.timestep)
    np.testing.assert_allclose(-model.actuator_biasprm[:, 2] - by_step, damping, rtol=1e-9)


def test_an_actuator_in_the_parents_frame_is_as_strong_as_one_of_the_joint(tmp_path: Path) -> None:
    motor = '<motor KIND="HINGE" gear="20" ctrlrange="-1.5 1.5" ctrllimited="true"/>'
    for kind in ("joint", "jointinparent"):
        limits = with_actuators(tmp_path, motor.replace("KIND", kind)).model.actuator_forcerange
        np.testing.assert_allclose(limits[:, 1], 30.0)
