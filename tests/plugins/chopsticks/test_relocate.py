"""Relocation: plans as goals, the bank that is refilled, the object's fields, rewards and endings, bad input."""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from torch import Tensor

from understudy.command.cli import main
from understudy.errors import ConfigError, UnderstudyError
from understudy.random import WorldStreams
from understudy.setup.building import Built, build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy.task import Rollout
from understudy_chopsticks.again import Again
from understudy_chopsticks.follow import Follow
from understudy_chopsticks.object import Object, lost, missed, placed, thing
from understudy_chopsticks.plan import gripping
from understudy_chopsticks.plan_bank import Bank
from understudy_chopsticks.relocate import Relocations
from understudy_chopsticks.tracking import turned
from understudy_tensors import rotations
from understudy_tool_planner import arm
from understudy_tool_planner.configuration import NoPlan
from understudy_tool_planner.gripper import Jaws
from understudy_tool_planner.planner import PHASES
from understudy_tool_planner.tasks import Table

WORDS = ["task=chopsticks/relocate", "num_worlds=4", "initial_states.plans=5"]


@pytest.fixture(scope="module")
def built(plugins: Plugins) -> Any:
    built = build_environment(load_experiment(WORDS, plugins))
    yield built
    built.environment.close()


def parts(built: Built) -> tuple[Relocations, Bank]:
    initial = built.environment.parts.initial_states
    assert isinstance(initial, Relocations)
    return initial, initial.bank


def field(built: Built, name: str) -> Tensor:
    return built.environment.table[name]


def test_an_episode_begins_where_its_plan_does(built: Built) -> None:
    built.environment.reset(seed=2)
    _, bank = parts(built)
    rows = field(built, "plan_row").long()
    start = bank.frames[rows, 0, 8:15]
    torch.testing.assert_close(field(built, "qpos")[:, 50:57], start)
    torch.testing.assert_close(field(built, "planned_object"), start)
    assert (field(built, "object_distance") < 1e-6).all()
    torch.testing.assert_close(field(built, "plan_goal"), bank.goals[rows, -1])
    away = (bank.goals[rows, -1] - start[:, :3]).norm(dim=-1)
    torch.testing.assert_close(field(built, "goal_distance"), away)


def test_each_world_follows_its_own_plan(built: Built) -> None:
    """Frame by frame; ahead every 0.05 s; after the end its last frame."""
    built.environment.reset(seed=2)
    _, bank = parts(built)
    for _ in range(7):
        built.environment.advance(torch.zeros(4, 36))
    rows = field(built, "plan_row").long()
    torch.testing.assert_close(field(built, "planned_pose")[:, :7], bank.frames[rows, 7, :7])
    torch.testing.assert_close(field(built, "planned_angle"), bank.frames[rows, 7, 7])
    ahead = field(built, "plan_ahead")
    torch.testing.assert_close(ahead[:, 3, :7], bank.frames[rows, 27, :7])
    speed = (bank.frames[rows, 28, :7] - bank.frames[rows, 27, :7]) / 0.01
    torch.testing.assert_close(ahead[:, 3, 36:43], speed, atol=1e-3, rtol=1e-3)
    late = bank.at(rows, torch.full((4, 1), 100_000))[:, 0]
    torch.testing.assert_close(late, bank.frames[rows, bank.lengths[rows]])
    assert (late[:, 15] == 0).all(), "released at the end"


@pytest.mark.parametrize("frequency", [200, 50, 30])
def test_each_relocation_is_judged_once_at_any_rate(frequency: int, plugins: Plugins) -> None:
    """In the control period that comes to its last frame of 10 ms, or goes past it."""
    words = [
        *WORDS[:1], "num_worlds=1", "initial_states.plans=1", "initial_states.refill=0", "initial_states.relocations=3", "episode.seconds=12",
        f"control.frequency={frequency}", *(f"~termination.terms.{name}" for name in ("contact_lost", "dropped", "lost", "missed", "placed")),
    ]  # fmt: skip
    made = build_environment(load_experiment(words, plugins))
    environment, (_, bank) = made.environment, parts(made)
    environment.reset(seed=3)
    simulator, placed = environment.parts.simulator, torch.zeros(8)
    lasts = float(field(made, "plan_lasts")[0])
    for number in range(1, int(lasts * frequency)):
        state = {name: simulator.read(name).clone() for name in simulator.state_fields}
        frame = min(round(100.0 * number / frequency), int(bank.lengths[0]))
        state["qpos"][0, 50:57] = bank.frames[0, frame, 8:15]
        state["qvel"].zero_()
        simulator.set_state(torch.tensor([True]), state)
        environment.advance(torch.zeros(1, 36))
        placed += field(made, "legs_placed")[0]
        assert not bool(field(made, "leg_missed")[0])
    assert placed.tolist() == [1, 1, 0, 0, 0, 0, 0, 0], "the last one is judged when all is over"
    made.environment.close()


@pytest.mark.parametrize("frequency", [100, 200, 60])
def test_plans_are_followed_evenly_at_any_rate(frequency: int, plugins: Plugins) -> None:
    """Their frames are of 10 ms: between two a plan is between both, and does not stand still in one of two control periods."""
    words = [*WORDS[:1], "num_worlds=2", "initial_states.plans=2", "initial_states.refill=0", f"control.frequency={frequency}"]  # fmt: skip
    made = build_environment(load_experiment(words, plugins))
    environment, (_, bank) = made.environment, parts(made)
    environment.reset(seed=2)
    rows, number = field(made, "plan_row").long(), 0
    for number in range(1, int(1.2 * frequency)):
        environment.advance(torch.zeros(2, 36))
        at = 100.0 * number / frequency
        frame, share = int(at + 1e-6), (at + 1e-6) % 1.0
        here, after = bank.frames[rows, frame], bank.frames[rows, frame + 1]
        wanted = here + share * (after - here)
        thing = field(made, "planned_object")
        torch.testing.assert_close(
            field(made, "planned_pose")[:, :7], wanted[:, :7], atol=2e-5, rtol=0
        )
        torch.testing.assert_close(thing[:, :3], wanted[:, 8:11], atol=2e-5, rtol=0)
        torch.testing.assert_close(thing[:, 3:].norm(dim=1), torch.ones(2), atol=1e-5, rtol=0)
        if frequency == 100:
            assert torch.equal(thing, here[:, 8:15]), "the frame itself"
        if bool(field(made, "failed").any()):
            break  # no policy holds the object
    assert number > 0.5 * frequency
    made.environment.close()


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf, 1e12, -1.0])
def test_a_plan_of_no_number_stays_in_its_world(built: Built, wrong: float) -> None:
    _, bank = parts(built)
    rows, frames = torch.tensor([1.0, wrong, 2.0]), torch.tensor([3.0, 3.0, wrong])
    found = bank.at(rows.long(), frames.long()[:, None])
    assert torch.equal(found[0, 0], bank.frames[1, 3])
    assert found.isfinite().all()


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -1.0])
def test_a_goal_of_no_plan_stays_in_its_world(built: Built, wrong: float) -> None:
    built.environment.reset(seed=2)
    follow = next(w.part for w in built.environment.parts.fields if isinstance(w.part, Follow))
    fields = {name: field(built, name) for name in follow.reads}
    found = follow.compute(**fields)
    fields["followed"] = fields["followed"].clone()
    fields["followed"][1] = wrong
    others = [0, 2, 3]
    for name, value in follow.compute(**fields).items():
        assert torch.equal(value[others], found[name][others]), name


