"""References of low quality, and characters that are no person."""

from __future__ import annotations

import pytest

from understudy.running.training import Training
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy.testing import check_environment
from understudy_characters.character import load_character
from understudy_reinforcement.job import Reinforcement


def test_key_frames_can_be_learned_from() -> None:
    chosen = ["experiment=spacetime/walk", "motion.name=walk", "motion.keys=5", "num_worlds=4"]
    check_environment(build_environment(load_experiment(chosen)).environment)


def test_a_robot_of_hinges_takes_the_clip_as_it_is(plugins: Plugins) -> None:
    """Its ball joints are three hinges each, and its proportions no person's."""
    robot = load_character("revolute", plugins.registry)
    person = load_character("humanoid", plugins.registry)
    assert set(robot.joint_names) == set(person.joint_names)
    assert all(len(joint.axes) > 0 for joint in robot.joints[1:])
    reach = {
        c.name: {n: abs(o[2]) for n, o in zip(c.joint_names, c.skeleton.offsets, strict=True)}
        for c in (robot, person)
    }
    assert reach["revolute"]["left_knee"] < 0.9 * reach["humanoid"]["left_knee"]
    assert reach["revolute"]["left_elbow"] > 1.1 * reach["humanoid"]["left_elbow"]
    overrides = ["experiment=spacetime/walk", "scene.character=revolute", "num_worlds=8"]
    built = build_environment(load_experiment(overrides))
    check_environment(built.environment, steps=6)
    environment = built.environment
    environment.reset(0)
    before = environment.table["joint_rotations"]
    wanted = environment.table["reference_joint_rotations"]
    assert (before * wanted).sum(-1).abs().min() > 1 - 1e-4, "hinges make all of the poses"


def test_the_baseline_is_deepmimic_in_everything_but_the_skill() -> None:
    plain = load_experiment(["experiment=spacetime/run", "motion.name=run"])
    other = load_experiment(["experiment=spacetime/run", "motion.name=run", "+baseline=deepmimic"])
    ours, theirs = plain.effective(), other.effective()
    for same in ("scene", "motion", "learner", "budget", "evaluation", "control", "num_worlds"):
        assert ours[same] == theirs[same]
    assert set(theirs["reward"]["terms"]) == {"pose", "velocity", "end_effectors", "com"}
    outcomes = {k: v["outcome"] for k, v in theirs["termination"]["terms"].items()}
    assert [k for k, v in outcomes.items() if v == "failure"] == ["fall"]
    assert theirs["policy"]["name"] == "mlp"
    assert theirs["initial_states"]["name"] == "characters/reference_states"


@pytest.mark.parametrize(
    "more",
    [
        ("+baseline=deepmimic",),
        ("+style=measured", "+baseline=deepmimic"),
        ("reward.terms.imitation.name=deepmimic/imitation", "termination=spacetime/reported"),
        ("policy.feedforward=null",),
    ],
)
def test_what_it_is_compared_with_trains(more: tuple[str, ...]) -> None:
    chosen = ["experiment=spacetime/walk", "num_worlds=8", "learner.rollout_steps=8"]
    training = Training(load_experiment([*chosen, "learner.minibatches=4", *more])).prepare()
    row = training.iterate()
    assert 0.0 < row["reward"] <= 1.0
    assert isinstance(training.job, Reinforcement)
    policy = training.job.policy
    environment = training.job.environment
    if "policy.feedforward=null" in more:
        mean = policy.distribution(environment.observations).mode()
        assert mean.abs().max() < 0.2, "an untrained network alone stands for no pose"
    training.close()
