"""The learner as a part of a run: what it refuses, that it goes on exactly, that it learns."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
import torch
from imagined_walk import WALK
from worlds import assert_same_state, make_training, resumed

from understudy.errors import ConfigError
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy.testing import check_plugin
from understudy.testing.capture import nothing_waits
from understudy_imagination.learner import AnnealOptions, Imagination
from understudy_imagination.replay import Replay
from understudy_reinforcement.job import Reinforcement


def test_plugin_conforms(plugins: Plugins) -> None:
    check_plugin("imagination", plugins)


def iterate(job: Reinforcement, count: int, samples: int = 0) -> list[dict[str, float]]:
    rows = []
    for _ in range(count):
        rows.append(job.iterate(samples))
        samples += int(rows[-1]["consumed"])
    return rows


def test_resuming_is_exact(plugins: Plugins, tmp_path: Path) -> None:
    """Stopped while the replay fills, and once it has begun to lose what is old."""
    whole = make_training(plugins, WALK, tmp_path / "whole")
    length = len(list(islice(whole.rows(), 6)))
    assert length == 6
    for stop in (1, 5):
        cut = make_training(plugins, WALK, tmp_path / str(stop))
        rows = cut.rows()
        for _ in range(stop):
            next(rows)
        rows.close()
        cut.save()
        cut.close()
        assert cut.run is not None
        cut.run.unlock()
        again = resumed(plugins, tmp_path / str(stop))
        list(islice(again.rows(), 6 - stop))
        ours, theirs = again.job.state_dict(), whole.job.state_dict()
        assert_same_state(ours, theirs)
        again.close()
    whole.close()


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("replay", "rows", "inputs"), torch.zeros(3, 2)),
        (("window", "actions"), torch.zeros(4, 9, 28)),
        (("model", "near"), torch.full((8,), 10**6)),
    ],
    ids=["replay", "window", "points"],
)
def test_a_strangers_checkpoint_is_refused(
    job: Callable[..., Reinforcement], path: tuple[str, ...], value: torch.Tensor
) -> None:
    made = job()
    iterate(made, 1)
    state: Any = made.learner.state_dict()
    inner = state
    for name in path[:-1]:
        inner = inner[name]
    inner[path[-1]] = value
    with pytest.raises((ValueError, RuntimeError)):
        job().learner.load_state_dict(state)


def test_seeds_differ_and_repeat(job: Callable[..., Reinforcement]) -> None:
    one, two, other = job("seed=1"), job("seed=1"), job("seed=2")
    for made in (one, two, other):
        iterate(made, 3)
    assert_same_state(one.state_dict(), two.state_dict())
    ours, theirs = (dict(made.policy.state_dict()) for made in (one, other))
    assert any(not torch.equal(ours[name], theirs[name]) for name in ours)


def test_a_world_whose_numbers_went_wrong_costs_only_itself(
    job: Callable[..., Reinforcement],
) -> None:
    """No step is skipped for it, and what is reported is of the others."""
    made = job()
    for samples in (0, 32, 64):
        made.policy.schedule(samples)
        rollout = made.collector.collect(made.learner.rollout_steps)
        rollout.next_fields["qpos"][3, 1] = torch.nan
        rollout.next_fields["qvel"][5, 2] = torch.inf
        rollout.terminated[3, 1] = rollout.terminated[5, 2] = True
        row = made.learner.update(rollout)
        assert {k: v for k, v in row.items() if not math.isfinite(v)} == {}
        assert row["skipped_steps"] == 0
    assert "cost" in row
    for name, weights in made.policy.state_dict().items():
        assert torch.as_tensor(weights).isfinite().all(), name


def test_nothing_is_learned_before_there_is_enough(job: Callable[..., Reinforcement]) -> None:
    made = job()
    rows = iterate(made, 3)
    assert ["model_loss" in row for row in rows] == [False, True, True]
    assert all(row["skipped_steps"] == 0 for row in rows)


def test_actions_move_by_the_step(job: Callable[..., Reinforcement]) -> None:
    """Regressed for long onto one batch, the policy moves by about what it is asked to."""
    made = job("learner.updates=400", "learner.step=0.2", "policy.feedback.hidden=[128]")
    row = iterate(made, 2)[-1]
    assert row["step"] == pytest.approx(0.2)
    assert 0.1 < row["moved"] < 0.25


def test_steps_shrink_with_samples() -> None:
    anneal = AnnealOptions(after=100, samples=50, least=0.2)
    assert [anneal.at(n) for n in (0, 100, 150, 200, 10_000)] == pytest.approx(
        [1.0, 1.0, 1 / 2, 1 / 3, 0.2]
    )


def test_a_field_of_contact_forces_is_refused_by_name(refusal: Callable[..., str]) -> None:
    sentence = refusal(
        "+termination.terms.hard={name: beyond, limit: 1e9, reads: {value: qfrc_constraint}}"
    )
    assert "'qfrc_constraint'" in sentence
    assert "termination.terms.hard" in sentence
    assert "learner=ppo" in sentence


def test_a_former_value_is_refused(refusal: Callable[..., str]) -> None:
    sentence = refusal("termination.terms.com.reads={com_position: previous_com_position}")
    assert "'previous_com_position'" in sentence


def test_a_critic_may_know_what_is_not_imagined(
    job: Callable[..., Reinforcement], refusal: Callable[..., str]
) -> None:
    """An encoder that reads a former value: the critic's alone is accepted, the actor's is refused."""
    former = (
        "+encoder.former={name: spacetime/feedforward,"
        " reads: {reference_joint_targets: previous_reference_joint_targets}}"
    )
    made = job(former, "policy.feedback.critic=[state, former]")
    learner = made.learner
    assert isinstance(learner, Imagination)
    iterate(made, 3)
    found = learner.adjoint(learner._window)  # type: ignore[arg-type]
    assert set(found.observations) == {"state", "feedforward"}
    sentence = refusal(former, "policy.feedback.observation=[state, former]")
    assert "'previous_reference_joint_targets'" in sentence
    assert "encoder.former" in sentence


def test_an_actor_may_see_several_observations(job: Callable[..., Reinforcement]) -> None:
    made = job(
        "+encoder.again={name: spacetime/feedforward}", "policy.feedback.observation=[state, again]"
    )
    rows = iterate(made, 3)
    assert "cost" in rows[-1]
    assert rows[-1]["skipped_steps"] == 0


def test_a_task_without_anything_to_differentiate_is_refused(refusal: Callable[..., str]) -> None:
    bounds = ("com", "root", "joints", "end_effectors", "fall")
    sentence = refusal(*(f"~termination.terms.{name}" for name in bounds), "evaluation.failures=[]")
    assert "needs" in sentence
    assert "derivative" in sentence


def test_what_is_to_be_reached_is_not_kept_away_from(job: Callable[..., Reinforcement]) -> None:
    """A margin that ends an episode as a success or merely cuts it costs nothing."""
    made = job("termination.terms.com.outcome=success", "termination.terms.root.outcome=report")
    learner = made.learner
    assert isinstance(learner, Imagination)
    assert [term.name for term in learner.adjoint._imagined.margins] == [
        "root", "joints", "end_effectors", "fall",
    ]  # fmt: skip
    assert "termination.terms.com" in learner.flat


def test_terms_without_a_derivative_are_named(job: Callable[..., Reinforcement]) -> None:
    learner = job().learner
    assert isinstance(learner, Imagination)
    assert learner.flat == ("termination.terms.motion_end", "reward.terms.survival")


def test_the_replay_keeps_the_newest() -> None:
    replay = Replay(5, 2, 1, torch.device("cpu"))
    rows = torch.arange(16.0).view(8, 2)
    for part in rows.split(3):
        replay.add(part, part.sum(1, keepdim=True))
    inputs, targets = replay.sound()
    assert sorted(inputs[:, 0].tolist()) == [6.0, 8.0, 10.0, 12.0, 14.0]
    assert torch.equal(targets, inputs.sum(1, keepdim=True))
    other = Replay(5, 2, 1, torch.device("cpu"))
    other.load_state_dict(replay.state_dict())
    assert_same_state(other.state_dict(), replay.state_dict())


def test_the_replay_counts_what_it_does_not_keep() -> None:
    """Steps shrink with all decisions that there were, of an iteration larger than the replay too."""
    replay = Replay(5, 1, 1, torch.device("cpu"))
    for first in (0.0, 8.0):
        rows = first + torch.arange(8.0).view(8, 1)
        replay.add(rows, rows)
    assert replay.seen == 16
    assert sorted(replay.sound()[0][:, 0].tolist()) == [11.0, 12.0, 13.0, 14.0, 15.0]
    with pytest.raises(ValueError, match="replay"):
        replay.load_state_dict({**replay.state_dict(), "seen": -1})


def test_rows_that_are_not_finite_do_not_count() -> None:
    replay = Replay(4, 1, 1, torch.device("cpu"))
    replay.add(torch.tensor([[1.0], [torch.nan], [3.0]]), torch.tensor([[1.0], [2.0], [torch.inf]]))
    assert [rows.tolist() for rows in replay.sound()] == [[[1.0]], [[1.0]]]
    inputs, targets, counts = replay.draw(50, torch.Generator().manual_seed(0))
    assert inputs.isfinite().all()
    assert targets.isfinite().all()
    assert set(counts.tolist()) == {0.0, 1.0}


def test_a_replay_of_another_size_is_refused() -> None:
    replay = Replay(4, 1, 1, torch.device("cpu"))
    replay.add(torch.zeros(4, 1), torch.zeros(4, 1))
    with pytest.raises(ValueError, match="replay"):
        Replay(4, 2, 1, torch.device("cpu")).load_state_dict(replay.state_dict())
    with pytest.raises(ValueError, match="replay"):
        Replay(3, 1, 1, torch.device("cpu")).load_state_dict(replay.state_dict())


def test_on_a_gpu_steps_can_be_captured(
    job: Callable[..., Reinforcement], monkeypatch: pytest.MonkeyPatch
) -> None:
    watched: list[str] = []

    def watch(owner: object, name: str) -> None:
        method = getattr(owner, name)

        def call(*args: object) -> object:
            watched.append(name)
            with nothing_waits():
                return method(*args)

        monkeypatch.setattr(owner, name, call)

    one = job()
    learner = one.learner
    assert isinstance(learner, Imagination)
    watch(learner, "_take_step")
    watch(learner.adjoint, "_step_back")
    learner._capture()
    for samples in (0, 32, 64, 96):
        one.iterate(samples)
    assert set(watched) == {"_take_step", "_step_back"}


def test_a_learner_without_a_goal_is_refused() -> None:
    """With neither weight the policy learned small actions alone."""
    words = ["experiment=spacetime/walk_imagined", "learner.margin_weight=0"]
    load_experiment(words)
    with pytest.raises(ConfigError, match=r"margin_weight=0 is not possible with reward_weight=0"):
        load_experiment([*words, "learner.reward_weight=0"])
