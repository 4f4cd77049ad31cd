"""Distances against MuJoCo's, the barrier against its formula, gradients against differences."""

from __future__ import annotations

import math
from itertools import combinations

import mujoco
import numpy as np
import pytest
import torch

from understudy_gripping.descent import minimise
from understudy_gripping.distances import LEAST, box_distance, clamped_log
from understudy_gripping.holding import holding
from understudy_gripping.kinematics import HandKinematics, stick_ends
from understudy_gripping.pose import Candidate, PoseSolver, _Problem
from understudy_gripping.styles import NAMED, styles
from understudy_hand.scene import HandScene
from understudy_hand.table import FINGERS
from understudy_hand.tools import HALF_LENGTH, RADIUS
from understudy_tensors.segments import segment_distance


@pytest.fixture(scope="module")
def scene() -> HandScene:
    return HandScene(HandScene.Options())


def formula(z: float, limit: float) -> float:
    """Eq. 5.7."""
    return -((z - limit) ** 2) / z * math.log(z / limit)


def test_the_barrier_is_that_of_the_thesis() -> None:
    z = torch.tensor([LEAST, 1e-4, 5e-4, 9.9e-4, 1e-3, 2e-3], dtype=torch.float64)
    expected = [formula(float(value), 1e-3) for value in z[:4]] + [0.0, 0.0]
    torch.testing.assert_close(clamped_log(z, 1e-3), torch.tensor(expected, dtype=torch.float64))


def test_the_barrier_goes_on_inside_and_ever_higher() -> None:
    """Value and slope are continuous where the straight line begins."""
    z = torch.tensor([LEAST * (1 - 1e-6), LEAST * (1 + 1e-6), -1e-3, -2e-3], dtype=torch.float64)
    z.requires_grad_(True)
    value = clamped_log(z, 1e-3)
    (slope,) = torch.autograd.grad(value.sum(), z)
    torch.testing.assert_close(slope[0], slope[1], rtol=1e-4, atol=0)
    torch.testing.assert_close(value[0], value[1], rtol=1e-4, atol=0)
    assert torch.isfinite(value).all()
    assert value[3] > value[2] > value[0]


def test_links_are_where_mujoco_has_them(scene: HandScene) -> None:
    hand, model = HandKinematics(scene), scene.model
    data, generator = mujoco.MjData(model), np.random.default_rng(0)
    low, high = model.jnt_range[7:36].T
    pose = low + (high - low) * generator.random((3, 29))
    places, matrices = hand.links(torch.from_numpy(pose))
    for row in range(3):
        data.qpos[:36] = [*(0.1 * np.arange(7)), *pose[row]]
        mujoco.mj_kinematics(model, data)
        palm = data.body("palm")
        turn = palm.xmat.reshape(3, 3)
        for k, name in enumerate(hand.names):
            body = data.body(name)
            np.testing.assert_allclose(places[row, k], turn.T @ (body.xpos - palm.xpos), atol=1e-12)
            np.testing.assert_allclose(
                matrices[row, k], turn.T @ body.xmat.reshape(3, 3), atol=1e-12
            )


def test_distances_are_mujocos(scene: HandScene) -> None:
    hand, model = HandKinematics(scene), scene.model
    data, generator = mujoco.MjData(model), np.random.default_rng(1)
    low, high = model.jnt_range[7:36].T
    for _ in range(4):
        pose = low + (high - low) * generator.random(29)
        data.qpos[7:36] = pose
        mujoco.mj_kinematics(model, data)
        palm = data.body("palm")
        turn, stick = palm.xmat.reshape(3, 3), data.joint("lower_stick").qpos
        stick[:3] = palm.xpos + turn @ (0.05 * generator.normal(size=3) + [0, -0.05, 0.08])
        stick[3:] = generator.normal(size=4)
        stick[3:] /= np.linalg.norm(stick[3:])
        mujoco.mj_kinematics(model, data)
        shapes = hand.shapes(torch.from_numpy(pose)[None])
        inverse = np.zeros(4)
        local = np.zeros(4)
        mujoco.mju_negQuat(inverse, palm.xquat)
        mujoco.mju_mulQuat(local, inverse, stick[3:])
        ends = stick_ends(
            torch.from_numpy(turn.T @ (stick[:3] - palm.xpos)), torch.from_numpy(local), HALF_LENGTH
        )[None]
        gaps = segment_distance(shapes.ends[0], ends) - hand.radii - RADIUS
        boxes = box_distance(ends, shapes.boxes[0], shapes.turns[0], hand.box_sizes, 401) - RADIUS
        places = np.zeros(6)
        for names, found in ((hand.capsules, gaps), (hand.boxes, boxes)):
            for name, distance in zip(names, found.tolist(), strict=True):
                other = model.geom("lower_stick").id
                expected = mujoco.mj_geomDistance(model, data, model.geom(name).id, other, 1.0, places)  # fmt: skip
                if expected > 0:
                    assert distance == pytest.approx(expected, abs=2e-4), name


