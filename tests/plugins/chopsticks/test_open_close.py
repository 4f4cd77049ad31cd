"""Open and close: the plan, the state, the rewards term by term, the endings, and what is refused."""

from __future__ import annotations

import math
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
from understudy.setup.building import Built, build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy.task import Context
from understudy_chopsticks.held_grip import Gripping
from understudy_chopsticks.plan import OpenAndClose, Plan, angle_at
from understudy_chopsticks.tracking import Hand, Tracking, contact, contact_lost, dropped, sticks
from understudy_gripping.grip import Grip, load_grip, standard
from understudy_gripping.hold import placed
from understudy_gripping.section import Grips
from understudy_hand.scene import HandScene
from understudy_hand.table import ARM_POSE
from understudy_hand.tools import upper_pose

TASK = ["task=chopsticks/open_close", "num_worlds=4"]


@pytest.fixture(scope="module")
def grip() -> Grip:
    return load_grip(standard())


@pytest.fixture(scope="module")
def built(plugins: Plugins) -> Any:
    built = build_environment(load_experiment(TASK, plugins))
    yield built
    built.environment.close()


def alone(worlds: int = 1) -> Context:
    return Context(0, torch.device("cpu"), worlds, control_dt=0.01, substeps=2)


def field(built: Built, name: str) -> Tensor:
    return built.environment.table[name]


def steps(built: Built, count: int, action: Tensor | None = None) -> list[Any]:
    action = torch.zeros(4, 36) if action is None else action
    return [built.environment.advance(action) for _ in range(count)]


# ------------------------------------------------------------------ the plan


def test_the_angle_begins_and_ends_at_0_and_its_rate_is_its_derivative() -> None:
    amplitude, rate = torch.tensor(0.12).double(), torch.tensor(2.0).double()
    times = torch.tensor([0.0, 0.1, 0.25, 0.4, 0.5]).double().requires_grad_(True)
    angle, turning = angle_at(amplitude, rate, times)
    (slope,) = torch.autograd.grad(angle.sum(), times)
    torch.testing.assert_close(turning, slope)
    assert angle.tolist() == pytest.approx([0.0, 0.12 * 0.5 * (1 - math.cos(0.4 * math.pi)), 0.12,
                                            0.12 * 0.5 * (1 - math.cos(1.6 * math.pi)), 0.0])  # fmt: skip


def test_the_plan_is_what_a_gripper_does(built: Built) -> None:
    """The upper stick turns about the lower one, which stays; a policy sees the next 0.3 s every 0.05 s."""
    built.environment.reset(seed=3)
    amplitude, rate = field(built, "motion_amplitude"), field(built, "motion_rate")
    now = steps(built, 12) and field(built, "episode_time").clone()
    angle, _ = angle_at(amplitude, rate, now)
    lower = field(built, "planned_lower")
    expected = torch.cat(upper_pose(lower[:, :3], lower[:, 3:], angle), 1)
    torch.testing.assert_close(field(built, "planned_upper"), expected)
    ahead = field(built, "plan_ahead")
    assert ahead.shape == (4, 6, 72 + 15)
    for frame in range(6):
        later, turning = angle_at(amplitude, rate, now + 0.05 * (frame + 1))
        torch.testing.assert_close(ahead[:, frame, 79], later)
        torch.testing.assert_close(ahead[:, frame, -1], turning)
        torch.testing.assert_close(ahead[:, frame, 72:79], lower)
        torch.testing.assert_close(ahead[:, frame, :7], field(built, "planned_arm"))


def test_planned_velocities_are_derivatives_of_planned_poses(built: Built) -> None:
    plan = Plan(None, built.context)
    times = torch.linspace(0.02, 0.6, 7)
    count = len(times)
    fields: dict[str, Tensor] = {
        "motion_amplitude": torch.full((count,), 0.11), "motion_rate": torch.full((count,), 1.0),
        "planned_arm": torch.tensor(ARM_POSE).expand(count, 7),
    }  # fmt: skip
    step = 1e-3
    here = plan.compute(**fields, episode_time=times)
    after, before = (
        plan.compute(**fields, episode_time=times + way * step)["planned_pose"] for way in (1, -1)
    )
    difference = (after - before) / (2 * step)
    torch.testing.assert_close(here["planned_velocity"], difference, atol=5e-3, rtol=0)
    assert difference[:, 7:].abs().max() > 0.02


