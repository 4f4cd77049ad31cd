"""The tasks as they are composed, and that they run, learn and resume."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from worlds import SMALL, assert_same_state, make_training

from understudy.command.cli import main
from understudy.errors import ConfigError
from understudy.running.environment import Environment
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy.testing import check_plugin
from understudy_characters.scene import CharacterScene
from understudy_jumping.arena import Arena
from understudy_jumping.curriculum import Accumulated
from understudy_reinforcement.evaluation import Measured
from understudy_skills import bank

#: f_control = 10 + 20 ρ Hz where ρ is 0, 0.5 and 1: bars of 0.5, 0.75 and 1 m, boxes of 0, 0.5 and 1 m.
RATES = {0.0: 10.0, 0.5: 20.0, 1.0: 30.0}


def environment(plugins: Plugins, *overrides: str, evaluating: bool = False) -> Environment:
    experiment = load_experiment(["num_worlds=4", *overrides], plugins)
    built = build_environment(experiment, evaluating=evaluating)
    built.environment.reset(seed=0)
    return built.environment


def test_the_plugin_conforms(plugins: Plugins) -> None:
    check_plugin("jumping", plugins)


@pytest.mark.parametrize(("task", "low", "high"), [("high", 0.5, 2.0), ("obstacle", 0.05, 2.5)])
def test_rates_and_obstacles_are_those_of_the_paper(
    plugins: Plugins, task: str, low: float, high: float
) -> None:
    """Table 4.1, and the schedule of the control rate."""
    experiment = load_experiment([f"experiment=jumping/{task}"], plugins)
    arena = experiment.sections["arena"]
    sizes = arena.height if task == "high" else arena.width
    assert sizes == (low, high)
    curriculum = experiment.need("curriculum").options
    assert isinstance(curriculum, Accumulated.Options)
    assert curriculum.threshold == {"high": 30.0, "obstacle": 50.0}[task]
    step = {"high": 0.01, "obstacle": 0.05}[task]
    assert curriculum.step * (high - low) == pytest.approx(step, rel=1e-5)
    frequency = experiment.root.control.frequency
    assert frequency * experiment.root.control.substeps == 600
    for rho, rate in RATES.items():
        size = 0.5 + 0.5 * rho if task == "high" else max(rho, 0.05)
        difficulty = (size - low) / (high - low)
        found = Arena(arena).rho(torch.tensor([difficulty]))
        assert float(found) == pytest.approx(
            max(rho, 0.05 if task == "obstacle" else 0.0), abs=1e-5
        )
        reached = [n for at, n in curriculum.decision if at <= difficulty + 1e-4]
        assert frequency / reached[-1] == rate
    learner = experiment.need("learner").options
    assert (learner.gamma, learner.gae_lambda, learner.epochs) == (1.0, 0.95, 5)
    assert experiment.root.num_worlds * learner.rollout_steps == 4096
    assert 4096 // learner.minibatches == 256


def test_the_mat_is_lower_than_the_bar_and_behind_it(plugins: Plugins) -> None:
    for difficulty, height, mat in ((0.0, 0.5, 0.1), (0.4, 1.1, 0.4), (1.0, 2.0, 0.75)):
        env = environment(plugins, "task=jumping/high", f"difficulty={difficulty}", evaluating=True)
        np.testing.assert_allclose(env.table["obstacle_height"], height, rtol=1e-6)
        np.testing.assert_allclose(env.table["mat_height"], mat, rtol=1e-5)
        np.testing.assert_allclose(env.table["mocap_pos/mat"][:, 2], mat, rtol=1e-5)
        assert float(env.table["mocap_pos/mat"][0, 0]) == pytest.approx(0.02 + 0.02 + 2.5)
        assert env.decision == {0.0: 6, 0.4: 2, 1.0: 2}[difficulty]
        env.close()


def test_it_begins_as_far_from_the_bar_as_the_schedule_says(plugins: Plugins) -> None:
    for difficulty, distance in ((0.0, 0.8), (1 / 6, 1.0), (0.9, 1.2)):
        env = environment(plugins, "task=jumping/high", f"difficulty={difficulty}", evaluating=True)
        np.testing.assert_allclose(env.table["qpos"][:, 0], -distance, rtol=1e-5)
        env.close()
    env = environment(plugins, "task=jumping/obstacle", "difficulty=0", evaluating=True)
    np.testing.assert_allclose(env.table["qpos"][:, 0], -1.62, atol=1e-3)  # ρ = 0.05
    env.close()


def test_a_jump_that_does_nothing_ends_within_two_seconds(plugins: Plugins) -> None:
    env = environment(plugins, "task=jumping/high", "control.substeps=5", "difficulty=1")
    ended = torch.zeros(4, dtype=torch.bool)
    for _ in range(60):
        step = env.step(torch.zeros(4, env.action_size))
        assert float(step.rewards.max()) == 0.0
        assert not step.truncated.any()
        ended |= step.failed
    assert ended.all(), "each world, within 60 decisions of 1/30 s"
    env.close()


def test_worlds_are_divided_among_take_offs(plugins: Plugins) -> None:
    env = environment(plugins, "experiment=jumping/high_many", "num_worlds=12")
    np.testing.assert_array_equal(env.table["from_straddle"], 2 * [0, 0, 0, 0, 1, 0])
    features = env.table["takeoff_features"]
    np.testing.assert_allclose(features[4], [-2.21, 1.0, -3.0, 0.88, 1.65])
    np.testing.assert_array_equal(features[:6], features[6:])
    size = env.observation_shapes["state"][0]
    assert size == 3 + 2 + 15 * 15 + 5
    np.testing.assert_array_equal(env.observations["state"][:, -5:], features)
    heights = env.measure()
    assert {"fosbury", "straddle", "western_roll"} <= heights.keys()
    assert heights["straddle"].isnan().sum() == 10
    env.close()


def test_observations_are_of_the_world(plugins: Plugins) -> None:
    """Of another approach the same movement is seen turned, not the same; links' velocities are
    MuJoCo's."""
    env = environment(plugins, "task=jumping/high", "initial_states.noise=0.0", "num_worlds=1")
    scene = env.parts.simulator
    model = scene.model  # type: ignore[attr-defined]
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = env.table["qpos"][0], env.table["qvel"][0]
    mujoco.mj_forward(model, data)
    seen = env.observations["state"][0]
    np.testing.assert_allclose(seen[:3], data.qpos[:3], atol=1e-6)
    links = [b for b in range(1, model.nbody) if model.body(b).name not in ("mat", "obstacle")]
    linear, angular = np.zeros((2, len(links), 3))
    for row, body in enumerate(links):
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, velocity, 0)
        angular[row], linear[row] = velocity[:3], velocity[3:]
    parts = seen[5:].split([45, 90, 45, 45])
    np.testing.assert_allclose(parts[2], linear.ravel(), atol=1e-3)
    np.testing.assert_allclose(parts[3], angular.ravel(), atol=1e-3)
    env.close()