@pytest.mark.parametrize("along", [-0.05, 0.05])
def test_sticks_are_held_further_along_and_their_tips_still_take_the_object(
    along: float, plugins: Plugins
) -> None:
    """Section 5.7.2: both sticks in the palm, fingers' places on them, and plans for tips that are elsewhere in the hand."""
    words = ["num_worlds=2", "initial_states.plans=2", f"initial_states.shift=[{along}, {along}]"]
    made = build_environment(load_experiment([*WORDS[:1], *words], plugins))
    made.environment.reset(seed=2)
    _, bank = parts(made)
    lower_part = gripping(made.context, "this test").lower
    axis = rotations.rotate(lower_part[0, 3:], torch.tensor([1.0, 0.0, 0.0]))
    away = field(made, "planned_lower")[:, :3] - lower_part[:, :3]
    torch.testing.assert_close(away, (along * axis).expand(2, 3))
    torch.testing.assert_close(bank.shifts, torch.full((2,), along))
    jaws = Jaws("sticks")
    for row in range(2):
        count = int(bank.lengths[row]) + 1
        frames = bank.frames[row, :count].double()
        palm, turn = arm.forward(frames[:, :7])
        lower = field(made, "planned_lower")[0].double()
        place = palm + torch.einsum("nij,j->ni", turn, lower[:3])
        matrix = turn @ rotations.to_matrix(lower[3:])
        middle = place + torch.einsum("nij,nj->ni", matrix, jaws.tips(frames[:, 7])[0])
        held = frames[:, 15] > 0
        assert (middle - frames[:, 8:11])[held].norm(dim=1).max() < 5e-4
    began = field(made, "stick_state")[..., :3].clone()
    for _ in range(30):  # by the grip's own targets
        made.environment.advance(torch.zeros(2, 36))
    assert (field(made, "stick_state")[..., :3] - began).norm(dim=-1).max() < 1e-3
    assert field(made, "stick_distance")[:, 1].max() < 1e-3
    assert field(made, "tip_distance").max() < 1e-3
    made.environment.close()


def test_each_plan_has_a_place_of_its_own_along_the_sticks(plugins: Plugins) -> None:
    """And keeps it through a checkpoint."""
    words = ["num_worlds=2", "initial_states.plans=3", "initial_states.shift=[-0.05, 0.05]"]
    made = build_environment(load_experiment([*WORDS[:1], *words], plugins))
    initial, bank = parts(made)
    assert len(bank.shifts.unique()) == 3
    assert bank.shifts.abs().max() <= 0.05
    assert bank.starts.shape == (3, 57)
    state = initial.state_dict()
    kept = {name: value.clone() for name, value in state["bank"].items() if name != "drawn"}
    before = bank.shifts.clone()
    bank.replace(1)
    assert bank.shifts[1] != before[1]
    initial.load_state_dict({**state, "bank": {**kept, "drawn": 3}})
    torch.testing.assert_close(bank.shifts, before)
    assert bank._along == pytest.approx(before.tolist())
    made.environment.close()


def test_without_a_planner_only_the_goal_is_known(plugins: Plugins) -> None:
    """Figure 5.22: arm, hand and sticks stay as they begin, and the one reward is for an object that is there in the end."""
    words = [
        "num_worlds=2", "initial_states.plans=2", "fields.plan.planner=false", "reward.terms.hand=null",
        "reward.terms.sticks=null", "reward.terms.object=null", "reward.terms.contact=null",
        "reward.terms.success.name=value", "reward.terms.success.reads={value: object_placed}",
        "termination.terms.lost=null",
    ]  # fmt: skip
    made = build_environment(load_experiment([*WORDS[:1], *words], plugins))
    made.environment.reset(seed=2)
    _, bank = parts(made)
    first = field(made, "planned_pose").clone()
    rewards = []
    for _ in range(60):
        made.environment.advance(torch.zeros(2, 36))
        rewards.append(field(made, "reward").clone())
        torch.testing.assert_close(field(made, "planned_pose"), first)
        torch.testing.assert_close(field(made, "planned_object")[:, :3], field(made, "plan_goal"))
        assert (field(made, "planned_held") == 0).all()
    assert (torch.stack(rewards) == 0).all()
    frames = bank.frames[field(made, "plan_row").long()]
    assert (frames[:, 60, :7] - frames[:, 0, :7]).abs().max() > 0.01, "there is a plan to be hidden"
    ahead = field(made, "object_ahead")
    torch.testing.assert_close(ahead, ahead[:, :1].expand_as(ahead))
    palm, turn = field(made, "xpos"), field(made, "xquat")
    row = int(gripping(made.context, "this test").scene.model.body("palm").id)
    seen = rotations.rotate(turn[:, row], ahead[:, 0, :3]) + palm[:, row]
    torch.testing.assert_close(seen, field(made, "plan_goal"), atol=1e-5, rtol=1e-5)
    made.environment.close()


def test_sticks_press_while_they_hold(plugins: Plugins) -> None:
    targets = {}
    for squeeze in (0.0, 0.05):
        words = [*WORDS[:1], "num_worlds=1", "initial_states.plans=2", f"fields.plan.squeeze={squeeze}"]  # fmt: skip
        made = build_environment(load_experiment(words, plugins))
        made.environment.reset(seed=0)
        held = parts(made)[1].frames[int(field(made, "plan_row")[0]), :, 15]
        first = int(held.nonzero()[0])
        seen = []
        for _ in range(first + 3):
            made.environment.advance(torch.zeros(1, 36))
            seen.append(field(made, "planned_targets")[0].clone())
        targets[squeeze] = torch.stack(seen), first
        made.environment.close()
    (plain, first), (pressed, _) = targets[0.0], targets[0.05]
    torch.testing.assert_close(plain[: first - 1], pressed[: first - 1])
    assert (plain[first:] - pressed[first:]).abs().amax() > 0.005