def test_poses_between_the_grips_angles_are_between_its_poses(grip: Grip) -> None:
    made = Gripping(Grips({"one": grip}), HandScene(HandScene.Options()), alone())
    torch.testing.assert_close(made.at(made.poses, made.angles)[0], made.poses[0])
    middle = 0.5 * (made.angles[:-1] + made.angles[1:])
    expected = 0.5 * (made.poses[0, :-1] + made.poses[0, 1:])
    torch.testing.assert_close(made.at(made.poses, middle)[0], expected)


# ------------------------------------------------------------------ the state


def test_the_sticks_are_in_the_palms_frame(built: Built) -> None:
    """Positions, rotations, velocities against MuJoCo's own, with everything moving."""
    built.environment.reset(seed=1)
    noise = 0.05 * torch.randn(4, 36, generator=torch.Generator().manual_seed(0))
    steps(built, 6, noise)
    state, model = field(built, "stick_state"), built.scene.model  # type: ignore[attr-defined]
    data, velocity = mujoco.MjData(model), np.zeros((3, 6))
    data.qpos[:], data.qvel[:] = field(built, "qpos")[0], field(built, "qvel")[0]
    mujoco.mj_forward(model, data)
    bodies = [model.body(n).id for n in ("palm", "upper_stick", "lower_stick")]
    for row, body in enumerate(bodies):
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, velocity[row], 0)
    palm, turn = data.xpos[bodies[0]], data.xmat[bodies[0]].reshape(3, 3)
    spin, speed = velocity[0, :3], velocity[0, 3:]
    for row in (1, 2):
        away = data.xpos[bodies[row]] - palm
        found = state[0, row - 1].numpy()
        matrix = np.zeros(9)
        mujoco.mju_quat2Mat(matrix, found[3:7].astype(float))
        np.testing.assert_allclose(found[:3], turn.T @ away, atol=1e-6)
        own = data.xmat[bodies[row]].reshape(3, 3)
        np.testing.assert_allclose(matrix.reshape(3, 3), turn.T @ own, atol=1e-5)
        moved = velocity[row, 3:] - speed - np.cross(spin, away)
        np.testing.assert_allclose(found[7:10], turn.T @ moved, atol=1e-4)
        np.testing.assert_allclose(found[10:], turn.T @ (velocity[row, :3] - spin), atol=1e-4)


def test_the_angle_is_the_plans_where_the_sticks_are_planned(grip: Grip, built: Built) -> None:
    """Sticks that stand where a gripper at 0.1 rad has them are at 0.1 rad, and on their places."""
    scene = HandScene(HandScene.Options())
    row = 2
    data = placed(scene, np.array(ARM_POSE), grip.poses[row], grip.upper[row], grip.lower)
    tracking = Tracking(None, built.context)
    read = {
        name: torch.tensor(np.array(getattr(data, name)), dtype=torch.float32)[None]
        for name in ("xpos", "xquat", "cvel", "subtree_com", "geom_xpos", "geom_xmat")
    }
    found = tracking.compute(
        **read,
        planned_upper=torch.tensor(grip.upper[row], dtype=torch.float32)[None],
        planned_lower=torch.tensor(grip.lower, dtype=torch.float32)[None],
        planned_angle=torch.tensor([0.06]),
    )
    assert float(found["angle"]) == pytest.approx(grip.angles[row], abs=1e-5)
    assert float(found["angle_error"]) == pytest.approx(grip.angles[row] - 0.06, abs=1e-5)
    assert float(found["stick_distance"].max()) < 1e-6
    assert float(found["stick_turn"].max()) < 1e-5
    assert found["tip_distance"].shape == (1, 4)
    assert 1e-4 < float(found["tip_distance"].max()) < 2e-3  # the gap that the pose leaves