def test_variations_are_what_they_say(plugins: Plugins) -> None:
    """Section 4.7.2."""

    def scene_of(*overrides: str) -> tuple[CharacterScene, Environment]:
        experiment = load_experiment(["num_worlds=1", *overrides], plugins)
        built = build_environment(experiment)
        assert isinstance(built.scene, CharacterScene)
        return built.scene, built.environment

    strong, env = scene_of("experiment=jumping/high")
    env.close()
    weak, env = scene_of("experiment=jumping/weak_leg")
    env.close()
    names = [strong.model.actuator(i).name for i in range(strong.model.nu)]
    for i, name in enumerate(names):
        share = 0.6 if name.startswith(("right_hip", "right_knee", "right_ankle")) else 1.0
        expected = share * strong.model.actuator_forcerange[i]
        np.testing.assert_allclose(weak.model.actuator_forcerange[i], expected)
    mars, env = scene_of("experiment=jumping/mars")
    assert mars.model.opt.gravity[2] == -3.711
    env.close()
    experiment = load_experiment(["experiment=jumping/landing_on_feet"], plugins)
    (attempt,) = (c for c in experiment.many("memory") if c.name == "attempt")
    assert attempt.options.landing == "feet"
    assert experiment.need("initial_states").options.takeoff.omega_z == -0.26


