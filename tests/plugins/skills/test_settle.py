"""Starts that come to rest without a policy, and are kept for others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch

from understudy.errors import ConfigError, TrainingError
from understudy.running.training import Training
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy_skills import bank
from understudy_training.workflow import train

#: Points at rest that nobody pushes; those less than 1 m from the place end at once.
REST = [
    "experiment=miniature/sleeve", "job=settle", "num_worlds=32", "termination.terms.reached.within=1.0",
    "job.count=40", "job.seconds=0.5", "seed=3", "run.video_seconds=0",
]  # fmt: skip


def settled(folder: Path, *more: str) -> Path:
    train([*REST, f"run.dir={folder}", *more])
    return folder


def test_what_ends_is_discarded_and_the_rest_is_kept(tmp_path: Path) -> None:
    run = settled(tmp_path / "rest", "job.fields=[drag]")
    states = bank.load(run)
    assert {len(value) for value in states.values()} == {40}
    distance = (states["positions"][:, 0] - torch.tensor([1.5, 0.0])).norm(dim=1)
    assert distance.min() > 1.0, "nearer ones ended"
    assert len(torch.unique(distance)) > 35, "each from a start of its own"
    environment = build_environment(
        load_experiment(
            [
                "experiment=miniature/sleeve",
                "initial_states=bank",
                f"initial_states.file={run}",
                "num_worlds=8",
            ]
        )
    ).environment
    environment.reset(seed=0)
    assert environment.table["distance"].min() > 1.0
    environment.close()


def test_it_simulates_for_as_long_as_it_is_told(tmp_path: Path) -> None:
    training = Training(load_experiment([*REST, f"run.dir={tmp_path / 'one'}"])).prepare()
    job: Any = training.job
    row = job.iterate(0)
    assert row["consumed"] == 5 * 32
    assert 0 < row["discarded"] < 1
    assert row["states"] == 32 * (1 - row["discarded"])
    assert job.stage() == f"{row['states']} of 40 states"
    saved = job.state_dict()
    first = job.iterate(0)["states"]
    job.load_state_dict(saved)
    assert job.iterate(0)["states"] == first, "it goes on as if it had never stopped"
    training.close()


def test_what_cannot_be_is_said(tmp_path: Path) -> None:
    everywhere = ["termination.terms.reached.within=9.0", "job.patience=2"]
    with pytest.raises(TrainingError, match=r"No episode of this task lasts 0\.5 s"):
        settled(tmp_path / "none", *everywhere)
    with pytest.raises(
        ConfigError, match=r"job\.fields names 'distanc', which is no field.*'distance'"
    ):
        Training(load_experiment([*REST, "job.fields=[distanc]"])).prepare()
    with pytest.raises(ConfigError, match=r"seconds"):
        load_experiment([*REST, "job.seconds=0"])
