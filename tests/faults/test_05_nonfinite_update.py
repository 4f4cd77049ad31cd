"""Fault 5: a NaN loss or gradient changes no weight, is dumped once, and stops a hopeless run."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from worlds import SMALL, assert_same_state, flat, make_training

from understudy.errors import TrainingError
from understudy.records import checkpoint
from understudy.running.training import Training
from understudy.setup.building import build_environment
from understudy.setup.plugins import Plugins
from understudy.setup.validation import validate
from understudy.task import Rollout
from understudy.testing.fake import FAKE_TASK
from understudy_ppo.learner import PPO
from understudy_reinforcement.policy import build_policy

#: 8 steps × 16 worlds / 32 = 4 minibatches × 2 epochs = 8 optimiser steps an iteration.
STEPS = 8
IGNORED = ("/learner/generator", "/learner/bad_steps", "/policy/log_deviation")


def spoil_rewards(training: Training, monkeypatch: pytest.MonkeyPatch) -> None:
    collect = training.job.collector.collect

    def spoiled(steps: int) -> Rollout:
        rollout = collect(steps)
        rollout.rewards[3, 5] = float("nan")
        return rollout

    monkeypatch.setattr(training.job.collector, "collect", spoiled)


def learned(training: Training) -> dict[str, torch.Tensor]:
    """Weights and optimiser moments; the normaliser and random streams go on."""
    state = flat(
        {
            "policy": dict(training.job.policy.named_parameters()),
            "learner": training.job.learner.state_dict(),
        }
    )
    return {k: torch.as_tensor(v).detach().clone() for k, v in state.items() if k not in IGNORED}


def test_loss(plugins: Plugins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    training = make_training(plugins, [*FAKE_TASK, *SMALL], tmp_path / "run")
    messages: list[str] = []
    training.reporter.message = messages.append
    training.iterate()
    training.job.policy.schedule(training.progress.samples)  # as the next iteration does
    before = learned(training)
    with monkeypatch.context() as patch:
        spoil_rewards(training, patch)
        row = training.iterate()
        assert_same_state(learned(training), before)
        assert row["skipped_steps"] == STEPS
        training.iterate()
        assert_same_state(learned(training), before)
    assert sorted(p.name for p in (tmp_path / "run/faults").iterdir()) == [
        "update.json",
        "update.safetensors",
    ]
    assert len(messages) == 1, messages
    assert "faults/update.json" in messages[0]
    assert training.iterate()["skipped_steps"] == 0, "it goes on when the numbers are sound again"
    with pytest.raises(AssertionError):
        assert_same_state(learned(training), before)


def test_gradient(plugins: Plugins) -> None:
    """The loss is finite and one gradient is not."""
    training = make_training(plugins, [*FAKE_TASK, *SMALL])
    training.iterate()
    training.job.policy.schedule(training.progress.samples)
    before = learned(training)
    weight = next(training.job.policy.actor_parameters())
    hook = weight.register_hook(
        lambda g: torch.where(torch.arange(g.numel()).view_as(g) == 0, float("nan"), g)
    )
    assert training.iterate()["skipped_steps"] == STEPS
    assert_same_state(learned(training), before)
    hook.remove()
    assert training.iterate()["skipped_steps"] == 0


def test_patience(plugins: Plugins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    training = make_training(
        plugins, [*FAKE_TASK, *SMALL, "+learner.patience=20"], tmp_path / "run"
    )
    spoil_rewards(training, monkeypatch)
    with pytest.raises(
        TrainingError, match=r"^\d+ optimiser steps in a row had a non-finite loss"
    ) as caught:
        training.train()
    assert caught.value.exit_status == 1
    assert "\n" not in str(caught.value)
    assert training.progress.iteration == 2, "in the third iteration, at step 4"
    checkpoint.load(tmp_path / "run/checkpoints/00000000")


@pytest.mark.parametrize(("patience", "survived"), [(STEPS, 0), (STEPS + 1, 1), (2 * STEPS, 1)])
def test_patience_is_exact(
    plugins: Plugins, monkeypatch: pytest.MonkeyPatch, patience: int, survived: int
) -> None:
    training = make_training(plugins, [*FAKE_TASK, *SMALL, f"+learner.patience={patience}"])
    spoil_rewards(training, monkeypatch)
    with pytest.raises(TrainingError):
        training.train()
    assert training.progress.iteration == survived


def test_sound_steps_reset_patience(plugins: Plugins, monkeypatch: pytest.MonkeyPatch) -> None:
    training = make_training(plugins, [*FAKE_TASK, *SMALL, "+learner.patience=9"])
    for _ in range(4):
        with monkeypatch.context() as patch:
            spoil_rewards(training, patch)
            training.iterate()
        training.iterate()


def test_dump_replays(plugins: Plugins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With model, minibatch and configuration of the dump, the loss is non-finite again."""
    training = make_training(plugins, [*FAKE_TASK, *SMALL], tmp_path / "run")
    training.iterate()
    spoil_rewards(training, monkeypatch)
    training.iterate()
    state, meta = checkpoint.load(tmp_path / "run/faults/update")
    experiment = validate(meta["config"], plugins.registry)
    context = build_environment(experiment).context
    policy = build_policy(experiment, context)
    policy.load_state_dict(state["policy"])
    learner = experiment.need("learner").build(context, policy)
    assert isinstance(learner, PPO)
    actor_loss, value_loss, *_ = learner.losses(state["minibatch"])
    assert not torch.isfinite(actor_loss)
    assert not torch.isfinite(value_loss)