@pytest.fixture(scope="module")
def poses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of a small pose auto-encoder."""
    folder = tmp_path_factory.mktemp("poses") / "run"
    small = ["job.clips=[walk]", "job.latent=4", "job.hidden=[16,16]", "budget.samples=2000"]
    quick = ["evaluation.episodes=8", "evaluation.final_episodes=8", f"run.dir={folder}"]
    assert main(["train", "experiment=pose_vae/generated", *small, *quick]) == 0
    return folder


@pytest.mark.parametrize("by", ["jumping/targets", "jumping/poses"])
def test_a_stiff_spine_and_a_fixed_knee_hold_whatever_acts(
    plugins: Plugins, poses: Path, by: str
) -> None:
    """Section 4.7.2; only the spine's bending backwards, or the swing leg's knee, differs."""
    chosen = [] if by == "jumping/targets" else [f"actuation={by}", f"actuation.run={poses}"]

    def reached(name: str) -> dict[str, tuple[float, float]]:
        """By servo, the lowest and the highest target."""
        env = environment(plugins, f"experiment=jumping/{name}", "num_worlds=1", *chosen)
        model = env.parts.simulator.model  # type: ignore[attr-defined]
        names = [model.actuator(i).name for i in range(model.nu)]
        found = []
        for far in (-9.0, 9.0):
            action = torch.zeros(1, env.action_size)
            action[:, -28:] = far  # of poses the offsets
            found.append(env.parts.actuation.part.control(action)[0].tolist())
        env.close()
        return dict(zip(names, zip(*found, strict=True), strict=True))

    free = reached("high")
    stiff, fixed = reached("stiff_spine"), reached("fixed_knee")
    assert free["chest_y"][0] < -0.5
    assert stiff["chest_y"][0] == 0.0
    assert stiff["chest_y"][1] == pytest.approx(min(free["chest_y"][1], np.pi))
    assert fixed["left_knee"] == pytest.approx((1.6, 1.6), abs=0.002)
    assert {n for n in free if stiff[n] != free[n]} == {"chest_y"}
    assert {n for n in free if fixed[n] != free[n]} == {"left_knee"}


def test_attempts_that_never_cross_show_no_strategy(plugins: Plugins) -> None:
    """Means over attempts leave them out; before, they counted as lying on their backs."""
    env = environment(
        plugins, "task=jumping/high", "control.substeps=5", "initial_states.noise=0.0"
    )
    names = [name for name in env.measure() if name.startswith("strategy_")]
    assert len(names) == 6 + 1
    starts = env.parts.initial_states
    begin = starts.sample

    def moved(*given: Any, **fields: Any) -> dict[str, torch.Tensor]:
        """The last two worlds begin behind the bar, high above it."""
        states = begin(*given, **fields)
        states["qpos"][2:, 0] += 3.0
        states["qpos"][2:, 2] += 3.0
        return states

    starts.sample = moved  # type: ignore[method-assign]
    env.reset(seed=0)
    env.step(torch.zeros(4, env.action_size))
    found = {name: value for name, value in env.measure().items() if name in names}
    for value in found.values():
        assert value[:2].isnan().all()
        assert value[2:].isfinite().all()
    angle = found["strategy_angle"]
    assert float(angle[2]) > 1.0, "it stands upright"
    assert Measured.of("last", angle).mean == pytest.approx(float(angle[2:].mean()))
    # neither a step's rewards nor the statistics of episodes are made of measures
    for _ in range(20):
        step = env.step(torch.zeros(4, env.action_size))
        assert step.rewards.isfinite().all()
        assert not step.unsound.any()
    assert all(np.isfinite(list(env.statistics.collect().values())))
    env.close()


def test_an_evaluation_in_which_nobody_crosses_is_written(plugins: Plugins) -> None:
    training = make_training(
        plugins, ["task=jumping/high", *SMALL, "num_worlds=4", "control.substeps=5",
                  "learner.rollout_steps=4", "evaluation.episodes=4"],
    )  # fmt: skip
    row = training.job.evaluate("here", 4).as_json(0)
    assert json.dumps(row, allow_nan=False), "of no attempt at all"
    assert row["measures"]["strategy_angle"]["mean"] is None, "0 would be: on its back"
    training.close()


@pytest.mark.parametrize("name", ["high", "obstacle", "high_novel", "obstacle_novel"])
def test_searches_wait_where_a_bar_has_come_to_its_target(plugins: Plugins, name: str) -> None:
    words = [f"search=jumping/{name}", "simulator=mujoco", "difficulty=0.2"]
    if name.endswith("_novel"):
        words.append("outer_loop.search=runs/high")
    experiment = load_experiment(words, plugins)
    search = experiment.need("outer_loop").options
    assert search.stalled.until == 0.2
    assert set(search.features) <= {c.name for c in experiment.many("measure")}
    if name.endswith("_novel"):
        bar = experiment.need("curriculum").options
        learner = experiment.need("learner").options
        samples = experiment.root.num_worlds * learner.rollout_steps
        first = 4096 * bar.threshold / 0.01  # samples until the bar rises, of the highest reward
        assert samples < first < search.stalled.samples


def test_a_training_learns_and_resumes_exactly(plugins: Plugins) -> None:
    """In the middle of an episode, with random starts, a bar that rises and another control rate."""
    overrides = [
        "task=jumping/high", *SMALL, "num_worlds=8", "control.substeps=5",
        "learner.rollout_steps=12", "curriculum.threshold=1e-9", "curriculum.step=0.1",
        # so that something is rewarded at once
        "arena.height=[0.01,2.0]", "policy.noise={start: 0.5, end: 0.5}",
        "reward.terms.complete={name: jumping/spin}",
    ]  # fmt: skip
    whole = make_training(plugins, overrides)
    environment = whole.job.environment  # type: ignore[attr-defined]
    assert environment.decision == 6
    before = [p.clone() for p in whole.job.policy.parameters()]  # type: ignore[attr-defined]
    for _ in range(2):
        assert whole.iterate()["skipped_steps"] == 0
    after = list(whole.job.policy.parameters())  # type: ignore[attr-defined]
    assert any(not torch.equal(a, b) for a, b in zip(before, after, strict=True))
    assert environment.decision == 3, "the bar has risen, and with it the control rate"
    assert (environment.episode_step > 0).any(), "in the middle of episodes"
    continued = make_training(plugins, overrides)
    continued.load_state_dict(copy.deepcopy(whole.state_dict()))
    for _ in range(2):
        for training in (whole, continued):
            training.iterate()
    assert_same_state(whole.state_dict(), continued.state_dict())
    whole.close()
    continued.close()


def test_a_jump_begins_where_a_run_up_ended(plugins: Plugins, tmp_path: Path) -> None:
    """A bank's states, turned to the approach, at the bar."""
    env = environment(
        plugins, "task=jumping/high", "initial_states.takeoff.alpha=1.0", "initial_states.noise=0.0"
    )
    states = {name: env.table[name].clone() for name in ("qpos", "qvel")}
    env.close()
    states["qpos"][:, :2] += 7.0
    bank.save(tmp_path / "bank", states, {})
    given = f"initial_states={{name: jumping/harvested, file: {tmp_path / 'bank'}, alpha: 0.3}}"
    there = environment(
        plugins, "task=jumping/high", "initial_states=null", f"+{given}", evaluating=False
    )
    straight = environment(
        plugins, "task=jumping/high", "initial_states.takeoff.alpha=0.3", "initial_states.noise=0.0"
    )
    for name, tolerance in (("qpos", 0.03), ("qvel", 0.2)):
        # the heading of a leaning root is not quite that of the take-off
        np.testing.assert_allclose(there.table[name], straight.table[name], atol=tolerance)
    np.testing.assert_allclose(
        there.table["takeoff_features"], straight.table["takeoff_features"], atol=0.15
    )
    given = given.replace("}", ", spread: 0.2}")
    spread = environment(
        plugins,
        "task=jumping/high",
        "initial_states=null",
        f"+{given}",
        "num_worlds=64",
        evaluating=False,
    )
    away = spread.table["qpos"][:, 0] - there.table["qpos"][0, 0]
    assert -0.2 <= float(away.min()) < -0.15
    assert 0.15 < float(away.max()) <= 0.2
    for each in (there, straight, spread):
        each.close()


