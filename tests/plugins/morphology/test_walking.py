"""The task: what is rewarded, observed and measured, and that it runs on both MuJoCo simulators."""

from __future__ import annotations

import copy
import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from worlds import SMALL, assert_same_state, make_training

from understudy.errors import ConfigError, UnderstudyError
from understudy.random import WorldStreams
from understudy.running.environment import Environment
from understudy.running.training import Training
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy.task import Context
from understudy.testing import check_plugin
from understudy_morphology.figure import Scales
from understudy_morphology.scene import WalkerScene
from understudy_morphology.walking import Gait, Standing, Worth, fallen, normalised

DT = 0.0165


def environment(plugins: Plugins, *overrides: str, evaluating: bool = False) -> Environment:
    experiment = load_experiment(["task=morphology/walk", "num_worlds=4", *overrides], plugins)
    built = build_environment(experiment, evaluating=evaluating)
    built.environment.reset(seed=0)
    return built.environment


def test_the_plugin_conforms(plugins: Plugins) -> None:
    check_plugin("morphology", plugins)


def test_the_experiment_is_that_of_the_paper(plugins: Plugins) -> None:
    """Section 6.4.1."""
    experiment = load_experiment(["experiment=morphology/walk"], plugins)
    root, learner = experiment.root, experiment.need("learner").options
    policy = experiment.need("policy").options
    assert (policy.hidden, policy.activation) == ((128, 128, 128), "tanh")
    assert (learner.gamma, learner.gae_lambda, learner.td_lambda) == (0.95, 0.95, 0.95)
    assert (learner.actor_learning_rate, learner.critic_learning_rate) == (3e-4, 3e-4)
    samples = root.num_worlds * learner.rollout_steps
    assert root.num_worlds == 10
    assert samples == pytest.approx(4096, abs=10)
    assert samples // learner.minibatches == 256
    assert root.episode.seconds == root.evaluation.seconds == 8.25
    assert root.episode.seconds * root.control.frequency == pytest.approx(500)
    assert root.evaluation.objective == "normalised_return"


def test_an_episode_is_500_decisions(plugins: Plugins) -> None:
    env = environment(plugins, "termination=null")
    for _ in range(499):
        assert not env.advance(torch.zeros(4, 15)).truncated.any()
    assert env.advance(torch.zeros(4, 15)).truncated.all()


def test_the_reward_by_hand(plugins: Plugins) -> None:
    env = environment(plugins)
    table = env.table
    for _ in range(20):
        step = env.advance(0.3 * torch.ones(4, 15))
    qpos, qvel, ctrl = (table[name].numpy() for name in ("qpos", "qvel", "ctrl"))
    scene = WalkerScene(Scales())
    data = mujoco.MjData(scene.model)
    for world in range(4):
        data.qpos[:] = qpos[world]
        mujoco.mj_kinematics(scene.model, data)
        torso = data.body("torso").xmat.reshape(3, 3)
        lean, turn = math.acos(torso[2, 2]), math.atan2(torso[1, 0], torso[0, 0])
        penalties = 3 * abs(float(table["slowness"][world])) + 3 * abs(qpos[world, 1])
        expected = 4 - penalties - 0.4 * np.abs(ctrl[world, :15]).sum() - lean - abs(turn)
        assert float(step.rewards[world]) == pytest.approx(expected, abs=1e-4)
        assert float(table["forward_velocity"][world]) == qvel[world, 0]


def test_slowness_is_a_mean_that_forgets(plugins: Plugins) -> None:
    env = environment(plugins)
    expected = env.table["slowness"].clone()
    share = 1 - math.exp(-DT / 0.5)
    for _ in range(10):
        env.advance(torch.zeros(4, 15))
        now = env.table["target_velocity"] - env.table["qvel"][:, 0]
        expected = (1 - share) * expected + share * now
        torch.testing.assert_close(env.table["slowness"], expected)


def test_worth_counts_what_its_options_weigh() -> None:
    context = Context(0, torch.device("cpu"), 1, DT, 4)
    options = Worth.Options(alive=1.0, velocity=2.0, energy=3.0, sideways=4.0, upright=5.0)
    one = torch.ones(1)
    given = {"slowness": -0.1, "effort": 0.2, "sideways": -0.3, "lean": 0.4, "turn": -0.5}
    found = Worth(options, context).compute(**{name: x * one for name, x in given.items()})
    assert float(found["worth"]) == pytest.approx(1 - 0.2 - 0.6 - 1.2 - 4.5)