def test_the_object_is_seen_from_the_palm(built: Built) -> None:
    """A point of the object's frame is where the palm's pose and the object's place in it say."""
    built.environment.reset(seed=1)
    built.environment.advance(torch.zeros(4, 36))
    from understudy_tensors import rotations

    palm = built.scene.model.body("palm").id  # type: ignore[attr-defined]
    here, turn = field(built, "xpos")[:, palm], field(built, "xquat")[:, palm]
    state = field(built, "object_state")
    world = here + rotations.rotate(turn, state[:, :3])
    torch.testing.assert_close(world, field(built, "qpos")[:, 50:53], atol=1e-5, rtol=0)
    ahead = field(built, "object_ahead")[:, 0]
    _, bank = parts(built)
    planned = bank.frames[field(built, "plan_row").long(), 6, 8:11]
    torch.testing.assert_close(
        here + rotations.rotate(turn, ahead[:, :3]), planned, atol=1e-5, rtol=0
    )


def test_targets_of_the_arm_lead_by_the_lag_of_its_servos(built: Built) -> None:
    """kd / kp at the plan's speed, and not the hand's."""
    built.environment.reset(seed=2)
    for _ in range(12):
        built.environment.advance(torch.zeros(4, 36))
    targets, pose, speed = (
        field(built, f"planned_{name}")[:, :7] for name in ("targets", "pose", "velocity")
    )
    assert speed.abs().max() > 0.1
    torch.testing.assert_close(targets - pose, 0.1 * speed, atol=1e-5, rtol=1e-4)


def test_a_stick_that_is_turned_ends_an_episode() -> None:
    assert turned(torch.tensor([[0.05, 0.09], [0.0, 0.11]])).tolist() == [False, True]


def test_rewards_and_endings_are_what_they_say() -> None:
    distance, turn = torch.tensor([0.01, 0.0]), torch.tensor([0.02, 0.0])
    assert thing(distance, turn).tolist() == pytest.approx([math.exp(-0.4 - 0.2), 1.0])
    assert lost(torch.tensor([0.0177, 0.0179])).tolist() == [False, True]
    over, there = torch.tensor([1.0, 1.0, 0.0]), torch.tensor([1.0, 0.0, 0.0])
    assert missed(over, there).tolist() == [False, True, False]
    assert placed(there).tolist() == [True, False, False]


def test_a_relocation_succeeds_where_the_object_lies_at_its_goal_when_the_plan_is_over(
    built: Built,
) -> None:
    made = Object(Object.Options(), built.context)
    qpos = torch.zeros(4, 57)
    qpos[:, 53] = 1.0
    qpos[:, 50] = torch.tensor([0.0049, 0.0049, 0.0051, 0.0])
    found = made.compute(
        qpos=qpos, qvel=torch.zeros(4, 54), xpos=torch.zeros(4, 60, 3),
        xquat=torch.tensor([1.0, 0, 0, 0]).expand(4, 60, 4), planned_object=torch.tensor([0.0, 0, 0, 1, 0, 0, 0]).expand(4, 7),
        planned_goal=torch.zeros(4, 3), planned_leg=torch.tensor([2.0, 2.0, 2.0, 0.0]),
        leg_over=torch.tensor([0.0, 1.0, 1.0, 1.0]), plan_lasts=torch.full((4,), 1.5),
        plan_stopped=torch.full((4,), -1.0), plan_time=torch.tensor([1.8, 1.79, 1.8, 5.0]),
        object_shape=torch.zeros(4, 6),
    )  # fmt: skip
    assert found["object_placed"].tolist() == [1, 0, 0, 1]
    assert found["plan_over"].tolist() == [1, 0, 1, 1]
    assert found["leg_placed"].tolist() == [1, 0, 0, 1]
    assert found["legs_placed"].nonzero().tolist() == [[0, 2], [3, 0]]


def test_relocations_follow_one_another(plugins: Plugins) -> None:
    """Each begins where the last one ended, after a rest in which nothing moves; the goals are theirs."""
    words = [*WORDS[:1], "num_worlds=1", "initial_states.plans=2", "initial_states.relocations=3"]
    made = build_environment(load_experiment(words, plugins))
    _, bank = parts(made)
    made.environment.close()
    frames, count = bank.frames[0], int(bank.lengths[0]) + 1
    leg, last = frames[:count, 16], frames[:count, 17].nonzero()[:, 0]
    assert leg.unique().tolist() == [0, 1, 2]
    assert len(last) == 3
    assert last[-1] == count - 1
    assert (leg.diff() >= 0).all()
    assert frames[:count, :7].diff(dim=0).abs().max() < 0.15, "no jump of the arm"
    for k, end in enumerate(last.tolist()):
        torch.testing.assert_close(frames[end, 8:11], bank.goals[0, k])
        if k < 2:
            torch.testing.assert_close(frames[end + 1, 8:15], frames[end, 8:15])
            assert (frames[end - 29 : end, :16] == frames[end, :16]).all(), "a rest of 0.3 s"
            assert (bank.goals[0, k + 1] - bank.goals[0, k]).norm() > 1e-3
    assert (frames[count:, 17] == 1).all()


def test_the_sticks_go_elsewhere_between_two_relocations(plugins: Plugins) -> None:
    """Before each but the first they go away from the object, which lies still, and come back to it; without it they stay there."""
    farthest = {}
    for elsewhere in (False, True):
        words = [*WORDS[:1], "num_worlds=1", "initial_states.plans=3", "initial_states.relocations=2", f"initial_states.elsewhere={elsewhere}"]  # fmt: skip
        made = build_environment(load_experiment(words, plugins))
        _, bank = parts(made)
        made.environment.close()
        away = []
        for row in range(3):
            frames = bank.frames[row, : int(bank.lengths[row]) + 1]
            assert frames[:, :7].diff(dim=0).abs().max() < 0.15, "no jump of the arm"
            second = frames[frames[:, 16] == 1]
            before = second[: int(second[:, 15].nonzero()[0])]
            assert (before[:, 8:15] == before[0, 8:15]).all(), "the object lies still"
            torch.testing.assert_close(bank.goals[row, 0], before[0, 8:11])
            palms = arm.forward(before[:, :7].double())[0]
            away.append(float((palms - palms[-1]).norm(dim=1).max()))
        farthest[elsewhere] = away
    assert max(farthest[False]) < 0.04
    assert min(farthest[True]) > 0.04


def test_a_noisy_plan_takes_beside_the_object(plugins: Plugins) -> None:
    """By the same error all along; the object's own plan and the sticks' first frame are as without."""
    banks = []
    for noise in (0.0, 0.003):
        words = [*WORDS[:1], "num_worlds=1", "initial_states.plans=3", f"initial_states.noise={noise}"]  # fmt: skip
        made = build_environment(load_experiment(words, plugins))
        banks.append(parts(made)[1])
        made.environment.close()
    exact, noisy = (bank.frames for bank in banks)
    torch.testing.assert_close(exact[..., 8:], noisy[..., 8:])
    assert (exact[:, 0, :7] - noisy[:, 0, :7]).abs().max() < 1e-3
    held = exact[..., 15] > 0
    off = (exact - noisy)[..., :7][held].abs().amax(dim=-1)
    assert off.min() > 1e-3
    assert off.max() < 0.1


