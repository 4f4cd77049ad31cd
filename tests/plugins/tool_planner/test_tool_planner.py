"""The planner, part by part against MuJoCo and finite differences; whole plans; what is refused."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np
import pytest
import torch

from understudy.errors import ConfigError
from understudy_gripping.grip import load_grip, standard, tongs, tongs_wide
from understudy_hand.scene import HandScene
from understudy_hand.table import ARM_POSE
from understudy_hand.tools import BAR, GRIPPERS, HALF_LENGTH, RADIUS, Thing, Tool, upper_pose
from understudy_tensors import rotations
from understudy_tool_planner import arm, trajectory
from understudy_tool_planner.clearance import to_points, to_segments
from understudy_tool_planner.configuration import NoPlan, choose, orientations
from understudy_tool_planner.gripper import Jaws, normal, width
from understudy_tool_planner.objects import Shape, Things
from understudy_tool_planner.planner import DT, STEP, Plan, Planner, Task
from understudy_tool_planner.tasks import random_goal, random_table
from understudy_tool_planner.throwing import GRAVITY, STOP, SWING, throw

F64 = torch.float64
SHAPES = [
    Shape("sphere", (0.008,)),
    Shape("capsule", (0.006, 0.03)),
    Shape("box", (0.012, 0.02, 0.015)),
]
STICKS = Jaws("sticks")


@pytest.fixture(scope="module")
def planner() -> Planner:
    return Planner(load_grip(standard()), HandScene(HandScene.Options()))


@pytest.fixture(scope="module")
def planned(planner: Planner) -> list[tuple[Task, Things, Plan]]:
    """Eight objects that are moved one after the other, each plan from where the last one ended."""
    generator, now, found = torch.Generator().manual_seed(7), planner.begin(), []
    table = random_table(generator)
    for one in range(8):
        task = table.task(one, random_goal(table, one, generator))
        others = table.without(one)
        plan = planner.plan(task, now, others)
        found.append((task, others, plan))
        table, now = table.moved(one, task.goal), plan.end
    return found


# ------------------------------------------------------------------ parts


def test_the_arm_is_mujocos_and_its_inverse_finds_it_again() -> None:
    model = HandScene(HandScene.Options()).model
    data, generator = mujoco.MjData(model), np.random.default_rng(0)
    low, high = np.array(arm.RANGES).T
    for _ in range(20):
        data.qpos[:7] = generator.uniform(low, high)
        mujoco.mj_kinematics(model, data)
        pose = torch.tensor(data.qpos[:7])
        palm, turn = arm.forward(pose)
        np.testing.assert_allclose(palm, data.body("palm").xpos, atol=1e-9)
        np.testing.assert_allclose(turn.ravel(), data.body("palm").xmat, atol=1e-9)
        found = arm.solve(palm, turn, arm.swivel_of(pose))
        torch.testing.assert_close(found.pose, pose, atol=1e-6, rtol=0)
        assert float(found.inside) >= -1e-6


def test_every_swivel_is_a_solution_and_beyond_reach_there_is_none() -> None:
    palm, turn = arm.forward(torch.tensor(ARM_POSE, dtype=F64))
    swivel = torch.linspace(-3.0, 3.0, 13, dtype=F64)
    found = arm.solve(palm.expand(13, 3), turn.expand(13, 3, 3), swivel)
    again, turned = arm.forward(found.pose)
    torch.testing.assert_close(again, palm.expand(13, 3))
    torch.testing.assert_close(turned, turn.expand(13, 3, 3))
    away = arm.solve(palm + torch.tensor([0.0, 0.7, 0.0], dtype=F64), turn, swivel[0])
    assert float(away.inside) == -math.inf


@pytest.mark.parametrize(
    ("tool", "angles", "tip"),
    [("sticks", (0.0, 0.03, 0.08, 0.15), 0.13), ("tongs", (0.0, 0.06, 0.12, 0.16), 0.126)],
)
def test_the_gripper_is_the_tools(tool: Tool, angles: tuple[float, ...], tip: float) -> None:
    """Tips as `upper_pose` has them, in any place; and the angle for a gap is the one that has it."""
    jaws, angle = Jaws(tool), torch.tensor(angles, dtype=F64)
    turn = rotations.normalize(
        torch.randn(4, 4, generator=torch.Generator().manual_seed(0), dtype=F64)
    )
    place, matrix = torch.rand(4, 3, dtype=F64), rotations.to_matrix(turn)
    upper, turned = upper_pose(place, turn, angle, GRIPPERS[tool])
    rods = jaws.rods(place, matrix, angle)
    count = rods.middles.shape[-2] // 2
    middles, axes = rods.middles[:, count // 2 :: count], rods.axes[:, ::count]
    torch.testing.assert_close(middles, torch.stack([upper, place], 1))
    torch.testing.assert_close(axes[:, 0], rotations.to_matrix(turned)[..., 0])
    ends = middles - tip * axes
    centre, across = jaws.tips(angle)
    torch.testing.assert_close(ends.mean(1), place + torch.einsum("nij,nj->ni", matrix, centre))
    gaps = (ends[:, 0] - ends[:, 1]).square().sum(-1).sqrt()
    torch.testing.assert_close(across.square().sum(-1).sqrt(), gaps)
    torch.testing.assert_close(jaws.angle_of(gaps), angle, atol=1e-7, rtol=0)


def test_rods_cover_the_bars_of_tongs() -> None:
    """Every point of both bars is in a rod, and the lowest of their corners is as low as they are said to reach."""
    turn = rotations.normalize(
        torch.randn(6, 4, generator=torch.Generator().manual_seed(2), dtype=F64)
    )
    place, angle = torch.rand(6, 3, dtype=F64), torch.linspace(0.0, 0.16, 6, dtype=F64)
    rods = Jaws("tongs").rods(place, rotations.to_matrix(turn), angle)
    grid = torch.cartesian_prod(*(torch.linspace(-h, h, 5, dtype=F64) for h in BAR))
    bars = [upper_pose(place, turn, angle, GRIPPERS["tongs"]), (place, turn)]
    for part, (middle, turned) in enumerate(bars):
        points = middle[:, None] + grid @ rotations.to_matrix(turned).mT
        torch.testing.assert_close(points[..., 2].amin(1), rods.low[:, part])
        away = points[:, :, None] - rods.middles[:, None]
        along = (away * rods.axes[:, None]).sum(-1).clamp(-HALF_LENGTH, HALF_LENGTH)
        beside = (away - along[..., None] * rods.axes[:, None]).square().sum(-1).sqrt()
        assert float(beside.amin(-1).max()) <= rods.radius + 1e-9


@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: s.kind)
def test_widths_are_those_that_a_ray_measures(shape: Shape) -> None:
    ways = torch.nn.functional.normalize(
        torch.randn(60, 3, generator=torch.Generator().manual_seed(1), dtype=F64), dim=-1
    )
    things = Things.of([shape], torch.zeros(1, 2, dtype=F64), torch.zeros(1, dtype=F64))
    middle = things.places[0]
    half = 0.5 * width(shape, ways)
    on = to_points((middle + half[:, None] * ways)[:, None], things)
    assert float(on.abs().max()) < 1e-7


@pytest.mark.parametrize("shape", [*SHAPES, Shape("capsule", (0.005, 0.02))], ids=repr)
def test_normals_are_the_slope_of_the_distance(shape: Shape) -> None:
    """Out of the round ends of a capsule, too, of which a short one is taken."""
    ways = torch.nn.functional.normalize(
        torch.randn(200, 3, generator=torch.Generator().manual_seed(1), dtype=F64), dim=-1
    )
    ways = torch.cat([ways, torch.eye(3, dtype=F64)])
    things = Things.of([shape], torch.zeros(1, 2, dtype=F64), torch.zeros(1, dtype=F64))
    out = (0.5 * width(shape, ways) + 1e-6)[:, None] * ways
    point = (things.places[0] + out).requires_grad_()
    (slope,) = torch.autograd.grad(to_points(point[:, None], things).sum(), point)
    torch.testing.assert_close(normal(shape, ways), (slope * ways).sum(-1), atol=2e-3, rtol=0)


def test_distances_are_mujocos() -> None:
    """Of sticks from each kind of object, in touch too."""
    generator = torch.Generator().manual_seed(0)
    things = Things.of(
        SHAPES,
        0.1 * torch.rand(3, 2, dtype=F64, generator=generator),
        torch.rand(3, dtype=F64, generator=generator),
    )
    spec = mujoco.MjSpec()
    kinds = {"sphere": mujoco.mjtGeom.mjGEOM_SPHERE, "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
             "box": mujoco.mjtGeom.mjGEOM_BOX}  # fmt: skip
    for k, shape in enumerate(SHAPES):
        a, b, c = shape.half_sizes
        size = [a, b, c] if shape.kind == "box" else [shape.rounding, a, 0]
        turn = things.turns[k] @ (torch.tensor([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]]).double()
                                  if shape.kind == "capsule" else torch.eye(3).double())  # fmt: skip
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, turn.numpy().ravel())
        spec.worldbody.add_geom(
            type=kinds[shape.kind], size=size, pos=things.places[k].numpy(), quat=quat
        )
    body = spec.worldbody.add_body()
    body.add_freejoint()
    body.add_geom(type=kinds["capsule"], size=[RADIUS, HALF_LENGTH, 0])
    model = spec.compile()
    data = mujoco.MjData(model)
    turns = rotations.normalize(torch.randn(60, 4, dtype=F64, generator=generator))
    middles = 0.15 * torch.rand(60, 3, dtype=F64, generator=generator)
    axes = rotations.to_matrix(turns)[..., 2]
    found = to_segments(middles, axes, things, 24) - RADIUS
    for row in range(60):
        data.qpos[:3], data.qpos[3:] = middles[row], turns[row]
        mujoco.mj_kinematics(model, data)
        for k in range(3):
            exact = mujoco.mj_geomDistance(model, data, k, 3, 1.0, None)
            if exact > 0:
                assert float(found[row, k]) == pytest.approx(exact, abs=2e-6)
            else:
                assert float(found[row, k]) < 1e-6


@pytest.mark.parametrize("tool", ["sticks", "tongs"])
def test_the_gradient_of_equation_5_8_is_its_derivative(planner: Planner, tool: Tool) -> None:
    others = random_table(torch.Generator().manual_seed(3)).without(0)
    now = planner.begin()
    end = trajectory.Pose(
        now.lower[:3] + torch.tensor([0.05, 0.02, -0.08]), now.lower[3:], now.angle + 0.05
    )
    start = trajectory.Pose(now.lower[:3], now.lower[3:], now.angle)
    ways = [
        trajectory.Way(Jaws(tool), start, end, others),
        trajectory.Way(Jaws(tool), start, end, others, 0.01),
    ]
    cost = trajectory._Cost(ways, torch.linspace(0.0, 1.0, 20, dtype=F64))
    point = torch.stack([trajectory._first(way) for way in ways]).flatten(1)
    point = point - torch.tensor([0.0, 0.0, 0.09] * 2, dtype=F64)  # through table and objects
    value, slope = cost.both(point)
    assert float(value.min()) > 1.0
    step = 1e-6 * torch.eye(6, dtype=F64)
    numeric = torch.stack(
        [(cost.both(point + e)[0] - cost.both(point - e)[0]) / 2e-6 for e in step], 1
    )
    torch.testing.assert_close(slope, numeric, rtol=1e-5, atol=1e-4)


def test_there_are_two_thousand_orientations() -> None:
    found = orientations()
    assert found.shape == (2000, 4)
    apart = rotations.angle_between(found[:, None], found[None])
    apart.fill_diagonal_(1.0)
    assert float(apart.min()) > 0.02
    assert float(rotations.to_matrix(found)[:, 2, 0].min()) > 0.4  # the tip is down


# ------------------------------------------------------------------ plans


def test_nothing_is_touched_on_the_way(planned: list[tuple[Task, Things, Plan]]) -> None:
    """The sticks, frame by frame, from the table and everything that stays, by another computation: points along
    them."""
    along = torch.linspace(-HALF_LENGTH, HALF_LENGTH, 261, dtype=F64)
    for _, others, plan in planned:
        assert plan.clearance >= 0.0
        matrix = rotations.to_matrix(plan.lower[:, 3:])
        rods = STICKS.rods(plan.lower[:, :3], matrix, plan.angle)
        points = rods.middles[..., None, :] + along[:, None] * rods.axes[..., None, :]
        assert float(points[..., 2].min()) - RADIUS >= 0.0
        away = to_points(points[..., None, :], others).amin() - RADIUS
        assert float(away) >= 0.0


def test_what_is_chosen_can_be_let_go_among_others(planner: Planner) -> None:
    """The upper stick opens wholly while the lower one stays: neither comes into the objects beside the goal."""
    generator = torch.Generator().manual_seed(9)
    shares = torch.linspace(0.0, 1.0, 16, dtype=F64)
    for _ in range(3):
        table = random_table(generator)
        for one in range(8):
            task, others = table.task(one, random_goal(table, one, generator)), table.without(one)
            heading, height = torch.tensor(task.heading, dtype=F64), task.shape.height
            start, goal = (torch.tensor((*p, height), dtype=F64) for p in (task.start, task.goal))
            now = planner.begin().lower[3:]
            found = choose(task.shape, start, heading, goal, heading, now, others, planner._holder)
            way = planner._release(found.end[0], found.closed[0], goal, shares)
            assert float(trajectory.clearance(STICKS, way, others).amin()) >= 0.0


def test_the_object_is_taken_where_it_is_and_put_where_it_shall(
    planned: list[tuple[Task, Things, Plan]],
) -> None:
    for task, _, plan in planned:
        assert plan.object[0, :2].tolist() == pytest.approx(task.start)
        assert plan.object[-1, :2].tolist() == pytest.approx(task.goal)
        step = plan.object[1:, :3] - plan.object[:-1, :3]
        assert float(step.square().sum(1).sqrt().max()) < 0.02
        taking = int((plan.phase == 1).nonzero()[-1])  # closed
        matrix = rotations.to_matrix(plan.lower[taking, 3:])
        centre, across = STICKS.tips(plan.angle[taking])
        middle = plan.lower[taking, :3] + matrix @ centre
        assert middle[:2].tolist() == pytest.approx(task.start, abs=1e-9)
        way = (
            rotations.to_matrix(rotations.from_heading(torch.tensor(task.heading, dtype=F64))).T
            @ matrix
            @ across
        )
        gap = float(way.square().sum().sqrt())
        wide = float(width(task.shape, way / gap))
        assert gap == pytest.approx(wide + 2.0 * RADIUS, abs=2e-4)


def test_the_arm_follows_and_goes_on_where_it_was(
    planner: Planner, planned: list[tuple[Task, Things, Plan]]
) -> None:
    before = planner.begin()
    low, high = torch.tensor(arm.RANGES, dtype=F64).T
    for _, _, plan in planned:
        palm, turn = arm.forward(plan.arm)
        wanted, turned = planner._holder.palm(
            plan.lower[:, :3], rotations.to_matrix(plan.lower[:, 3:])
        )
        torch.testing.assert_close(palm, wanted, atol=1e-7, rtol=0)
        torch.testing.assert_close(turn, turned, atol=1e-7, rtol=0)
        assert ((plan.arm >= low) & (plan.arm <= high)).all()
        steps = torch.diff(torch.cat([before.arm[None], plan.arm]), dim=0)
        assert float(steps.abs().max()) <= STEP
        torch.testing.assert_close(plan.lower[0, :3], before.lower[:3], atol=0.005, rtol=0)
        assert plan.phase.diff().min() >= 0
        assert plan.seconds == pytest.approx(DT * len(plan.arm))
        before = plan.end


# ------------------------------------------------------------------ what is refused


NOTHING = Things.of([], torch.zeros(0, 2, dtype=F64), torch.zeros(0, dtype=F64))


def test_sticks_that_come_from_elsewhere_go_over_the_object_first(planner: Planner) -> None:
    """Then they come straight down, and take longer; where they are at the object already, both make no difference but the time."""
    grip, scene = load_grip(standard()), HandScene(HandScene.Options())
    careful = Planner(grip, scene, over=0.03, slowly=1.6)
    sphere = Shape("sphere", (0.01,))
    alone = Things.of([], torch.zeros(0, 2), torch.zeros(0))
    task = Task(sphere, (0.05, -0.05), (-0.05, 0.05))
    lengths, sideways = [], []
    for one in (planner, careful):
        plan = one.plan(task, one.begin(), alone)
        approach = plan.lower[plan.phase == 0, :3]
        lengths.append(len(approach))
        near = approach[(approach[:, 2] - approach[-1, 2]) < 0.029]
        sideways.append(float((near - approach[-1])[:, :2].norm(dim=1).max()))
        assert plan.clearance >= 0.0
        assert plan.arm.diff(dim=0).abs().max() < STEP
    assert lengths[1] >= 1.5 * lengths[0]
    assert sideways[1] < 0.006 < sideways[0]
    back = Task(sphere, task.goal, task.start)
    there = [one.plan(back, one.plan(task, one.begin(), alone).end, alone) for one in (planner, careful)]  # fmt: skip
    counts = [int((plan.phase == 0).sum()) for plan in there]
    assert counts[1] == pytest.approx(1.6 * counts[0], abs=2)


@pytest.mark.parametrize(
    ("task", "said"),
    [
        ({"goal": (0.0, 0.6)}, "in the phase 'reaching'"),
        (
            {"goal": (-0.05, 0.0), "beside": (-0.05, 0.0)},
            "in the phase 'releasing' other objects",
        ),
        ({"goal": (-0.05, 0.0), "beside": (0.05, -0.04)}, "in the phase 'taking' other objects"),
    ],
)
def test_a_goal_that_no_plan_reaches(planner: Planner, task: dict[str, Any], said: str) -> None:
    others = NOTHING
    if "beside" in task:
        box = Shape("box", (0.02, 0.02, 0.02))
        around = torch.tensor([task["beside"]], dtype=F64) + 0.012 * torch.tensor(
            [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]], dtype=F64
        )
        others = Things.of([box] * 4, around, torch.zeros(4, dtype=F64))
    with pytest.raises(NoPlan) as error:
        planner.plan(
            Task(Shape("sphere", (0.008,)), (0.05, -0.04), task["goal"]), planner.begin(), others
        )
    assert said in str(error.value)
    assert " mm " in str(error.value) or " rad" in str(error.value)
    assert error.value.exit_status == 2


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"goal": (0.29, 0.0)}, r"its goal at \(0.29, 0\) m is 30.0 mm beside the table"),
        ({"start": (0.28, 0.0)}, r"the object at \(0.28, 0\) m is 20.0 mm beside the table"),
        ({"goal": (0.0, 0.4), "thrown": True}, "85.0 mm beside the table"),
        ({"goal": (math.nan, 0.0)}, "no finite number"),
        ({"start": (0.0, math.inf)}, "no finite number"),
        ({"heading": math.nan}, "no finite number"),
        ({"upon": math.nan}, "no finite number"),
    ],
)
def test_what_is_not_on_the_table_is_not_planned_for(
    planner: Planner, given: dict[str, Any], said: str
) -> None:
    """The arm reaches beyond its edge, where an object falls."""
    words: dict[str, Any] = {"start": (0.05, -0.04), "goal": (-0.05, 0.0), **given}
    with pytest.raises(NoPlan, match=said):
        planner.plan(Task(Shape("sphere", (0.01,)), **words), planner.begin(), NOTHING)


def test_the_tables_edge_is_on_it(planner: Planner) -> None:
    plan = planner.plan(Task(Shape("sphere", (0.01,)), (0.05, -0.04), (0.255, 0.0)), planner.begin(), NOTHING)  # fmt: skip
    assert plan.object[-1, :3].tolist() == pytest.approx([0.255, 0.0, 0.01])


@pytest.mark.parametrize(
    ("kind", "sizes", "said"),
    [
        ("sphere", (0.03,), "radius of 3 cm is none of table 5.2, where it is from 0.5 to 1 cm"),
        ("capsule", (0.006, 0.05), "length of 5 cm"),
        ("box", (0.01, 0.01, 0.004), "height of 0.4 cm"),
        ("box", (0.01,), "A box has 3 sizes"),
        ("cone", (0.01,), "there are sphere, capsule, box"),
    ],
)
def test_an_object_outside_table_5_2(kind: Any, sizes: tuple[float, ...], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        Shape(kind, sizes)


def test_another_hands_grip() -> None:
    with pytest.raises(ConfigError, match="is one of a hand with 5 fingers"):
        Planner(load_grip(standard()), HandScene(HandScene.Options(fingers=3)))


def test_the_next_configuration_is_tried_when_one_fails(
    planner: Planner, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the same error beside the object."""
    complete, tried = Planner._complete, []

    def once(self: Planner, *args: Any) -> Plan:
        tried.append(args[-1])
        if len(tried) == 1:
            raise NoPlan("No plan reaches the goal: the first one does not.")
        return complete(self, *args)

    monkeypatch.setattr(Planner, "_complete", once)
    task, error = Task(SHAPES[0], (0.0, -0.04), (0.05, -0.02)), torch.tensor([0.003, 0.0, 0.0])
    nothing = Things.of([], torch.zeros(0, 2).double(), torch.zeros(0).double())
    planner.plan(task, planner.begin(), nothing, error.double())
    assert len(tried) >= 2
    assert all(given is tried[0] for given in tried)