@pytest.mark.parametrize("roll", [0.0, 0.3])
@pytest.mark.parametrize("pitch", [0.0, 0.5])
def test_clearance_is_of_the_lowest_corner(roll: float, pitch: float) -> None:
    scene = WalkerScene(Scales(foot_length=1.3, foot_radius=0.8))
    model, data = scene.model, mujoco.MjData(scene.model)
    data.joint("left_ankle_y").qpos, data.joint("left_ankle_x").qpos = pitch, roll
    data.joint("right_hip_y").qpos = 0.7
    mujoco.mj_forward(model, data)
    names = ("qpos", "qvel", "xquat", "geom_xpos", "geom_xmat")
    fields = {n: torch.tensor(getattr(data, n)[None], dtype=torch.float32) for n in names}
    context = Context(0, torch.device("cpu"), 1, DT, 4, scene=scene)
    found = Gait(None, context).compute(**fields, action=torch.zeros(1, 15))["clearance"]
    for i, name in enumerate(("left_foot", "right_foot")):
        geom, half = data.geom(name), model.geom(name).size
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8)
        corners = geom.xpos[:, None] + geom.xmat.reshape(3, 3) @ (signs * half[:, None])
        assert float(found[0, i]) == pytest.approx(corners[2].min(), abs=1e-6)


def test_falling_is_low_leaning_or_turned() -> None:
    height, lean = torch.tensor([1.0, 0.5, 1.0, 1.0]), torch.tensor([0.1, 0.1, 1.2, 0.1])
    turn = torch.tensor([-0.1, 0.0, 0.0, -1.2])
    assert fallen(height, lean, turn).tolist() == [False, True, True, True]


def test_the_objective_is_the_return_over_500(plugins: Plugins) -> None:
    """Eq. 6.4: episodes that end by a fall are divided by T too."""
    assert float(normalised(torch.tensor(3.0))) == pytest.approx(3 / 500)
    training = make_training(
        plugins,
        [
            "experiment=morphology/walk", "num_worlds=4", "learner.rollout_steps=16",
            "evaluation.episodes=4", "evaluation.final_episodes=4",
        ],
    )  # fmt: skip
    found = training.job.evaluate("test", 4)
    training.close()
    assert found is not None
    assert found.mean_episode_seconds is not None
    assert found.mean_episode_seconds < 2.0
    assert found.objective_value == pytest.approx(found.measures["return"].mean / 500, rel=1e-5)


@pytest.mark.parametrize("difficulty", [0.0, 0.4, 1.0])
def test_evaluations_have_the_help_of_the_difficulty(plugins: Plugins, difficulty: float) -> None:
    env = environment(plugins, f"difficulty={difficulty}", evaluating=True)
    for _ in range(3):
        assert env.table["assistance"].tolist() == pytest.approx([200 * (1 - difficulty)] * 4)
        env.advance(torch.zeros(4, 15))


def test_trainings_have_the_help_of_the_lesson(plugins: Plugins) -> None:
    """The episodes that begin later: the running ones keep theirs."""
    env = environment(plugins)
    assert env.table["assistance"].tolist() == [200.0] * 4
    env.parts.curriculum._move(0.75)  # type: ignore[union-attr]
    env.begin(torch.tensor([True, False, True, False]))
    assert env.table["assistance"].tolist() == [50.0, 200.0, 50.0, 200.0]


def test_full_help_keeps_it_from_falling_for_longer(plugins: Plugins) -> None:
    """Knees a little stiff, nothing else: an inverted pendulum, held or not."""

    def seconds(difficulty: float) -> float:
        env = environment(plugins, f"difficulty={difficulty}", evaluating=True)
        lasted = torch.zeros(4)
        standing = torch.ones(4, dtype=torch.bool)
        for _ in range(200):
            angles, rates = env.table["qpos"][:, 7:], env.table["qvel"][:, 6:]
            standing &= ~env.advance(-2.0 * angles - 0.05 * rates).failed
            lasted += DT * standing
        return float(lasted.mean())

    assert seconds(0.0) > 1.3 * seconds(1.0)


def test_episodes_begin_standing_a_little_disturbed() -> None:
    scene = WalkerScene(Scales())
    context = Context(0, torch.device("cpu"), 64, DT, 4, scene=scene)
    states = Standing(Standing.Options(noise=0.05), context)
    found = states.sample(WorldStreams(0, "test", 64, "cpu"))
    qpos, qvel = found["qpos"], found["qvel"]
    assert (qpos[:, :7] == torch.tensor(scene.model.qpos0[:7], dtype=torch.float32)).all()
    limits = torch.tensor(scene.model.jnt_range[1:], dtype=torch.float32)
    assert (qpos[:, 7:] >= limits[:, 0]).all()
    assert (qpos[:, 7:] <= limits[:, 1]).all()
    for values in (qpos[:, 7:], qvel):
        assert values.abs().max() <= 0.05
        assert values.abs().max() > 0.045
    assert qvel.mean(dim=0).abs().max() < 0.02