def test_a_bank_of_another_figure_is_refused(plugins: Plugins, tmp_path: Path) -> None:
    bank.save(tmp_path / "bank", {"qpos": torch.zeros(2, 9), "qvel": torch.zeros(2, 8)}, {})
    given = f"initial_states={{name: jumping/harvested, file: {tmp_path / 'bank'}}}"
    with pytest.raises(ConfigError, match="no states of this athlete"):
        environment(plugins, "task=jumping/high", "initial_states=null", f"+{given}")


@pytest.mark.parametrize("task", ["high", "obstacle"])
def test_poses_as_action_space_by_a_word(plugins: Plugins, task: str) -> None:
    """What is natural then is how small the offsets are (eq. 4.3), not how near targets are."""
    given = [f"task=jumping/{task}", "actuation=jumping/poses", "actuation.run=runs/poses"]
    for words, name, read in (
        (given[:1], "jumping/targets", "target_offset"),
        (given, "pose_vae/offset", "offset_norm"),
    ):
        experiment = load_experiment(words, plugins)
        assert experiment.need("actuation").component.name == name
        (offset,) = (c for c in experiment.many("memory") if c.name == "offset")
        assert offset.extras["reads"] == {"value": read}
    with pytest.raises(ConfigError, match=r"actuation\.run"):
        load_experiment(given[:2], plugins)