# ------------------------------------------------------------------ throws, and two at once

NOTHING = Things.of([], torch.zeros(0, 2, dtype=F64), torch.zeros(0, dtype=F64))


def test_a_throw_lands_where_it_shall() -> None:
    """The swing has the flight's velocity as it lets go, and the flight falls freely to the goal."""
    goal = torch.tensor([0.05, 0.28, 0.02], dtype=F64)
    thrown = throw(torch.tensor([-0.1, -0.1, 0.01], dtype=F64), goal)
    dt = 1e-4
    before, release = thrown.swing(torch.tensor([SWING - dt, SWING], dtype=F64))
    torch.testing.assert_close(release, thrown.release)
    torch.testing.assert_close((release - before) / dt, thrown.velocity, atol=1e-3, rtol=0)
    late = thrown.swing(torch.tensor([SWING + STOP, SWING + 2 * STOP], dtype=F64))
    torch.testing.assert_close(late[0], late[1])
    times = torch.tensor([0.0, dt, 2 * dt, thrown.seconds, 9.0], dtype=F64)
    way = thrown.flight(times)
    torch.testing.assert_close(way[0], thrown.release)
    torch.testing.assert_close((way[1] - way[0]) / dt, thrown.velocity, atol=1e-3, rtol=0)
    fall = (way[2] - 2 * way[1] + way[0]) / dt**2
    torch.testing.assert_close(fall, torch.tensor([0.0, 0.0, -GRAVITY], dtype=F64), atol=1e-5, rtol=0)  # fmt: skip
    torch.testing.assert_close(way[3:], goal.expand(2, 3))