def test_a_box_is_put_upon_another(plugins: Plugins) -> None:
    """The goal is on top of what lies there; nothing is in the way of the plan, nor are the two in each other."""
    box = "{kind: box, sizes: [0.015, 0.015, 0.015]}"
    words = [*WORDS[:1], "num_worlds=4", "initial_states.plans=3", f"scene.object={box}", "scene.below={kind: box, sizes: [0.02, 0.02, 0.02]}"]  # fmt: skip
    made = build_environment(load_experiment(words, plugins))
    made.environment.reset(seed=0)
    goal, qpos = field(made, "plan_goal").clone(), field(made, "qpos").clone()
    assert goal[:, 2].tolist() == pytest.approx([0.0275] * 4)
    torch.testing.assert_close(qpos[:, 57:59], goal[:, :2])
    assert qpos[:, 59].tolist() == pytest.approx([0.01] * 4)
    assert (qpos[:, 50:52] - goal[:, :2]).norm(dim=1).min() > 0.03
    _, bank = parts(made)
    for row in range(3):
        way = bank.frames[row, : int(bank.lengths[row]) + 1]
        held, under = way[way[:, 15] > 0, 8:11], way[-1, 8:10]
        near = (held[:, :2] - under).abs().amax(1) < 0.01
        assert held[near, 2].min() > 0.0275 - 5e-4, "not through the lower one"
    for _ in range(20):
        made.environment.advance(torch.zeros(4, 36))
    torch.testing.assert_close(field(made, "qpos")[:, 57:60], qpos[:, 57:60], atol=1e-4, rtol=0)
    made.environment.close()


def test_two_boxes_are_moved_together(plugins: Plugins) -> None:
    """The upper one lies upon the lower one as the plan begins, no stick goes through it, and both have to arrive."""
    words = [
        *WORDS[:1], "num_worlds=2", "initial_states.plans=2", "scene.object={kind: box, sizes: [0.015, 0.015, 0.015]}",
        "scene.above={kind: box, sizes: [0.012, 0.012, 0.012]}", "initial_states.longest=4",
    ]  # fmt: skip
    made = build_environment(load_experiment(words, plugins))
    environment, (_, bank) = made.environment, parts(made)
    environment.reset(seed=0)
    qpos = field(made, "qpos").clone()
    torch.testing.assert_close(qpos[:, 57:59], qpos[:, 50:52])
    assert qpos[:, 59].tolist() == pytest.approx([0.021] * 2)
    for _ in range(20):
        environment.advance(torch.zeros(2, 36))
    torch.testing.assert_close(field(made, "qpos")[:, 57:60], qpos[:, 57:60], atol=1e-3, rtol=0)
    simulator, rows = environment.parts.simulator, field(made, "plan_row").long()
    for aside, placed_together in ((0.0, 1.0), (0.009, 0.0)):
        environment.reset(seed=0)
        for _ in range(int(bank.lengths[rows].amax()) + 31):
            state = {name: simulator.read(name).clone() for name in simulator.state_fields}
            state["qvel"][:, 48:] = 0.0
            state["qpos"][:, 50:57] = bank.frames[rows, bank.lengths[rows], 8:15]
            state["qpos"][:, 57:64] = state["qpos"][:, 50:57]
            state["qpos"][:, 57] += aside
            state["qpos"][:, 59] += 0.0135
            simulator.set_state(torch.ones(2, dtype=torch.bool), state)
            environment.advance(torch.zeros(2, 36))
        assert field(made, "object_placed").tolist() == [placed_together] * 2
    made.environment.close()


ANY = "scene.object={kind: any, sizes: [], rolling: 0.0005}"


def test_each_plan_moves_another_object(plugins: Plugins) -> None:
    """Spheres, capsules and boxes of table 5.2 side by side: each lies still on the table at its own height, is seen as it is, and what is
    known of it goes with its plan."""
    words = [*WORDS[:1], "num_worlds=8", "initial_states.plans=8", "initial_states.refill=0", ANY]
    made = build_environment(
        load_experiment([*words, "encoder.state.shape=true"], plugins), evaluating=True
    )
    initial, bank = parts(made)
    environment, table = made.environment, made.environment.table
    environment.reset(seed=0)
    height = table["qpos"][:, 52].clone()
    kind, half = table["object_shape"][:, :3], table["object_shape"][:, 3:]
    assert (kind.sum(0) > 0).all(), "one kind is missing: the test shows less"
    assert len(height.unique()) == 8
    torch.testing.assert_close(height, half[:, 2])
    mass = table["body_mass/object"]
    boxes = kind[:, 2] > 0
    torch.testing.assert_close(mass[boxes], 8000.0 * half[boxes].prod(dim=1))
    balls = kind[:, 0] > 0
    torch.testing.assert_close(mass[balls], 4000 / 3 * math.pi * half[balls, 0] ** 3)
    for _ in range(29):
        environment.advance(torch.zeros(8, 36))
    seen = environment.advance(torch.zeros(8, 36)).observations
    assert (table["object_distance"] < 3e-4).all(), "each lies where it is planned to"
    torch.testing.assert_close(seen["state"][:, -6:], table["object_shape"])
    turned = rotations.from_heading(torch.full((8,), 0.3))
    found = Object(Object.Options(), made.context).compute(
        **{n: table[n] for n in Object.reads if n != "planned_object"},
        planned_object=torch.cat([torch.zeros(8, 3), turned], dim=1),
    )
    assert ((found["object_turn"] > 0) == ~balls).all(), "a sphere's rotation is nobody's"
    state = initial.state_dict()
    again = build_environment(load_experiment([*words, "seed=5"], plugins), evaluating=True)
    other, _ = parts(again)
    other.load_state_dict(state)
    torch.testing.assert_close(other.bank.seen, bank.seen)
    forms = other.bank.forms
    assert forms is not None
    own = forms.values(bank.kinds, bank.sizes)
    rows = table["plan_row"].long()
    for name, value in own.items():
        torch.testing.assert_close(table[name], value[rows])
    for one in (made, again):
        one.environment.close()


def test_an_object_is_thrown_to_the_far_side(plugins: Plugins) -> None:
    words = ["experiment=chopsticks/throw", "device=cpu", "simulator=mujoco", "num_worlds=3", "initial_states.plans=3"]  # fmt: skip
    made = build_environment(load_experiment(words, plugins))
    made.environment.reset(seed=0)
    goal, (_, bank) = field(made, "plan_goal"), parts(made)
    assert (goal[:, 1] >= 0.2).all()
    assert (goal[:, 0].abs() <= 0.1).all()
    for row in range(3):
        way = bank.frames[row, : int(bank.lengths[row]) + 1]
        assert way[:, 10].amax() > 0.08, "through the air"
        torch.testing.assert_close(way[-1, 8:11], bank.goals[row, 0])
    object_ = next(w.part for w in made.environment.parts.fields if isinstance(w.part, Object))
    assert (object_._options.within, object_._options.settle) == (0.05, 0.0)
    made.environment.close()