def test_the_state_has_all_of_table_5_1_but_the_object(plugins: Plugins, built: Built) -> None:
    full = 36 * 2 + 26 + 4 + 5 + 2 + 6 * (72 + 15)
    assert built.environment.observation_shapes["state"] == (full,)
    small = build_environment(
        load_experiment(["experiment=chopsticks/open_close_small", "num_worlds=2"], plugins)
    )
    assert small.environment.observation_shapes["state"] == (36 * 2 + 26 + 4 + 6 * 15,)
    small.environment.close()


def test_fingertips_feel_the_sticks(built: Built) -> None:
    built.environment.reset(seed=0)
    steps(built, 3)
    for name, finger in enumerate(("thumb", "index", "middle", "ring", "little")):
        force = field(built, f"sensor_touch_{finger}_distal")
        assert ((force > 0.3) == (name < 4)).all(), finger
    assert (field(built, "sensor_touch_upper_stick_tip") == 0).all()


# ------------------------------------------------------------------ rewards and endings


def test_rewards_are_the_equations_term_by_term(built: Built) -> None:
    distance = torch.tensor([[0.001, 0.002], [0.0, 0.0]])
    turn, spun = torch.tensor([[0.01, 0.03], [0.0, 0.0]]), torch.tensor([[0.2, 0.03], [0.0, 0.0]])
    found = sticks(distance, turn, spun)
    assert found.tolist() == pytest.approx([math.exp(-40 * 0.003 - 10 * 0.04), 1.0])
    assert float(sticks(distance, turn, spun, spin=True)[0]) == pytest.approx(
        math.exp(-40 * 0.003 - 10 * 0.23)
    )
    assert contact(torch.tensor([[0.001, 0.0, 0.004]])).tolist() == pytest.approx(
        [math.exp(-10 * 0.005)]
    )
    pose, planned = torch.zeros(1, 50), torch.zeros(1, 36)
    pose[0, 3], pose[0, 20], pose[0, 40] = 0.03, 0.04, 9.0  # of the sticks nothing counts
    hand = Hand(Hand.Options(), built.context)
    assert hand(pose, planned).tolist() == pytest.approx([math.exp(-10 * 0.05)])


def test_the_reward_is_their_product(built: Built) -> None:
    """Eq. 5.1: exp of the sum."""
    built.environment.reset(seed=0)
    step = steps(built, 9)[-1]
    terms = (
        Hand(Hand.Options(), built.context)(field(built, "qpos"), field(built, "planned_pose")),
        sticks(*(field(built, f"stick_{name}") for name in ("distance", "turn", "rotation"))),
        contact(field(built, "tip_distance")),
    )
    torch.testing.assert_close(step.rewards, terms[0] * terms[1] * terms[2])
    assert ((step.rewards > 0.2) & (step.rewards < 1.0)).all()


def test_a_stick_that_is_gone_ends_the_episode() -> None:
    assert dropped(torch.tensor([[0.0, 0.031], [0.029, 0.029]])).tolist() == [True, False]
    assert contact_lost(torch.tensor([[0.02, 0.016], [0.02, 0.014]])).tolist() == [True, False]


def test_a_grip_without_a_policy_keeps_both_sticks_and_one_let_go_does_not(built: Built) -> None:
    built.environment.reset(seed=0)
    assert not any(step.ended.any() for step in steps(built, 95))
    built.environment.reset(seed=0)
    open_hand = torch.zeros(4, 36)
    open_hand[:, 7:] = -1.0
    assert any(step.ended.all() for step in steps(built, 60, open_hand))


def test_zero_offsets_are_the_grips_targets(built: Built, grip: Grip) -> None:
    built.environment.reset(seed=0)
    steps(built, 1)
    expected = torch.tensor(grip.targets[0], dtype=torch.float32).expand(4, -1)
    torch.testing.assert_close(field(built, "ctrl")[:, 7:], expected)
    action = torch.zeros(4, 36)
    action[:, 2], action[:, 10] = 1.0, 0.05
    steps(built, 1, action)
    moved = field(built, "ctrl")
    torch.testing.assert_close(moved[:, 2], field(built, "planned_arm")[:, 2] + 0.1)
    torch.testing.assert_close(moved[:, 10], expected[:, 3] + 0.05)


