"""The jumper against its published figures, and that it can stand."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from understudy_humanoid.character import BODIES, STANDING_HEIGHT, build_humanoid
from understudy_humanoid.jumper import JUMPER, build_jumper


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return build_jumper().compile()


def test_it_is_the_humanoids_figure_at_60_kg(model: mujoco.MjModel) -> None:
    humanoid = build_humanoid().compile()
    assert model.body_mass.sum() == pytest.approx(60.0)
    assert (model.nq, model.nv, model.nu) == (humanoid.nq, humanoid.nv, humanoid.nu)
    np.testing.assert_allclose(model.body_pos, humanoid.body_pos)
    np.testing.assert_allclose(model.geom_size, humanoid.geom_size)
    np.testing.assert_allclose(model.body_mass[1:], humanoid.body_mass[1:] * 60 / 45)
    assert [row.name for row in JUMPER] == [row.name for row in BODIES]


@pytest.mark.parametrize(
    ("actuator", "torque"),
    [
        ("chest_x", 200), ("neck_z", 50), ("right_knee", 400), ("left_elbow", 50),
        ("left_hip_x", 500), ("left_hip_y", 500), ("left_hip_z", 50),
        ("right_ankle_x", 100), ("right_ankle_y", 300), ("right_ankle_z", 50),
        ("left_shoulder_y", 100), ("left_shoulder_z", 50),
    ],
)  # fmt: skip
def test_torque_limits(model: mujoco.MjModel, actuator: str, torque: float) -> None:
    assert model.actuator(actuator).forcerange.tolist() == [-torque, torque]


def test_a_standing_target_holds_it_upright(model: mujoco.MjModel) -> None:
    data = mujoco.MjData(model)
    for _ in range(int(1.0 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    assert data.qpos[2] > 0.95 * STANDING_HEIGHT
