"""Batched state of any character against MuJoCo and against finite differences."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import pytest
import torch
from random_characters import random_model, random_poses
from torch import Tensor

from understudy_characters.character import Character
from understudy_characters.layout import Layout, layout_of
from understudy_characters.reference import difference_qvel
from understudy_characters.state import Poses, character_state
from understudy_characters.surface import FAR, lowest_points, surface_of
from understudy_humanoid.character import build_spec
from understudy_tensors import rotations

WORLDS = 6
NAMES = ("qpos", "xpos", "xmat", "xipos", "cvel", "subtree_com")


@dataclass(frozen=True)
class Figure:
    """A character in random poses (N, nq), tumbling anywhere, with velocities (N, nv)."""

    character: Character
    layout: Layout
    qpos: np.ndarray
    qvel: np.ndarray

    @property
    def model(self) -> mujoco.MjModel:
        return self.character.model

    def forward(self, qpos: np.ndarray | None = None) -> dict[str, Tensor]:
        data = mujoco.MjData(self.model)
        rows: dict[str, list[np.ndarray]] = {name: [] for name in (*NAMES, "xquat")}
        for position, velocity in zip(self.qpos if qpos is None else qpos, self.qvel, strict=True):
            data.qpos[:], data.qvel[:] = position, velocity
            mujoco.mj_forward(self.model, data)
            for name, values in rows.items():
                values.append(getattr(data, name).copy())
        return {name: torch.from_numpy(np.stack(values)) for name, values in rows.items()}

    def state(self) -> dict[str, Tensor]:
        seen = self.forward()
        return character_state(self.layout, **{name: seen[name] for name in NAMES})

    def moved(self, dt: float) -> np.ndarray:
        result = self.qpos.copy()
        for row, velocity in zip(result, self.qvel, strict=True):
            mujoco.mj_integratePos(self.model, row, velocity, dt)
        return result


@pytest.fixture(scope="module", params=["humanoid", 0, 1, 2, 3, 4, 5])
def figure(request: pytest.FixtureRequest) -> Figure:
    if request.param == "humanoid":
        character, seed = Character("humanoid", build_spec().compile()), 9
    else:
        character, seed = Character("random", random_model(request.param)), request.param
    qpos = random_poses(character.model, seed, WORLDS).numpy()
    qvel = np.random.default_rng(1).normal(0.0, 3.0, (WORLDS, character.model.nv))
    return Figure(character, layout_of(character), qpos, qvel)


def test_velocities_are_the_derivatives_of_positions(figure: Figure) -> None:
    layout = figure.layout
    now = figure.state()
    step = 1e-5
    ends = [figure.forward(figure.moved(k * step)) for k in (-1.0, 1.0)]
    before, after = (
        [end[name][:, layout.link_bodies] for name in ("xpos", "xquat")] for end in ends
    )
    inverse = rotations.from_heading(-now["root_heading"])[:, None]
    linear = rotations.rotate(inverse, (after[0] - before[0]) / (2 * step))
    angular = rotations.rotate(inverse, rotations.angular_velocity(before[1], after[1], 2 * step))
    torch.testing.assert_close(now["link_linear_velocities"], linear, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(now["link_angular_velocities"], angular, atol=1e-5, rtol=1e-5)


def test_differences_of_poses_are_velocities(figure: Figure) -> None:
    step = 1e-4
    found = difference_qvel(
        figure.layout,
        figure.model.nv,
        *map(torch.from_numpy, (figure.qpos, figure.moved(step))),
        step,
    )
    torch.testing.assert_close(found, torch.from_numpy(figure.qvel), atol=1e-6, rtol=1e-6)


def test_heading_frame_ignores_place_and_heading(figure: Figure) -> None:
    turn = rotations.from_heading(torch.tensor(1.9, dtype=torch.float64))
    shift = torch.tensor([3.0, -2.0, 0.4], dtype=torch.float64)
    turned = torch.from_numpy(figure.qpos).clone()
    turned[:, :3] = rotations.rotate(turn, turned[:, :3]) + shift
    turned[:, 3:7] = rotations.multiply(turn, turned[:, 3:7])
    velocity = torch.from_numpy(figure.qvel).clone()
    velocity[:, :3] = rotations.rotate(turn, velocity[:, :3])
    elsewhere = Figure(figure.character, figure.layout, turned.numpy(), velocity.numpy())
    here = figure.state()
    there = elsewhere.state()
    for name in here:
        if name.startswith(("link_", "end_effector_", "joint_")):
            torch.testing.assert_close(there[name], here[name], atol=1e-8, rtol=1e-8)


def test_positions_and_joint_rotations_agree_with_mujoco(figure: Figure) -> None:
    layout, model, state = figure.layout, figure.model, figure.forward()
    found = figure.state()
    heading = rotations.from_heading(found["root_heading"])[:, None]
    root = found["root_position"][:, None]
    back = rotations.rotate(heading, found["link_positions"]) + root
    torch.testing.assert_close(back, state["xpos"][:, layout.link_bodies])
    ends = rotations.rotate(heading, found["end_effector_positions"]) + root
    torch.testing.assert_close(ends, state["xipos"][:, layout.effector_bodies])
    masses = torch.from_numpy(model.body_mass[1:, None])
    com = (state["xipos"][:, 1:] * masses).sum(1) / masses.sum()
    torch.testing.assert_close(found["com_position"], com)
    rest = figure.character.zero_pose.xquat
    for joint, name in enumerate(layout.joint_names):
        body = model.body(name).id
        parent = int(model.body_parentid[body])
        local, before = (
            rotations.multiply(rotations.conjugate(world[..., parent, :]), world[..., body, :])
            for world in (state["xquat"], torch.from_numpy(rest))
        )
        turned = rotations.multiply(rotations.conjugate(before), local)
        assert rotations.angle_between(found["joint_rotations"][:, joint], turned).max() < 1e-7


def test_poses_without_a_simulator_have_the_same_state(figure: Figure) -> None:
    found = Poses(figure.character, figure.layout).state(torch.from_numpy(figure.qpos))
    expected = figure.state()
    for name, value in found.items():
        if name != "link_clearances":
            torch.testing.assert_close(value, expected[name], atol=1e-9, rtol=1e-9)


def test_clearance_is_the_height_of_the_lowest_point(figure: Figure) -> None:
    layout, character = figure.layout, figure.character
    state = figure.forward()
    surface = surface_of(character, layout.link_names, layout)
    up = rotations.to_matrix(state["xquat"][:, layout.link_bodies])[..., 2, :]
    found = lowest_points(surface, state["xpos"][:, layout.link_bodies, 2], up)
    poses = Poses(character, layout).state(torch.from_numpy(figure.qpos))
    torch.testing.assert_close(found, poses["link_clearances"], atol=1e-9, rtol=1e-9)
    by_joint = character.clearance(torch.from_numpy(figure.qpos))
    for row, joint in enumerate(character.joints):
        carried = [
            link
            for link, body in enumerate(layout.link_bodies.tolist())
            if character.carrier[body] == row
        ]
        lowest = found[:, carried].amin(1)
        expected = by_joint[:, row]
        touching = expected.isfinite()
        torch.testing.assert_close(lowest[touching], expected[touching], atol=1e-9, rtol=1e-9)
        assert (lowest[~touching] > FAR / 2).all(), joint.name


def test_a_mesh_reaches_as_low_as_its_extreme_vertices() -> None:
    spec = mujoco.MjSpec()
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-2, 2) for z in (-3, 3)]) * 0.1
    spec.add_mesh(name="block", uservert=corners.flatten())
    body = spec.worldbody.add_body(name="block")
    body.add_freejoint()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="block", pos=[0.3, 0, 0])
    character = Character("block", spec.compile())
    layout = layout_of(character)
    qpos = random_poses(character.model, 3, 20)
    found = Poses(character, layout).state(qpos)["link_clearances"]
    torch.testing.assert_close(found, character.clearance(qpos), atol=1e-6, rtol=0.0)


def test_float32_in_float32_out(figure: Figure) -> None:
    seen = figure.forward()
    single = {name: seen[name].float() for name in NAMES}
    double = figure.state()
    layout = figure.layout.to(torch.device("cpu"))
    for name, value in character_state(layout, **single).items():
        assert value.dtype == torch.float32, name
        torch.testing.assert_close(value.double(), double[name], atol=5e-4, rtol=1e-3)
