"""The hand of God: how stiff it is, and that it is a stable PD controller."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch
from torch import Tensor

from understudy.task import Context
from understudy_morphology.assistance import Guidance, HelpedTorques
from understudy_morphology.figure import DAMPED, HELP, Scales, build_spec
from understudy_morphology.scene import WalkerScene

DT = 0.0165
STEP = DT / 4


def context(**more: object) -> Context:
    known = {
        "seed": 0,
        "device": torch.device("cpu"),
        "num_worlds": 2,
        "control_dt": DT,
        "substeps": 4,
    }
    return Context(**{**known, **more})  # type: ignore[arg-type]


def guided(target: float, difficulty: float, seconds: list[float]) -> dict[str, Tensor]:
    guidance = Guidance(Guidance.Options(), context(difficulty=target))
    time = torch.tensor(seconds)
    return guidance.compute(torch.full_like(time, difficulty), time)


@pytest.mark.parametrize("z", [0.0, 0.25, 0.5, 1.0])
def test_at_the_target_stiffness_is_200_less_200_z(z: float) -> None:
    """kp(z) of section 6.4.1, all through the episode."""
    found = guided(z, z, [0.0, 2.9, 3.1, 8.2])["assistance"]
    np.testing.assert_allclose(found, 200.0 - 200.0 * z)


def test_in_training_it_lessens_every_three_seconds() -> None:
    seconds = [0.0, 2.98, 182 * DT, 5.9, 6.1, 8.25]
    found = guided(1.0, 0.0, seconds)["assistance"]
    np.testing.assert_allclose(found, [200, 200, 150, 150, 112.5, 112.5])
    found = guided(0.3, 0.0, seconds)["assistance"]
    np.testing.assert_allclose(found, [200, 200, 150, 150, 140, 140], rtol=1e-6)


def test_the_target_velocity_rises_within_half_a_second() -> None:
    found = guided(1.0, 0.0, [0.0, 0.25, 0.5, 4.0])["target_velocity"]
    np.testing.assert_allclose(found, [0.0, 0.5, 1.0, 1.0])


def test_controls_are_torques_and_gains() -> None:
    scene = WalkerScene(Scales())
    options = HelpedTorques.Options(rotation=0.5)
    actuation = HelpedTorques(options, context(scene=scene))
    assert actuation.action_space.size == 15
    action = torch.linspace(-2, 2, 15).repeat(2, 1)
    given = {"assistance": torch.tensor([200.0, 0.0]), "target_velocity": torch.tensor([0.8, 1.0])}
    control = actuation.control(action, **given)
    torch.testing.assert_close(control[:, :15], action.clamp(-1, 1))
    names = [scene.model.actuator(i).name for i in range(15, scene.model.nu)]
    gains = dict(zip(names, control[0, 15:].tolist(), strict=True))
    assert gains == pytest.approx(
        {
            "push_x": 160, "damp_x": 200, "hold_y": 200,
            "hold_roll": 100, "hold_pitch": 100, "hold_yaw": 100,
        }
    )  # fmt: skip
    assert control[1, 15:].tolist() == [0.0] * 6


def floating(gains: list[float]) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The walker without gravity, off the floor and off its line, every joint between its limits."""
    spec = build_spec(Scales(), STEP)
    spec.option.gravity = [0, 0, 0]
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:3] = 3.0, 0.2, 5.0
    mujoco.mju_axisAngle2Quat(data.qpos[3:7], np.array([0.48, 0.6, 0.64]), 0.3)
    data.qpos[7:] = model.jnt_range[1:].mean(axis=1)
    data.ctrl[15:] = gains
    return model, data


def test_help_pulls_towards_the_line_the_speed_and_upright() -> None:
    model, data = floating([100.0, 200.0, 200.0, 50.0, 50.0, 50.0])
    data.qvel[:2] = 0.7, -0.1
    mujoco.mj_forward(model, data)
    along = (DAMPED + STEP) * -0.1
    turned = 0.3 * np.array([0.48, 0.6, 0.64])
    np.testing.assert_allclose(data.qfrc_actuator[:3], [100 - 140, -200 * (0.2 + along), 0])
    # torques of a free joint are about the body's own axes; a rotation's axis is the same in both
    np.testing.assert_allclose(data.qfrc_actuator[3:6], -50 * turned, atol=1e-9)


@pytest.mark.parametrize("gain", [200.0, 1e4, 1e7])
def test_help_is_the_pd_force_of_the_next_state(gain: float) -> None:
    """Stable PD (Tan et al. 2011): M (v' - v) / h + c(v) = Jᵀ f(x + h v', v') - damping v'."""
    model, data = floating([0.0, gain, gain, gain, gain, gain])
    data.qvel[:] = np.random.default_rng(0).normal(size=model.nv)
    mujoco.mj_forward(model, data)
    before, place, bias = data.qvel.copy(), data.actuator_length.copy(), data.qfrc_bias.copy()
    inertia, moment = np.zeros((model.nv, model.nv)), np.zeros((model.nu, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    mujoco.mju_sparse2dense(
        moment, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
    )
    mujoco.mj_step(model, data)
    rate = moment @ data.qvel
    holds = np.array([model.actuator(i).name.startswith("hold") for i in range(model.nu)])
    force = -data.ctrl * (holds * (place + STEP * rate) + DAMPED * rate)
    expected = moment.T @ force - model.dof_damping * data.qvel
    found = inertia @ (data.qvel - before) / STEP + bias
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-7 * gain)


@pytest.mark.parametrize("gain", [200.0, 1e4, 1e7])
def test_help_is_stable_however_stiff(gain: float) -> None:
    """It brings the walker to its line and upright without overshooting."""
    model, data = floating([gain, gain, gain, gain, gain, gain])
    for _ in range(round(8.25 / STEP)):
        mujoco.mj_step(model, data)
        assert abs(data.qpos[1]) < 0.25
    assert abs(data.qpos[1]) < 0.01
    assert data.qvel[0] == pytest.approx(1.0, abs=0.01)
    assert abs(data.qpos[3]) == pytest.approx(1.0, abs=1e-3)


def test_at_difficulty_one_nobody_helps() -> None:
    """The same state afterwards as in a model without the helpers."""
    model, data = floating([0.0] * 6)
    data.ctrl[:15] = 0.1
    spec = build_spec(Scales(), STEP)
    spec.option.gravity = [0, 0, 0]
    for name in HELP:
        spec.delete(spec.actuator(name))
    alone_model = spec.compile()
    alone = mujoco.MjData(alone_model)
    alone.qpos[:], alone.ctrl[:] = data.qpos, 0.1
    assert alone_model.nu == 15
    for _ in range(40):
        mujoco.mj_step(model, data)
        mujoco.mj_step(alone_model, alone)
    np.testing.assert_allclose(data.qpos, alone.qpos, atol=1e-12)
