"""A learner that is told the clip's servo targets: by itself, and in a training."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from understudy.command.cli import main
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.task import Rollout
from understudy_reinforcement.policy import build_policy
from understudy_sitting.cloning import AfterClip

WORDS = ("experiment=sitting/sit_after_clip", "num_worlds=4")


def learner(**options: int) -> tuple[AfterClip, torch.Tensor]:
    """One of four worlds, and the size of what is seen."""
    experiment = load_experiment(list(WORDS))
    built = build_environment(experiment)
    built.environment.close()
    policy = build_policy(experiment, built.context)
    return AfterClip(AfterClip.Options(**options), built.context, policy), torch.zeros(2, 4, 57)


def rollout(seen: torch.Tensor, targets: torch.Tensor) -> Rollout:
    """Two decisions of four worlds."""
    flat = torch.zeros(seen.shape[:2])
    none = flat.bool()
    return Rollout(
        observations={"state": seen}, last_observations={"state": seen[-1]}, actions=targets,
        log_probs=flat, rewards=flat, terminated=none, truncated=none, failed=none,
        final_values=flat, episode_returns=flat, fields={"reference_joint_targets": targets},
    )  # fmt: skip


def test_its_mode_becomes_what_the_clip_asks_for() -> None:
    """Two states, two sets of targets: afterwards the mode in each is its own, in the actuation's units."""
    made, seen = learner(batch_size=64)
    seen[1] = 1.0
    unit = torch.stack([torch.full((21,), -0.7), torch.full((21,), 1.3)])[:, None].expand(2, 4, 21)
    targets = made._middle + made._unit * unit
    errors = [made.update(rollout(seen, targets))["target_error"] for _ in range(20)]
    assert errors[-1] < 0.01 < errors[0]
    mode = made.policy.distribution({"state": seen}).mode()
    assert mode.detach().numpy() == pytest.approx(unit.numpy(), abs=0.2)


def test_it_forgets_all_but_the_newest_iterations() -> None:
    made, seen = learner(keep=2, steps=1, batch_size=8)
    for _ in range(4):
        made.update(rollout(seen, torch.zeros(2, 4, 21)))
    assert len(made._seen) == 2


def test_what_is_not_finite_changes_nothing_and_counts() -> None:
    made, seen = learner(steps=3, batch_size=8)
    before = [p.clone() for p in made.policy.actor_parameters()]
    found = made.update(rollout(seen, torch.full((2, 4, 21), torch.nan)))
    assert found["skipped_steps"] == 3.0
    after = made.policy.actor_parameters()
    assert all(torch.equal(a, b) for a, b in zip(before, after, strict=True))


def test_it_trains_and_goes_on(tmp_path: Path) -> None:
    run = tmp_path / "run"
    words = ["evaluation.episodes=2", "evaluation.final_episodes=2", "evaluation.seconds=0.2", "run.video_seconds=0"]  # fmt: skip
    assert main(["train", *WORDS, *words, "budget.samples=128", f"run.dir={run}"]) == 0
    assert main(["resume", str(run), "budget.samples=256"]) == 0
    rows = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    assert rows[-1]["samples"] == 256