def test_targets_of_the_plan_close_the_sticks_without_a_policy(plugins: Plugins) -> None:
    """By themselves a part of the way; those of the grip do not."""
    closed = {}
    for base in ("grip", "plan"):
        words = [f"actuation.base={base}", "initial_states.rate=[1, 1]"]
        made = build_environment(load_experiment([*TASK, *words], plugins))
        made.environment.reset(seed=0)
        seen = []
        for _ in range(70):
            steps(made, 1)
            seen.append(float(field(made, "angle").mean()))
        closed[base] = max(seen)
        made.environment.close()
    assert closed["plan"] > closed["grip"] + 0.02


def test_episodes_begin_in_every_direction_and_at_rest(plugins: Plugins) -> None:
    made = build_environment(load_experiment([*TASK[:1], "num_worlds=32"], plugins))
    made.environment.reset(seed=0)
    arms = field(made, "planned_arm")
    assert len(torch.unique(arms, dim=0)) == 3
    torch.testing.assert_close(field(made, "qpos")[:, :7], arms, atol=0.02, rtol=0)
    assert float(field(made, "stick_distance").max()) < 5e-3
    made.environment.close()


# ------------------------------------------------------------------ several grips in one job


def test_the_last_candidate_of_a_job_says_whose_its_worlds_are(grip: Grip) -> None:
    """Or the measure that judges it would read nothing; a grip that is no candidate says nothing."""
    scene = HandScene(HandScene.Options())
    assert Gripping(Grips({"s11120": grip}), scene, alone()).several
    assert not Gripping(Grips({"grip": grip}), scene, alone()).several


def test_each_world_has_its_own_grip(grip: Grip) -> None:
    """Of a style with fewer fingers; those that touch nothing are nowhere from their places."""
    other = replace(
        grip, style=(1, 1, 2, 0, 0), places=grip.places[:3], targets=grip.targets + 0.01
    )
    scene, context = HandScene(HandScene.Options()), alone(4)
    made = Gripping(Grips({"a": grip, "b": other}, {"c": "too far"}), scene, context)
    assert made.touching == ("thumb", "index", "middle", "ring")
    targets, _ = made.at(made.targets, torch.tensor([0.0, 0.0, 0.08, 0.08]))
    expected = torch.tensor(grip.targets[[0, 0, 2, 2]], dtype=torch.float32)
    expected[1::2] += 0.01
    torch.testing.assert_close(targets, expected)
    many, _ = made.at(made.poses, torch.full((4, 6), 0.05))
    assert many.shape == (4, 6, 29)
    context.scene, context.sections = scene, {"grip": Grips({"a": grip, "b": other})}
    tracking = Tracking(None, context)
    data = placed(scene, np.array(ARM_POSE), grip.poses[0], grip.upper[0], grip.lower)
    read = {
        name: torch.tensor(np.array(getattr(data, name)), dtype=torch.float32).repeat(4, *[1] * getattr(data, name).ndim)
        for name in ("xpos", "xquat", "cvel", "subtree_com", "geom_xpos", "geom_xmat")
    }  # fmt: skip
    planned = {f"planned_{n}": torch.tensor(v, dtype=torch.float32).repeat(4, 1) for n, v in (("upper", grip.upper[0]), ("lower", grip.lower))}  # fmt: skip
    found = tracking.compute(**read, **planned, planned_angle=torch.zeros(4))["tip_distance"]
    assert (found[1::2, 3] == 0).all()
    assert (found[::2] < 2e-3).all()
    assert (found[1::2, 2] > 3e-3).all(), (
        "the middle finger is at the upper stick, not at the lower one"
    )