def test_tongs_are_planned_for_where_they_rest_in_the_hand(plugins: Plugins) -> None:
    """An episode begins with the lower bar where its plan has it, to 1 mm at the tips; 6 mm beside it where plans count
    on where the grip was found."""
    beside = {}
    for settled in (True, False):
        words = [
            "experiment=chopsticks/relocate_tongs", "num_worlds=1", "initial_states.plans=2",
            f"initial_states.settled={settled}",
        ]  # fmt: skip
        made = build_environment(load_experiment(words, plugins))
        made.environment.reset(seed=0)
        _, bank = parts(made)
        model = bank._made.scene.model
        data = mujoco.MjData(model)
        data.qpos[:] = field(made, "qpos")[0].numpy()
        mujoco.mj_kinematics(model, data)
        tip = data.site("lower_bar_tip").xpos
        now = bank._planner.begin()
        planned = now.lower[:3] - 0.13 * rotations.to_matrix(now.lower[3:])[:, 0]
        beside[settled] = float(np.linalg.norm(tip - planned.numpy()))
        made.environment.close()
    assert beside[True] < 1e-3
    assert 4e-3 < beside[False] < 8e-3


@pytest.fixture(scope="module")
def replanned(plugins: Plugins) -> Any:
    words = [*WORDS[:1], "num_worlds=3", "initial_states.plans=3", "memory.again.most=2"]
    made = build_environment(load_experiment(words, plugins), evaluating=True)
    yield made
    made.environment.close()


def test_a_plan_that_fails_is_made_anew_from_where_everything_is(replanned: Built) -> None:
    """In that world alone: a plan of its own, to the same goal, that begins with the arm where it is."""
    environment, (_, bank) = replanned.environment, parts(replanned)
    environment.reset(seed=3)
    for _ in range(20):
        environment.advance(torch.zeros(3, 36))
    before = {n: field(replanned, n).clone() for n in ("plan_row", "plan_goal", "followed")}
    simulator = environment.parts.simulator
    state = {name: simulator.read(name).clone() for name in simulator.state_fields}
    state["qpos"][1, 50:53] = torch.tensor([-0.05, 0.0, 0.01])
    state["qvel"][1, 48:] = 0.0
    simulator.set_state(torch.tensor([False, True, False]), state)
    environment.refresh()
    arm = field(replanned, "planned_pose")[:, :7].clone()
    environment.advance(torch.zeros(3, 36))
    assert field(replanned, "replans").tolist() == [0, 0, 0]
    assert field(replanned, "plan_stopped").tolist() == pytest.approx([-1, 0.21, -1])
    assert field(replanned, "object_distance")[1] == 0.0, "no plan has it"
    assert not bool(field(replanned, "failed").any())
    speed = []
    for _ in range(41):
        arm = field(replanned, "planned_pose")[:, :7].clone()
        speed.append(field(replanned, "planned_velocity")[1, :7].norm().item())
        environment.advance(torch.zeros(3, 36))
        assert (field(replanned, "planned_pose")[1, :7] - arm[1]).abs().max() < 0.05, "no jolt"
    assert speed[0] > 0.1
    assert speed == sorted(speed, reverse=True), "the sticks slow down"
    assert speed[-1] < 0.03 * speed[0]
    assert field(replanned, "replans").tolist() == [0, 1, 0]
    assert not bool(field(replanned, "failed").any()), "what is begun anew is not lost"
    followed = field(replanned, "followed")
    assert followed.tolist() == [before["followed"][0], 3 + 1, before["followed"][2]]
    assert torch.equal(field(replanned, "plan_row"), before["plan_row"])
    new = bank.frames[4, : int(bank.lengths[4]) + 1]
    torch.testing.assert_close(new[0, 8:10], torch.tensor([-0.05, 0.0]), atol=2e-3, rtol=0)
    torch.testing.assert_close(new[-1, 8:11], before["plan_goal"][1])
    assert (new[0, :7] - arm[1]).abs().max() < 0.05
    assert new[:, :7].diff(dim=0).abs().max() < 0.15, "no jump of the arm"
    assert (new[:10, :7] - new[0, :7]).abs().max() < 0.02, "it waits while the plan is found"
    assert float(field(replanned, "plan_time")[1]) < 0.03
    assert (field(replanned, "plan_time")[[0, 2]] > 0.2).all()


def test_what_no_plan_reaches_is_given_up(replanned: Built) -> None:
    environment = replanned.environment
    environment.reset(seed=3)
    simulator = environment.parts.simulator
    state = {name: simulator.read(name).clone() for name in simulator.state_fields}
    state["qpos"][0, 50:53] = torch.tensor([0.0, 0.0, -0.3])
    state["qpos"][2, 50:53] = float("nan")
    simulator.set_state(torch.tensor([True, False, True]), state)
    environment.refresh()
    for _ in range(2):
        environment.advance(torch.zeros(3, 36))
    assert field(replanned, "given_up").tolist() == [1, 0, 0]
    assert field(replanned, "replans").tolist() == [0, 0, 0]
    assert field(replanned, "failed")[[0, 2]].all()


@pytest.mark.parametrize("onward", [False, True])
def test_a_relocation_that_misses_is_made_anew_itself(plugins: Plugins, onward: bool) -> None:
    """Not the one after it, to whose frames the sticks come as they slow down; and none is passed over."""
    words = [
        *WORDS[:1], "num_worlds=1", "initial_states.plans=1", "initial_states.refill=0", "initial_states.relocations=3", "memory.again.most=1",
        f"memory.again.onward={onward}", "termination.terms.contact_lost=null", "termination.terms.dropped=null",
        "scene.object={kind: box, sizes: [0.012, 0.012, 0.012]}",
    ]  # fmt: skip
    made = build_environment(load_experiment(words, plugins), evaluating=True)
    environment, (_, bank) = made.environment, parts(made)
    bank.slipped = lambda place: [0.0] * len(place)  # without a policy sticks slip, and fall
    environment.reset(seed=3)
    simulator, goals = environment.parts.simulator, bank.goals[0].clone()

    def carried(aside: float) -> None:
        """A step, and the object where its plan has it or `aside` of that, m."""
        state = {name: simulator.read(name).clone() for name in simulator.state_fields}
        frame = round(float(field(made, "plan_time")[0]) / 0.01) + 1
        row = bank.frames[int(field(made, "followed")[0])]
        state["qpos"][0, 50:57] = row[min(frame, len(row) - 1), 8:15]
        state["qpos"][0, 50] += aside
        state["qvel"][0, 48:] = 0.0
        simulator.set_state(torch.tensor([True]), state)
        environment.advance(torch.zeros(1, 36))

    while float(field(made, "plan_stopped")[0]) < 0:
        carried(0.008)
        assert float(field(made, "planned_leg")[0]) == 0.0
    while float(field(made, "replans")[0]) == 0:
        environment.advance(torch.zeros(1, 36))
        assert float(field(made, "planned_leg")[0]) == 0.0
        torch.testing.assert_close(field(made, "planned_goal")[0], goals[0])
    assert int(field(made, "followed")[0]) == bank.drawn
    new = bank.frames[bank.drawn, : int(bank.lengths[bank.drawn]) + 1]
    assert new[:, 16].unique().tolist() == ([0.0, 1.0] if onward else [0.0, 1.0, 2.0])
    end = int((new[:, 17] == 1).nonzero()[0, 0])
    torch.testing.assert_close(new[end, 8:11], goals[0])
    torch.testing.assert_close(bank.goals[bank.drawn], goals)
    placed = 0
    while float(field(made, "planned_leg")[0]) == 0.0:
        carried(0.0)
        placed += int(field(made, "leg_placed")[0])
    assert placed == 1
    assert field(made, "replans").tolist() == [1]
    assert float(field(made, "planned_leg")[0]) == 1.0
    made.environment.close()