def test_a_throw_is_a_plan(planner: Planner) -> None:
    """The object stays between the tips until they open, flies then, and the arm keeps up."""
    task = Task(Shape("sphere", (0.01,)), (-0.05, -0.05), (0.02, 0.26), thrown=True)
    plan = planner.plan(task, planner.begin(), NOTHING)
    assert plan.clearance >= 0.0
    assert plan.object[-1, :3].tolist() == pytest.approx([0.02, 0.26, 0.01])
    held = (plan.phase == 1) | (plan.phase == 2)
    matrix = rotations.to_matrix(plan.lower[held, 3:])
    centre, _ = STICKS.tips(plan.angle[held])
    middle = plan.lower[held, :3] + torch.einsum("nij,nj->ni", matrix, centre)
    closing = int((plan.phase == 1).sum())
    torch.testing.assert_close(middle[closing:], plan.object[held, :3][closing:])
    assert float(plan.angle[plan.phase == 3][10:].abs().max()) == 0.0, "open"
    step = plan.object[1:, :3] - plan.object[:-1, :3]
    assert float(step.square().sum(1).sqrt().max()) < 0.03, "no jump as it is let go"
    assert float((plan.arm[1:] - plan.arm[:-1]).abs().max()) < STEP


def test_the_sticks_keep_clear_of_what_lies_upon_an_object(planner: Planner) -> None:
    lower, upper = Shape("box", (0.015, 0.015, 0.015)), Shape("box", (0.012, 0.012, 0.012))
    task = Task(lower, (-0.06, -0.05), (0.06, -0.02), above=upper)
    plan = planner.plan(task, planner.begin(), NOTHING)
    assert plan.clearance >= 0.0
    for rows, place in ((plan.phase < 2, task.start), (plan.phase == 3, task.goal)):
        over = task.over(
            torch.tensor([*place, lower.height], dtype=F64), torch.zeros((), dtype=F64)
        )
        assert over.places[0].tolist() == pytest.approx([*place, 0.021])
        matrix = rotations.to_matrix(plan.lower[rows, 3:])
        rods = STICKS.rods(plan.lower[rows, :3], matrix, plan.angle[rows])
        along = torch.linspace(-HALF_LENGTH, HALF_LENGTH, 261, dtype=F64)
        points = rods.middles[..., None, :] + along[:, None] * rods.axes[..., None, :]
        assert float(to_points(points[..., None, :], over).amin()) - RADIUS >= -1e-6