def test_a_candidate_that_falls_where_the_arm_begins_is_left_out_alone(
    grip: Grip, plugins: Plugins
) -> None:
    """With the arm at its own pose it holds: that it was found there says nothing of others."""
    weak = replace(grip, targets=grip.poses + 0.6 * (grip.targets - grip.poses))
    experiment = load_experiment(TASK, plugins)
    scene = HandScene(HandScene.Options())
    Gripping(Grips({"grip": weak}), scene, alone())
    with pytest.raises(ConfigError, match="The grip 11120 does not hold the sticks"):
        build_environment(experiment, sections={"grip": Grips({"grip": weak})})
    both = Grips({"a": grip, "b": weak, "c": grip})
    built = build_environment(experiment, sections={"grip": both})
    built.environment.reset()
    assert list(both.by_name) == ["a", "c"]
    assert "with the arm at" in both.against["b"]
    assert field(built, "from_b").tolist() == [0, 0, 0, 0]
    assert field(built, "from_c").tolist() == [0, 1, 0, 1]
    built.environment.close()
    with pytest.raises(ConfigError, match="No candidate holds the sticks"):
        build_environment(experiment, sections={"grip": Grips({"a": weak, "b": weak})})
    with pytest.raises(ConfigError, match="The grip 11120 does not hold"):  # its policy sees two
        build_environment(experiment, sections={"grip": Grips({"a": grip, "b": weak}, begun=True)})


# ------------------------------------------------------------------ bad input


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["scene=hand/tri_finger"], "The grip 11120 is one of a hand with 5 fingers"),
        (["scene=hand/large"], "finger_length 1 and size 2. Find one: understudy grip STYLE FILE"),
        (["scene=hand/tongs"], "the scene has tongs"),
        (["grip.name=standart"], "There is no grip 'standart'"),
        (["grip.file=nowhere.json"], "nowhere.json"),
        (["initial_states.amplitude=[0, 0.3]"], "the grip closes by 0.15 rad"),
        (["initial_states.amplitude=[0.1, 0.05]"], "the first is the lower one"),
        (["initial_states.rate=[50.0, 200.0]"], "must be at most 10"),
        (["initial_states.arms=[]"], "give at least one"),
        (["initial_states.arms=[[9, 0, 0, 0, 0, 0, 0]]"], "beyond the arm's range"),
        (["scene=character", "scene.character=humanoid"], "needs a scene of type HandScene"),
        (
            [
                "scene.contact.cone=pyramidal",
                "scene.contact.impratio=1",
                "scene.contact.solref=[0.02, 1]",
                "scene.contact.solimp=[0.9, 0.95, 0.001]",
            ],
            "The grip 11120 does not hold the sticks",
        ),
        (["scene.contact.noslip_iterations=5"], "noslip_iterations=5 is not possible"),
    ],
)
def test_what_cannot_be_is_refused(words: list[str], said: str, plugins: Plugins) -> None:
    with pytest.raises(UnderstudyError) as error:
        build_environment(load_experiment([*TASK, *words], plugins))
    assert said in str(error.value)
    assert error.value.exit_status == 2


def test_a_training_begins_and_ends(tmp_path: Path) -> None:
    words = [
        "train", "experiment=chopsticks/open_close_small", "num_worlds=4", "budget.samples=256",
        "learner.rollout_steps=16", "learner.minibatches=2", "evaluation.episodes=4",
        "evaluation.final_episodes=4", "evaluation.seconds=1", "run.video_seconds=1",
        "policy.hidden=[8]", f"run.dir={tmp_path / 'run'}",
    ]  # fmt: skip
    assert main(words) == 0
    assert (tmp_path / "run" / "report.html").is_file()


def test_the_options_have_their_own_checks() -> None:
    with pytest.raises(ValueError, match="amplitude"):
        OpenAndClose.Options(amplitude=(-0.1, 0.1))


def test_another_hands_grip_names_both(grip: Grip) -> None:
    with pytest.raises(ConfigError, match="--fingers 3 --finger-length 1 --size 1"):
        Gripping(Grips({"one": grip}), HandScene(HandScene.Options(fingers=3)), alone())