def test_what_is_put_upon_another_is_put_there_anew(plugins: Plugins) -> None:
    box = "{kind: box, sizes: [0.015, 0.015, 0.015]}"
    words = [*WORDS[:1], "num_worlds=1", "initial_states.plans=1", "initial_states.refill=0", "memory.again.most=1", f"scene.object={box}"]  # fmt: skip
    under = "scene.below={kind: box, sizes: [0.02, 0.02, 0.02]}"
    made = build_environment(load_experiment([*words, under], plugins), evaluating=True)
    made.environment.reset(seed=0)
    goal, (_, bank) = field(made, "plan_goal")[0].clone(), parts(made)
    start = bank.frames[0, 0, 8:15].double().cpu()
    own = bank.again(0, 0, 20, 0, start[:3], start[3:], 0.0)
    assert own == 1
    way = bank.frames[1, : int(bank.lengths[1]) + 1]
    torch.testing.assert_close(way[-1, 8:11], goal)
    assert float(goal[2]) == pytest.approx(0.0275)
    held = way[way[:, 15] > 0, 8:11]
    near = (held[:, :2] - goal[:2]).abs().amax(1) < 0.01
    assert held[near, 2].min() > 0.0275 - 5e-4, "not through the lower one"
    made.environment.close()
    over = "scene.above={kind: box, sizes: [0.012, 0.012, 0.012]}"
    made = build_environment(load_experiment([*words, over], plugins), evaluating=True)
    made.environment.reset(seed=0)
    assert parts(made)[1].again(0, 0, 20, 0, start[:3], start[3:], 0.0) is None, (
        "it may have fallen"
    )
    made.environment.close()


def test_the_next_relocation_is_planned_from_where_the_object_lies(plugins: Plugins) -> None:
    """In the moment at which it begins, in that world alone, and the arm goes on from where it is."""
    words = [
        *WORDS[:1], "num_worlds=2", "initial_states.plans=2", "initial_states.relocations=3", "memory.again.onward=true",
    ]  # fmt: skip
    experiment = load_experiment([*words, "evaluation.failures=[missed]"], plugins)
    made = build_environment(experiment, evaluating=True)
    environment, (_, bank) = made.environment, parts(made)
    environment.reset(seed=3)
    rows = field(made, "plan_row").long()
    old = bank.frames[rows[0]].clone()
    assert old[:, 16].amax() == 1, "the others are not planned yet"
    end = int(((old[:, 16] == 0) & (old[:, 17] == 1)).nonzero()[0, 0])
    simulator, there = environment.parts.simulator, old[end, 8:11] + torch.tensor([0.01, 0.0, 0.0])
    while float(field(made, "planned_leg")[0]) == 0.0:
        assert int(field(made, "followed")[0]) == int(rows[0])
        if float(field(made, "episode_time")[0]) >= 0.01 * end - 0.015:
            state = {name: simulator.read(name).clone() for name in simulator.state_fields}
            state["qpos"][0, 50:53], state["qvel"][0, 48:] = there, 0.0
            simulator.set_state(torch.tensor([True, False]), state)
            environment.refresh()
        assert not bool(field(made, "failed")[0]), "that the plan ends is not the end"
        environment.advance(torch.zeros(2, 36))
    assert int(field(made, "followed")[0]) == bank.drawn
    assert int(field(made, "followed")[1]) in (int(rows[1]), bank.drawn + 1)
    new = bank.frames[bank.drawn]
    assert float(field(made, "plan_time")[0]) == pytest.approx(0.0, abs=1e-6)
    torch.testing.assert_close(new[0, 8:10], there[:2], atol=2e-3, rtol=0)
    assert float(field(made, "object_distance")[0]) < 2e-3
    assert (new[0, :7] - old[end, :7]).abs().max() < 0.05
    over = int(((new[:, 16] == 1) & (new[:, 17] == 1)).nonzero()[0, 0])
    torch.testing.assert_close(new[over, 8:11], bank.goals[bank.drawn, 1])
    assert not torch.equal(bank.goals[bank.drawn, 1], bank.goals[rows[0], 0]), "a goal of its own"
    assert new[over + 1, 16] == 2, "and one more follows"
    assert field(made, "replans").tolist() == [0, 0]
    # It counts on the sticks where they are: they have slipped, and along the lower one nothing is left of that.
    lower, planned = field(made, "stick_state")[0, 1, :3], field(made, "planned_lower")[0]
    axis = rotations.rotate(planned[None, 3:], torch.tensor([[1.0, 0.0, 0.0]]))[0]
    assert abs(float(bank.shifts[bank.drawn])) > 1e-4
    assert float((planned[:3] - bank._made.lower[0, :3]) @ axis) == pytest.approx(
        float(bank.shifts[bank.drawn]), abs=1e-6
    )
    assert abs(float((lower - planned[:3]) @ axis)) < 5e-5
    assert bank.shifts[rows[0]] == 0.0, "what was planned before did not"
    made.environment.close()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ([], ""),
        (["initial_states.relocations=3"], r"4 s are over before 3 relocations in a row .* 3 of 3 worlds, where they take 5\.\d+ s"),
        (["initial_states.relocations=3", "episode.seconds=10"], ""),
        # of eight only the first is planned as an episode begins
        (["initial_states.relocations=8", "memory.again.onward=true"], "take 14.1 s or more, .* evaluation.seconds=27"),
        (["initial_states.relocations=8", "memory.again.onward=true", "episode.seconds=27"], ""),
        (["episode.seconds=1"], "before relocations can be"),
        (["memory.again.most=4"], r"before a plan made anew .* which may last 3 s longer\. Set .* evaluation.seconds=7\."),
        (["memory.again.most=4", "episode.seconds=7"], ""),
    ],
)  # fmt: skip
def test_episodes_in_which_there_is_no_time_are_told(
    words: list[str], told: str, plugins: Plugins
) -> None:
    words = [*WORDS[:1], "num_worlds=3", "initial_states.plans=3", *words]
    made = build_environment(load_experiment(words, plugins), evaluating=True)
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        made.environment.reset(seed=1)
        made.environment.reset(seed=1)
    assert len(found) == bool(told), "once"
    assert not told or re.search(told, str(found[0].message))
    made.environment.close()