@pytest.mark.parametrize(
    "clearance", [None, 5e-4]
)  # knuckles are 1 mm apart, so the barrier is met
def test_the_gradient_of_the_cost_is_right(scene: HandScene, clearance: float | None) -> None:
    solver = PoseSolver(scene, clearance)
    chosen = [NAMED["standard"], styles(5)[0]]
    problem = _Problem(
        solver, [Candidate(style, holding("sticks").first_guess(style)) for style in chosen]
    )
    lower = [0.0355, -0.0611, 0.0910, 0.558891, 0.529425, 0.499098, 0.397808]
    problem.nominal = torch.tensor([lower, lower], dtype=torch.float64)
    generator = torch.Generator().manual_seed(0)
    noise = 0.02 * torch.randn(2, 36, generator=generator, dtype=torch.float64)
    point = torch.cat([problem.rest, torch.zeros(2, 7, dtype=torch.float64)], 1) + noise
    point.requires_grad_(True)
    value = problem.cost(point)
    (slope,) = torch.autograd.grad(value.sum(), point)
    step = 1e-7
    with torch.no_grad():
        for column in range(0, 36, 5):
            moved = torch.zeros_like(point)
            moved[:, column] = step
            difference = (problem.cost(point + moved) - problem.cost(point - moved)) / (2 * step)
            torch.testing.assert_close(slope[:, column], difference, rtol=1e-3, atol=1e-2)


def test_fingers_keep_apart_where_it_is_asked_for(scene: HandScene) -> None:
    """A style whose ring and little finger are otherwise in each other, by MuJoCo's own distances of all links of different
    fingers, but for bones of the palm."""
    places = (0.032791, 0.0038124, -0.0107753, -0.0272758, -0.0082378)
    model, nearest = scene.model, []
    for clearance in (None, 5e-4):
        found = PoseSolver(scene, clearance).solve(
            [Candidate((1, 1, 1, 1, 2), places)], 150, angles=[0.0]
        )
        data = mujoco.MjData(model)
        for name, value in zip(found.hinges, found.pose[0].tolist(), strict=True):
            data.joint(name).qpos = value
        mujoco.mj_kinematics(model, data)
        links = [f"{f}_{part}" for f in FINGERS for part in ("proximal", "middle", "distal")]
        pairs = [
            p for p in combinations(links, 2) if p[0].partition("_")[0] != p[1].partition("_")[0]
        ]
        nearest.append(
            min(mujoco.mj_geomDistance(model, data, model.geom(a).id, model.geom(b).id, 0.05, None) for a, b in pairs)
        )  # fmt: skip
        assert found.gaps[0] < 2e-3
    assert nearest[0] < -2e-3, "so there is something to keep apart"
    assert nearest[1] >= 5e-4


def test_candidates_do_not_change_one_another(scene: HandScene) -> None:
    solver = PoseSolver(scene)
    chosen = [Candidate(style, holding("sticks").first_guess(style)) for style in styles(5)[:3]]
    together, alone = solver.solve(chosen, 8), solver.solve(chosen[1:2], 8)
    torch.testing.assert_close(together.pose[1], alone.pose[0], rtol=1e-6, atol=1e-8)


def test_a_bounded_minimum_is_found() -> None:
    """Rosenbrock's valley from several starts at once, with a bound that cuts one minimum off."""

    def cost(x: torch.Tensor) -> torch.Tensor:
        return (1 - x[:, 0]) ** 2 + 100 * (x[:, 1] - x[:, 0] ** 2) ** 2

    start = torch.tensor([[-1.2, 1.0], [2.0, -1.0], [0.0, 0.0]], dtype=torch.float64)
    low, high = torch.full((3, 2), -5.0).double(), torch.full((3, 2), 5.0).double()
    high[2, 0] = 0.5
    found = minimise(cost, start, low, high, 300)
    expected = torch.tensor([[1.0, 1.0], [1.0, 1.0], [0.5, 0.25]], dtype=torch.float64)
    torch.testing.assert_close(found.points, expected, atol=1e-4, rtol=0)
