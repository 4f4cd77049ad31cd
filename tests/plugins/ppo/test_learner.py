from __future__ import annotations

import pytest
from worlds import assert_same_state, make_training

from understudy.running.training import Training
from understudy.setup.plugins import Plugins
from understudy.testing import check_plugin
from understudy.testing.fake import FAKE_TASK

TASK = (
    *FAKE_TASK,
    "+policy={name: mlp, hidden: [32], noise: {start: 0.5, end: 0.2}}",
    "+learner={name: ppo, actor_learning_rate: 0.003, critic_learning_rate: 0.003}",
    "num_worlds=64", "episode.seconds=3", "evaluation.criterion=null", "evaluation.episodes=32",
    "evaluation.seconds=5", "initial_states.name=fake.somewhere", "+initial_states.spread=2",
)  # fmt: skip


def test_plugin_conforms(plugins: Plugins) -> None:
    check_plugin("ppo", plugins)


def mean_reward(training: Training) -> float:
    return sum(training.iterate()["reward"] for _ in range(5)) / 5


@pytest.mark.parametrize(
    "more",
    [(), ("+policy.learn_noise=true",), ("+policy.activation=tanh", "+learner.td_lambda=0.8")],
)
def test_learns_to_stay_near(plugins: Plugins, more: tuple[str, ...]) -> None:
    training = make_training(plugins, [*TASK, *more])
    before = mean_reward(training)
    rows = [training.iterate() for _ in range(40)]
    assert mean_reward(training) > before + 0.05
    assert all(row["skipped_steps"] == 0 for row in rows)
    assert max(row["kl"] for row in rows) < 0.2
    assert rows[-1]["explained_variance"] > 0.5


def test_first_step_ratio_is_one(plugins: Plugins) -> None:
    """Old and new log-probabilities come from the same networks and normaliser."""
    training = make_training(plugins, [*TASK, "+learner.epochs=1", "+learner.minibatches=1"])
    for _ in range(3):
        row = training.iterate()
        assert abs(row["kl"]) < 1e-6
        assert row["clipped"] == 0


def test_learned_noise_changes_and_scheduled_noise_follows(plugins: Plugins) -> None:
    learned = make_training(plugins, [*TASK, "+policy.learn_noise=true"])
    scheduled = make_training(
        plugins, [*TASK, "policy.noise={start: 0.5, end: 0.2, samples: 2048}"]
    )
    for _ in range(4):
        learned.iterate(), scheduled.iterate()
    assert float(learned.policy.state_dict()["log_deviation"].exp()) != pytest.approx(0.5)
    assert float(scheduled.policy.state_dict()["log_deviation"].exp()) == pytest.approx(0.2)


def test_state_round_trip(plugins: Plugins) -> None:
    one, two = make_training(plugins, [*TASK]), make_training(plugins, [*TASK])
    one.iterate()
    two.load_state_dict(one.state_dict())
    assert_same_state(one.learner.state_dict(), two.learner.state_dict())


def test_the_rate_follows_the_divergence(plugins: Plugins) -> None:
    """From a rate that is far too low and one that is far too high, into the target's range."""
    for rate in (1e-5, 3e-2):
        training = make_training(
            plugins,
            [*TASK, f"learner.actor_learning_rate={rate}", "+learner.target_kl=0.01"],
        )
        rows = [training.iterate() for _ in range(30)]
        late = [row["kl"] for row in rows[-8:]]
        assert 0.003 < sum(late) / len(late) < 0.03
        assert rows[-1]["actor_learning_rate"] != pytest.approx(rate, rel=0.1)