def test_plans_are_the_same_whether_some_may_be_made_anew(plugins: Plugins) -> None:
    """And none is longer than is asked for: rows of plans made anew have room for longer ones."""
    words = [*WORDS[:1], "num_worlds=6", "initial_states.plans=6", "initial_states.longest=1.7"]
    found = []
    for most in (0, 2):
        made = build_environment(
            load_experiment([*words, f"memory.again.most={most}"], plugins), evaluating=True
        )
        made.environment.reset(seed=1)
        _, bank = parts(made)
        found.append((bank.lengths[:6].tolist(), bank.goals[:6, 0].tolist()))
        made.environment.close()
    assert found[0] == found[1]
    assert max(found[0][0]) <= 170


def test_nobody_leads_an_object_past_what_it_is_put_upon(plugins: Plugins) -> None:
    """Of what was put there, and may have been pushed away, nothing is known."""
    box = "{kind: box, sizes: [0.015, 0.015, 0.015]}"
    words = [*WORDS[:1], "num_worlds=1", "initial_states.plans=1", "initial_states.refill=0", f"scene.object={box}", f"scene.below={box}"]  # fmt: skip
    made = build_environment(load_experiment(words, plugins), evaluating=True)
    made.environment.reset(seed=1)
    _, bank = parts(made)
    bank.spare(1)
    place, turn = torch.tensor([0.0, 0.0, 0.0075]).double(), torch.tensor([1.0, 0, 0, 0]).double()
    with pytest.raises(NoPlan, match="put upon may be in the way"):
        bank.toward(0, 0, 0, 0, place, turn, (0.05, 0.0), 0.0)
    made.environment.close()


def test_a_tool_that_touches_what_it_let_go_of_goes_up_first(plugins: Plugins) -> None:
    """An object that lies 4 mm beside where it was put is touched by an open stick: each way to it begins inside it."""
    words = [
        *WORDS[:1], "num_worlds=2", "initial_states.plans=2", "initial_states.relocations=2", "memory.again.onward=true",
    ]  # fmt: skip
    made = build_environment(load_experiment(words, plugins), evaluating=True)
    made.environment.reset(seed=3)
    _, bank = parts(made)
    bank.need([0])
    frames, row, goal = bank.frames[0].clone(), 0, (0.05, -0.02)
    end = int(((frames[:, 16] == 0) & (frames[:, 17] == 1)).nonzero()[0, 0])
    here = frames[end].double()
    now = replace(bank._planner.begin(tuple(here[:7].tolist())), angle=here[7])
    start = (float(here[8]), float(here[9]) + 0.004)
    table = Table((bank._shapes[0],), (start,), (0.0,))
    with pytest.raises(NoPlan, match="in the phase 'approach' something is in the way"):
        bank._planner.plan(table.task(0, goal), now, table.without(0))
    turn = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    own = bank.toward(row, 0, end, 0, torch.tensor([*start, 0.01]).double(), turn, goal, 0.0)
    new = bank.frames[own]
    rises = bank._planner.begin(tuple(new[40, :7].double().tolist())).lower[2] - now.lower[2]
    assert float(rises) == pytest.approx(0.03, abs=2e-3)
    torch.testing.assert_close(new[int(bank.lengths[own]), 8:10], torch.tensor(goal))
    with pytest.raises(NoPlan, match="the arm is too short"):  # and not that the way up was none
        bank.toward(row, 0, end, 0, torch.tensor([*start, 0.01]).double(), turn, (0.6, 0.2), 0.0)
    made.environment.close()


def test_trainings_never_plan_anew(plugins: Plugins) -> None:
    """Nothing is asked of the device: what was kept is returned as it is, and the bank has no spare rows."""
    words = [*WORDS[:1], "num_worlds=2", "initial_states.plans=2", "memory.again.most=2"]
    made = build_environment(load_experiment(words, plugins))
    memory = made.environment.parts.memories["again"].part
    kept = {"followed": torch.zeros(2)}
    lost = torch.full((2,), 0.5)
    found = memory.advance(
        kept, plan_row=lost, episode_time=lost, qpos=lost, qvel=lost, object_distance=lost, leg_missed=lost,
        planned_leg=lost, plan_over=lost, stick_state=lost,
    )  # fmt: skip
    assert found is kept
    assert len(parts(made)[1].frames) == 2
    made.environment.close()


def rollout(rows: list[list[float]], rewards: list[list[float]] | None = None) -> Any:
    class Noted:
        fields = {"plan_row": torch.tensor(rows)}

    found: Any = Noted()
    found.rewards = torch.tensor(rewards or [])
    return found


def test_the_bank_is_refilled_without_a_jolt_to_those_that_follow(plugins: Plugins) -> None:
    """A row rests for a rollout, and gets its new plan once no world is in the old one."""
    words = [*WORDS, "initial_states.refill=1"]
    made = build_environment(load_experiment(words, plugins))
    initial, bank = parts(made)
    made.environment.reset(seed=0)
    before = bank.frames.clone()
    following: Rollout = rollout([[0, 1, 2, 3]])
    assert initial.update(following)["new_plans"] == 0
    assert initial._waiting == [0]
    for seed in range(8):
        made.environment.reset(seed=seed)
        assert (field(made, "plan_row") != 0).all(), "what waits is not drawn"
    initial.update(rollout([[0, 1, 2, 3], [0, 1, 2, 4]]))
    assert torch.equal(bank.frames, before), "a world is in row 0 still"
    assert initial.update(rollout([[0, 1, 2, 3], [4, 1, 2, 4]]))["new_plans"] == 1
    assert not torch.equal(bank.frames[0], before[0])
    assert torch.equal(bank.frames[1:], before[1:])
    assert initial._waiting == [1]
    made.environment.close()