@pytest.mark.parametrize("scales", [(), ("scene.thigh_length=1.7", "scene.torso_radius=0.6")])
def test_both_simulators_agree(plugins: Plugins, scales: tuple[str, ...]) -> None:
    """Ten decisions with full help, in float64 and in float32."""
    if "mujoco_warp" not in plugins.registry.names("simulator"):
        pytest.skip("the plugin mujoco_warp is not among those in use")
    pytest.importorskip("mujoco_warp", reason="MuJoCo Warp is not installed")
    seen = []
    for simulator in ("mujoco", "mujoco_warp"):
        env = environment(
            plugins, f"simulator={simulator}", "device=cpu", "num_worlds=2", "difficulty=0", *scales
        )
        generator = torch.Generator().manual_seed(0)
        for _ in range(10):
            step = env.advance(0.2 * torch.randn(2, 15, generator=generator))
        seen.append((env.table["qpos"].clone(), step.observations["state"].clone()))
        env.close()
    torch.testing.assert_close(*(qpos for qpos, _ in seen), atol=2e-3, rtol=0)
    torch.testing.assert_close(*(observed for _, observed in seen), atol=2e-2, rtol=0)


def test_a_training_learns_and_resumes_exactly(plugins: Plugins) -> None:
    """Also in the middle of a lesson, of an episode and of a mean."""
    overrides = [
        "task=morphology/walk",
        *SMALL,
        "learner.rollout_steps=40",
        "scene.knee_length=1.2",
    ]
    whole = make_training(plugins, overrides)
    before = [p.clone() for p in whole.job.policy.parameters()]  # type: ignore[attr-defined]
    assert whole.iterate()["skipped_steps"] == 0
    after = list(whole.job.policy.parameters())  # type: ignore[attr-defined]
    assert any(not torch.equal(a, b) for a, b in zip(before, after, strict=True))
    curriculum = whole.job.environment.parts.curriculum  # type: ignore[attr-defined]
    assert curriculum.stage() == "help 100%"
    assert curriculum.state_dict()["sums"].any()
    continued = make_training(plugins, overrides)
    continued.load_state_dict(copy.deepcopy(whole.state_dict()))
    for training in (whole, continued):
        training.iterate()
    assert_same_state(whole.state_dict(), continued.state_dict())
    whole.close()
    continued.close()


def test_it_is_seen_from_the_side() -> None:
    """As a picture with the walker in its middle, where there is OpenGL, and as stick figures."""
    scene = WalkerScene(Scales())
    qpos = np.stack([scene.model.qpos0, scene.model.qpos0])
    qpos[1, 0] = 3.0
    segments, reference = scene.outlines({"qpos": qpos})
    assert segments is not None
    assert segments.shape == (2, 8, 2, 3)
    assert reference is None
    np.testing.assert_allclose(
        segments[1] - segments[0], np.tile([3.0, 0, 0], (8, 2, 1)), atol=1e-9
    )
    try:
        pictures = list(scene.draw({"qpos": qpos}, 160, 120))
    except UnderstudyError as error:
        pytest.skip(str(error))
    for picture in pictures:  # the camera goes along
        assert picture.shape == (120, 160, 3)
        blue = (picture[..., 2].astype(int) - picture[..., 0] > 40).mean(axis=0)
        assert blue[60:100].mean() > 0.02 > 4 * blue[:40].mean()


def test_it_is_no_task_for_another_figure(plugins: Plugins, tmp_path: Path) -> None:
    file = tmp_path / "ball.xml"
    ball = "<body><freejoint/><geom size='.1'/></body>"
    file.write_text(f"<mujoco><worldbody>{ball}</worldbody></mujoco>")
    with pytest.raises(ConfigError, match="needs a scene of type WalkerScene"):
        environment(plugins, "scene=mjcf", f"scene.file={file}")


@pytest.mark.gpu
def test_the_step_is_recorded_and_goes_on(plugins: Plugins) -> None:
    """On a GPU, with the curriculum moving between replays."""
    experiment = load_experiment(
        [
            "experiment=morphology/walk", "simulator=mujoco_warp", "num_worlds=256",
            "learner.rollout_steps=16", "evaluation.episodes=64",
        ],
        plugins,
    )  # fmt: skip
    training = Training(experiment).prepare()
    for _ in range(8):
        training.iterate()
    env = training.job.environment  # type: ignore[attr-defined]
    assert env.captured_step.on
    env.parts.curriculum._move(0.75)
    worlds = torch.ones(256, dtype=torch.bool, device=env.device)
    env.begin(worlds)
    training.iterate()
    young = env.table["episode_time"] < 2.9
    assert env.table["assistance"][young].cpu().tolist() == [50.0] * int(young.sum())
    evaluation = training.job.evaluate("test", 64)
    assert evaluation is not None
    assert evaluation.objective_value is not None
    training.close()