@pytest.fixture(scope="module")
def with_tongs() -> Planner:
    return Planner(load_grip(tongs_wide()), HandScene(HandScene.Options(tool="tongs")))


def test_tongs_take_a_sphere_between_their_bars(with_tongs: Planner) -> None:
    """MuJoCo's boxes, frame by frame: they touch the sphere on both sides while it is held, and nothing ever is in the
    table; open they are as the grip has them."""
    shape = Shape("sphere", (0.01,))
    plan = with_tongs.plan(Task(shape, (-0.05, -0.06), (0.05, -0.02)), with_tongs.begin(), NOTHING)
    assert plan.clearance >= 0.0
    assert float(plan.angle.min()) == float(plan.angle[-1]) == pytest.approx(0.06)
    scene = HandScene(HandScene.Options(tool="tongs", object=Thing("sphere", (0.01,))))
    data, own = mujoco.MjData(scene.model), scene.model.geom("object").id
    opening, places = scene.model.joint("opening").qposadr[0], np.zeros(6)
    for row in range(0, len(plan.angle), 5):
        data.joint("lower_bar").qpos[:] = plan.lower[row]
        data.joint("object").qpos[:] = plan.object[row]
        data.qpos[opening] = 0.2 - float(plan.angle[row])
        mujoco.mj_kinematics(scene.model, data)
        for name in ("upper_bar", "lower_bar"):
            geom = scene.model.geom(name).id
            size = np.abs(data.geom(name).xmat.reshape(3, 3)[2]) @ scene.model.geom_size[geom]
            assert data.geom(name).xpos[2] - size >= 0.0
            away = mujoco.mj_geomDistance(scene.model, data, geom, own, 0.5, places)
            if plan.phase[row] == 2:
                assert away == pytest.approx(0.0, abs=1e-4)
            assert away > -1e-4


def test_tongs_take_nothing_that_they_do_not_close_upon() -> None:
    narrow = Planner(load_grip(tongs()), HandScene(HandScene.Options(tool="tongs")))
    task = Task(Shape("sphere", (0.01,)), (-0.05, -0.06), (0.05, -0.02))
    with pytest.raises(NoPlan, match=r"thinner than the gripper closes, by 1\d\.\d mm"):
        narrow.plan(task, narrow.begin(), NOTHING)


def test_a_tool_of_one_part_takes_nothing() -> None:
    with pytest.raises(
        ConfigError, match="needs a tool of two parts, and the scene has tool=brush"
    ):
        Jaws("brush")


def test_a_tool_that_rests_elsewhere_in_the_palm_is_planned_for_there(planner: Planner) -> None:
    """The palm stays where the tool was in it before, and the tool goes along by as much."""
    grip, scene = load_grip(standard()), HandScene(HandScene.Options())
    at = torch.tensor(grip.lower)
    at[:3] += torch.tensor([0.002, -0.001, 0.001])
    apart = Planner(grip, scene, at).begin().lower[:3] - planner.begin().lower[:3]
    assert float(apart.square().sum().sqrt()) == pytest.approx(math.sqrt(6.0) * 1e-3)