def test_plans_that_go_badly_are_drawn_more_often(plugins: Plugins) -> None:
    """With exp(-harder r), r the mean reward of a decision in the last rollout that followed one."""
    words = [*WORDS, "initial_states.refill=0", "initial_states.harder=2"]
    made = build_environment(load_experiment(words, plugins), num_worlds=1)
    initial, _ = parts(made)

    def shares() -> list[float]:
        streams = WorldStreams(0, "starts", 20000, made.context.device)
        rows = initial.sample(streams)["plan_row"].long()
        return (rows.bincount(minlength=5) / 20000).tolist()

    assert shares() == pytest.approx([0.2] * 5, abs=0.01), "evenly while nobody knows"
    initial.update(rollout([[0, 1, 2], [0, 1, 3]], [[0.9, 0.2, 0.6], [0.7, 0.0, 0.5]]))
    weights = [math.exp(-2 * r) for r in (0.8, 0.1, 0.6, 0.5, 0.0)]
    assert shares() == pytest.approx([w / sum(weights) for w in weights], abs=0.01)
    initial.update(rollout([[0]], [[0.1]]))  # of the others it stays known
    weights[0] = weights[1]
    assert shares() == pytest.approx([w / sum(weights) for w in weights], abs=0.01)
    again = build_environment(load_experiment(words, plugins), num_worlds=1)
    parts(again)[0].load_state_dict(initial.state_dict())
    torch.testing.assert_close(parts(again)[0]._going, initial._going)
    made.environment.close()
    again.environment.close()


def test_a_rollout_says_which_plans_are_followed(built: Built) -> None:
    """What :meth:`Relocations.update` goes by."""
    assert parts(built)[0].rollout_fields == ("plan_row",)
    assert "plan_row" in built.environment.table.shapes


def test_a_bank_goes_on_as_it_was(plugins: Plugins, built: Built) -> None:
    made = build_environment(load_experiment([*WORDS, "seed=9"], plugins))
    initial, bank = parts(made)
    assert not torch.equal(bank.frames, parts(built)[1].frames)
    initial.load_state_dict(parts(built)[0].state_dict())
    assert torch.equal(bank.frames, parts(built)[1].frames)
    made.environment.close()


def test_evaluations_follow_plans_that_no_training_has(plugins: Plugins, built: Built) -> None:
    made = build_environment(load_experiment(WORDS, plugins), evaluating=True)
    bank = parts(made)[1]
    assert not bank.lengths.any(), "each is made when it is needed"
    bank.need([4, 1])
    some = bank.frames[[1, 4]].clone()
    bank.need(range(5))
    assert torch.equal(bank.frames[[1, 4]], some)
    goals = bank.goals
    assert torch.cdist(goals, parts(built)[1].goals).min() > 1e-4
    made.environment.close()


def test_no_two_episodes_of_an_evaluation_follow_the_same_plan(replanned: Built) -> None:
    """Where there are as many plans: episodes that repeat would make intervals too narrow."""
    for seed in range(5):
        replanned.environment.reset(seed=seed)
        assert sorted(field(replanned, "plan_row").tolist()) == [0, 1, 2]


def test_an_evaluation_elsewhere_waits_for_nothing(built: Built) -> None:
    """On a device that is not the CPU, as a GPU whose steps are captured: the bank is whole before, and nobody plans anew.
    Values of torch's device `meta` cannot be read."""
    context = replace(
        built.context, device=torch.device("meta"), evaluating=True,
        _shared={"gripping": built.context._shared["gripping"]},
    )  # fmt: skip
    made = Relocations(Relocations.Options(plans=2, refill=0), context)
    assert not made.bank._missing
    found = made.sample(WorldStreams(0, "starts", 4, context.device))
    assert found["qpos"].shape == (4, 57)
    Again(Again.Options(), context)
    with pytest.raises(ConfigError, match="device=cpu simulator=mujoco"):
        Again(Again.Options(most=1), context)


def test_plans_have_all_phases(built: Built) -> None:
    _, bank = parts(built)
    for row in range(5):
        length = int(bank.lengths[row])
        held = bank.frames[row, : length + 1, 15]
        assert held[0] == 0 == held[-1]
        assert 0.3 < float(held.sum()) / 100 < 3.0
    assert len(PHASES) == 4


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["scene.object=null"], "needs an object on the table"),
        (["scene.object.sizes=[1e-5]"], "scene.object.sizes=[1e-05] is not possible: it must be at least 0.001"),
        (["scene.object.sizes=[0.03]"], "none of table 5.2, where it is from 0.5 to 1 cm"),
        (["scene.object={kind: box, sizes: [0.01, 0.05, 0.01]}"], "A box with a length of 5 cm is none"),
        (["scene.object={kind: box, sizes: [0.01]}"], "kind=box has 3 of them"),
        (["scene.object.kind=cone"], "cone"),
        (["scene.object.kind=any"], "kind=any has 0 of them"),
        (["scene.below={kind: any, sizes: []}"], "worlds differ in the object alone"),
        (["initial_states.refill=5"], "give more plans than are refilled"),
        (["initial_states.harder=-1"], "harder=-1"),
        (["initial_states.shift=[0.05, -0.05]"], "the first is the lower one"),
        (["initial_states.shift=[0.0, 0.07]"], "from -0.06 to 0.06 m"),
        (["scene.below={kind: box, sizes: [0.02, 0.02, 0.02]}", "initial_states.relocations=2"], "stays there"),
        (["scene.below={kind: box, sizes: [0.03, 0.02, 0.02]}"], "none of table 5.2"),
        (["scene.below={kind: sphere, sizes: [0.01]}"], "Nothing stays upon a sphere"),
        (["scene.above={kind: box, sizes: [0.01, 0.01, 0.01]}"], "Nothing lies upon a sphere"),
        (["initial_states.thrown=true", "initial_states.relocations=2"], "lands out of reach"),
        (["initial_states.elsewhere=true"], "not possible with relocations=1"),
        (["initial_states.thrown=true", "scene.below={kind: box, sizes: [0.02, 0.02, 0.02]}"], "takes one object alone"),
        (["scene.object.rolling=-1"], "rolling=-1"),
        (["memory.again.most=-1"], "most=-1"),
        (["memory.again.patience=0"], "patience=0"),
        (["initial_states.longest=0.2"], "longest=0.2"),
        (["scene=hand/tri_finger"], "is one of a hand with 5 fingers"),
        (["scene.contact.noslip_iterations=5"], "noslip_iterations=5 is not possible"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(words: list[str], said: str, plugins: Plugins) -> None:
    with pytest.raises(UnderstudyError) as error:
        build_environment(load_experiment([*WORDS, *words], plugins))
    assert said in str(error.value)
    assert error.value.exit_status == 2


@pytest.mark.slow
def test_a_training_begins_and_ends(tmp_path: Path) -> None:
    words = [
        "train", "experiment=chopsticks/relocate_small", "num_worlds=4", "budget.samples=128",
        "initial_states.plans=3", "learner.rollout_steps=16", "learner.minibatches=2",
        "evaluation.episodes=4", "evaluation.final_episodes=4", "policy.hidden=[8]",
        f"run.dir={tmp_path / 'run'}", "run.video_seconds=0",
    ]  # fmt: skip
    assert main(words) == 0
    assert (tmp_path / "run" / "evaluation.json").is_file()