def test_a_joint_that_has_no_range_is_named(plugins: Plugins) -> None:
    with pytest.raises(ConfigError, match="there is no joint 'tail'"):
        environment(plugins, "task=jumping/high", "+actuation.ranges={tail: [[0.0, 1.0]]}")


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("memory.attempt.take_off=right_foot", "Did you mean"),
        ("curriculum.decision=[[0.0,-2]]", "1 control period or more"),
        ("curriculum.decision=[[0.3,2],[0.0,6]]", "rising"),
        ("curriculum.groups=5", "more than there are worlds"),
        ("arena.height=[-1.0,2.0]", "give 0 or more"),
        ("arena.height=[0.5,10.0]", "nobody gets over 10 m at gravity=9.81; give at most 4"),
        ("arena.width=[0.02,100.0]", "nobody gets over 100 m"),
        ("arena.mat_height=[3.0,5.0]", "the mat would be higher than the obstacle"),
        ("arena.mat=0.01", "at least 0.5"),
        ("initial_states.takeoff.v_z=1000", "at most 20"),
        ("initial_states.takeoff.omega_x=1000", "at most 50"),
        ("initial_states.distance.near=100", "at most 20"),
        ("initial_states.noise=10", "at most 1"),
        ("actuation.rest.left_knee=[1.0,0.5]", "servos turn left_knee about 1"),
        (
            "actuation.rest.left_knee=[3.2]",
            r"rest\.left_knee=\[3\.2\] .* 3\.2 rad is beyond the range of its targets, -0\.5 to 3",
        ),
        (
            "actuation.rest.chest=[0.0,-1.2]",
            r"-1\.2 rad is beyond .* -1\.1 to 1\.3",
        ),
    ],
)
def test_what_no_training_could_do_is_refused(plugins: Plugins, words: str, sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence):
        environment(plugins, "task=jumping/high", words, "num_worlds=4")


def test_names_of_take_offs_stay_theirs(plugins: Plugins) -> None:
    """One more, whose name comes before the others', changes no measure of those."""
    env = environment(
        plugins, "experiment=jumping/high_many", "num_worlds=7", "curriculum.groups=7",
        "+initial_states.others.a={v_z: -1.2, alpha: 0.8}",
    )  # fmt: skip
    (row,) = env.table["from_straddle"].nonzero().flatten().tolist()
    np.testing.assert_allclose(env.table["takeoff_features"][row], [-2.21, 1.0, -3.0, 0.88, 1.65])
    assert env.measure()["straddle"].isnan().tolist() == [k != row for k in range(7)]
    env.close()


def test_the_bar_is_drawn_where_it_is(plugins: Plugins) -> None:
    env = environment(plugins, "task=jumping/high")
    experiment = load_experiment(["task=jumping/high", "num_worlds=1"], plugins)
    scene = build_environment(experiment).scene
    assert isinstance(scene, CharacterScene)
    assert set(scene.recorded) >= {"qpos", "obstacle_height", "mat_height"}
    model = scene.shown().compile()
    data = mujoco.MjData(model)
    arena = Arena(experiment.sections["arena"])
    frame = {"obstacle_height": 1.5, "obstacle_width": 0.1, "mat_height": 0.6}
    arena.place(model, data, {name: np.array(value) for name, value in frame.items()})
    mujoco.mj_kinematics(model, data)
    box, mat = model.geom("obstacle").id, model.geom("mat").id
    assert data.geom_xpos[box, 2] + model.geom_size[box, 2] == pytest.approx(1.5)
    assert data.geom_xpos[box, 2] == pytest.approx(model.geom_size[box, 2]), "from the ground up"
    assert data.geom_xpos[mat, 2] + model.geom_size[mat, 2] == pytest.approx(0.6)
    assert data.geom_xpos[mat, 0] - model.geom_size[mat, 0] == pytest.approx(0.12)
    env.close()
