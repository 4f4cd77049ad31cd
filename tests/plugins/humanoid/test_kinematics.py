"""Batched kinematics against MuJoCo and against finite differences."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch
from torch import Tensor

from understudy import rotations
from understudy_humanoid.character import build_spec
from understudy_humanoid.kinematics import (
    CharacterLayout,
    character_layout,
    ground_clearance,
    kinematics,
)

WORLDS = 6
NAMES = ("qpos", "xpos", "xquat", "cvel", "subtree_com")


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return build_spec().compile()


@pytest.fixture(scope="module")
def layout(model: mujoco.MjModel) -> CharacterLayout:
    return character_layout(model)


@pytest.fixture(scope="module")
def states(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Random poses (N, nq), tumbling anywhere, and velocities (N, nv)."""
    rng = np.random.default_rng(1)
    qpos = np.tile(model.qpos0, (WORLDS, 1))
    for row in qpos:
        mujoco.mj_integratePos(model, row, rng.normal(0.0, 0.8, model.nv), 1.0)
    return qpos, rng.normal(0.0, 3.0, (WORLDS, model.nv))


def forward(model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray) -> dict[str, Tensor]:
    data = mujoco.MjData(model)
    rows: dict[str, list[np.ndarray]] = {name: [] for name in NAMES}
    for position, velocity in zip(qpos, qvel, strict=True):
        data.qpos[:], data.qvel[:] = position, velocity
        mujoco.mj_forward(model, data)
        for name in NAMES:
            rows[name].append(getattr(data, name).copy())
    return {name: torch.from_numpy(np.stack(values)) for name, values in rows.items()}


def moved(model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray, dt: float) -> np.ndarray:
    result = qpos.copy()
    for row, velocity in zip(result, qvel, strict=True):
        mujoco.mj_integratePos(model, row, velocity, dt)
    return result


def test_velocities_are_the_derivatives_of_positions(
    model: mujoco.MjModel, layout: CharacterLayout, states: tuple[np.ndarray, np.ndarray]
) -> None:
    qpos, qvel = states
    now = kinematics(layout, **forward(model, qpos, qvel))
    step = 1e-5
    ends = [forward(model, moved(model, qpos, qvel, k * step), qvel) for k in (-1.0, 1.0)]
    before, after = (
        [end[name][:, layout.link_bodies] for name in ("xpos", "xquat")] for end in ends
    )
    inverse = rotations.from_heading(-now["root_heading"])[:, None]
    linear = rotations.rotate(inverse, (after[0] - before[0]) / (2 * step))
    angular = rotations.rotate(inverse, rotations.angular_velocity(before[1], after[1], 2 * step))
    torch.testing.assert_close(now["link_linear_velocities"], linear, atol=1e-6, rtol=1e-6)
    torch.testing.assert_close(now["link_angular_velocities"], angular, atol=1e-6, rtol=1e-6)


def test_heading_frame_ignores_place_and_heading(
    model: mujoco.MjModel, layout: CharacterLayout, states: tuple[np.ndarray, np.ndarray]
) -> None:
    qpos, qvel = states
    turn = rotations.from_heading(torch.tensor(1.9, dtype=torch.float64))
    turned, velocity = torch.from_numpy(qpos).clone(), torch.from_numpy(qvel).clone()
    shift = torch.tensor([3.0, -2.0, 0.4], dtype=torch.float64)
    turned[:, :3] = rotations.rotate(turn, turned[:, :3]) + shift
    turned[:, 3:7] = rotations.multiply(turn, turned[:, 3:7])
    velocity[:, :3] = rotations.rotate(turn, velocity[:, :3])
    here = kinematics(layout, **forward(model, qpos, qvel))
    there = kinematics(layout, **forward(model, turned.numpy(), velocity.numpy()))
    for name in here:
        if name.startswith(("link_", "end_effector_", "joint_")):
            torch.testing.assert_close(there[name], here[name], atol=1e-9, rtol=1e-9)


def test_positions_and_joint_rotations_agree_with_mujoco(
    model: mujoco.MjModel, layout: CharacterLayout, states: tuple[np.ndarray, np.ndarray]
) -> None:
    state = forward(model, *states)
    found = kinematics(layout, **state)
    heading = rotations.from_heading(found["root_heading"])[:, None]
    back = rotations.rotate(heading, found["link_positions"]) + found["root_position"][:, None]
    torch.testing.assert_close(back, state["xpos"][:, layout.link_bodies])
    torch.testing.assert_close(found["com_position"], state["subtree_com"][:, 0])
    for joint, name in enumerate(layout.joint_names):
        body = model.body(name).id
        parent = int(model.body_parentid[body])
        local = rotations.multiply(
            rotations.conjugate(state["xquat"][:, parent]), state["xquat"][:, body]
        )
        assert rotations.angle_between(found["joint_rotations"][:, joint], local).max() < 1e-9
    links = [layout.link_names.index(name) for name in layout.end_effectors]
    assert torch.equal(found["end_effector_positions"], found["link_positions"][:, links])


def test_ground_clearance_is_the_lowest_point(
    model: mujoco.MjModel, layout: CharacterLayout, states: tuple[np.ndarray, np.ndarray]
) -> None:
    qpos = states[0].copy()
    qpos[:, 2] += 5.0
    state = forward(model, qpos, states[1])
    clearance = ground_clearance(layout, state["xpos"], state["xquat"])
    data, floor = mujoco.MjData(model), model.geom("floor").id
    for world in range(WORLDS):
        data.qpos[:] = qpos[world]
        mujoco.mj_forward(model, data)
        for link, name in enumerate(layout.link_names):
            exact = mujoco.mj_geomDistance(
                model, data, floor, model.geom(name).id, 99.0, np.zeros(6)
            )
            assert clearance[world, link].item() == pytest.approx(exact, abs=1e-6)


def test_float32_in_float32_out(
    model: mujoco.MjModel, layout: CharacterLayout, states: tuple[np.ndarray, np.ndarray]
) -> None:
    state = forward(model, *states)
    single = {name: value.float() for name, value in state.items()}
    double = kinematics(layout, **state)
    for name, value in kinematics(layout, **single).items():
        assert value.dtype == torch.float32, name
        torch.testing.assert_close(value.double(), double[name], atol=2e-4, rtol=1e-4)
