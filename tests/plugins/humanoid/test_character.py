"""The humanoid model against its published figures, and that it can stand."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from understudy_humanoid.character import BODIES, STANDING_HEIGHT, add_trunk, build_spec


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return build_spec().compile()


def test_size(model: mujoco.MjModel) -> None:
    assert (model.nq, model.nv, model.nu) == (43, 34, 28)
    assert model.nbody - 1 == len(BODIES) == 15
    assert model.body_mass.sum() == pytest.approx(45.0, abs=1e-6)
    assert model.opt.timestep == pytest.approx(1 / 600)


def test_actuators_follow_the_table_with_stable_pd_gains(model: mujoco.MjModel) -> None:
    rows = [
        joint
        for row in BODIES
        for joint in row.joints
        for _ in range(3 if joint.kind == "ball" else 1)
    ]
    kp, kd = np.array([row.kp for row in rows]), np.array([row.kd for row in rows])
    np.testing.assert_allclose(model.actuator_gainprm[:, 0], kp)
    np.testing.assert_allclose(model.actuator_biasprm[:, 1], -kp)
    np.testing.assert_allclose(model.actuator_biasprm[:, 2], -(kd + kp / 600))
    np.testing.assert_allclose(model.actuator_forcerange[:, 1], [row.torque for row in rows])
    np.testing.assert_allclose(model.actuator_forcerange[:, 0], [-row.torque for row in rows])


def test_zero_pose_stands_on_the_floor_left_right_symmetric(model: mujoco.MjModel) -> None:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.qpos[2] == STANDING_HEIGHT
    for side in ("left", "right"):
        sole = data.geom(f"{side}_ankle").xpos[2] - model.geom(f"{side}_ankle").size[2]
        assert sole == pytest.approx(0.0, abs=1e-9)
    for row in BODIES:
        if row.name.startswith("left"):
            other = data.body(row.name.replace("left", "right")).xpos * [1, -1, 1]
            np.testing.assert_allclose(data.body(row.name).xpos, other)


def test_a_standing_target_holds_it_upright(model: mujoco.MjModel) -> None:
    data = mujoco.MjData(model)
    for _ in range(660):  # 1.1 s; open loop the inverted pendulum wins after a while
        mujoco.mj_step(model, data)
    assert data.qpos[2] > 0.95 * STANDING_HEIGHT
    assert np.abs(data.qvel).max() < 3.0


def test_torques_stay_within_their_limits_and_the_state_finite_under_extreme_targets(
    model: mujoco.MjModel,
) -> None:
    """Targets jump between extremes every control step of 1/30 s, for 4 s."""
    limits = np.array(
        [
            joint.torque
            for row in BODIES
            for joint in row.joints
            for _ in range(3 if joint.kind == "ball" else 1)
        ]
    )
    rng = np.random.default_rng(0)
    data, largest = mujoco.MjData(model), np.zeros(model.nu)
    for size in (np.pi, 1e6):
        mujoco.mj_resetData(model, data)
        for step in range(2400):
            if step % 20 == 0:
                data.ctrl[:] = size * rng.choice([-1.0, 1.0], model.nu)
            mujoco.mj_step(model, data)
            largest = np.maximum(largest, np.abs(data.actuator_force))
        assert np.isfinite(data.qpos).all()
        assert np.abs(data.qvel).max() < 500.0
        assert data.warning[mujoco.mjtWarning.mjWARN_BADQVEL].number == 0
        assert data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number == 0
    assert (largest <= limits + 1e-9).all()
    assert (largest > 0.99 * limits).all()


def test_a_limp_character_falls_and_rests_on_the_floor() -> None:
    model = build_spec().compile()
    model.actuator_gainprm[:] = 0.0
    model.actuator_biasprm[:] = 0.0
    model.dof_damping[6:] = 1.0
    data = mujoco.MjData(model)
    data.qvel[0] = 0.5
    for _ in range(3000):
        mujoco.mj_step(model, data)
    assert data.qpos[2] < 0.3
    assert data.geom_xpos[1:, 2].min() > 0.0
    support = sum(_contact_force(model, data, i)[0] for i in range(data.ncon))
    assert support == pytest.approx(45.0 * 9.81, rel=0.2)


def _contact_force(model: mujoco.MjModel, data: mujoco.MjData, contact: int) -> np.ndarray:
    force = np.zeros(6)
    mujoco.mj_contactForce(model, data, contact, force)
    return force


@pytest.mark.parametrize("self_collision", [False, True])
def test_links_collide_with_one_another_only_on_request(self_collision: bool) -> None:
    model = build_spec(self_collision=self_collision).compile()
    data = mujoco.MjData(model)
    data.qpos[2] = 3.0
    data.joint("right_hip").qpos = [np.cos(0.15), np.sin(0.15), 0.0, 0.0]  # into the left leg
    mujoco.mj_forward(model, data)
    assert (data.ncon > 0) == self_collision


def test_knee_flexion_takes_the_heel_back_and_elbow_flexion_the_hand_forward(
    model: mujoco.MjModel,
) -> None:
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    ankle, wrist = data.body("left_ankle").xpos.copy(), data.body("left_wrist").xpos.copy()
    data.joint("left_knee").qpos = 0.5
    data.joint("left_elbow").qpos = 0.5
    mujoco.mj_kinematics(model, data)
    assert data.body("left_ankle").xpos[0] < ankle[0] - 0.1
    assert data.body("left_wrist").xpos[0] > wrist[0] + 0.1


def test_shapes_for_pictures_weigh_nothing_and_touch_nothing(model: mujoco.MjModel) -> None:
    spec = build_spec()
    add_trunk(spec)
    dressed = spec.compile()
    assert dressed.ngeom > model.ngeom
    for name in ("body_mass", "body_inertia", "body_ipos", "body_iquat"):
        np.testing.assert_array_equal(getattr(dressed, name), getattr(model, name))
    plain, other = mujoco.MjData(model), mujoco.MjData(dressed)
    for _ in range(120):
        mujoco.mj_step(model, plain)
        mujoco.mj_step(dressed, other)
    np.testing.assert_array_equal(other.qpos, plain.qpos)
