"""An episode's actions, kept by a harvest and played open loop from other starts."""

from __future__ import annotations

import json
from pathlib import Path

import miniatures
import pytest
import torch

from understudy.errors import ConfigError
from understudy.running.environment import Environment
from understudy.running.training import Training
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy_skills import bank

#: Decisions of an episode of 3 s.
_T = 30


@pytest.fixture(scope="module")
def place(built_on: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``one``, a bank of one state; ``run``, a policy whose episodes begin there; ``kept``, four of
    its episodes; ``reached``, successes of another."""
    place = tmp_path_factory.mktemp("replay")
    state = {name: value[:1] for name, value in bank.load(built_on / "bank").items()}
    bank.save(place / "one", state, {})
    begins = ("initial_states=bank", f"initial_states.file={place / 'one'}", "termination=null")
    small = (
        "budget.samples=1024",
        *miniatures.QUICK,
        "evaluation.success=null",
        "run.video_seconds=0",
    )
    miniatures.train("experiment=miniature/sleeve", *begins, *small, f"run.dir={place / 'run'}")
    harvest = (
        "job=harvest",
        f"job.run={place / 'run'}",
        "job.actions=true",
        "job.count=4",
        "job.ending=truncation",
    )
    miniatures.train(*harvest, "num_worlds=4", f"run.dir={place / 'kept'}")
    harvest = ("job=harvest", f"job.run={built_on / 'sleeve'}", "job.actions=true", "job.count=2")
    miniatures.train(*harvest, "num_worlds=8", f"run.dir={place / 'reached'}")
    return place


def replayed(place: Path, *more: str) -> Environment:
    file = f"file: {place / 'kept'}"
    own = f"actuation={{name: replay, run: {place / 'run'}, {file}, number: 2}}"
    begins = ("initial_states=bank", f"initial_states.file={place / 'one'}", "termination=null")
    words = [
        "experiment=miniature/sleeve",
        own,
        *begins,
        "evaluation.success=null",
        "num_worlds=2",
        *more,
    ]
    return build_environment(load_experiment(words)).environment


def test_from_the_same_start_it_comes_to_the_same_end(place: Path) -> None:
    """The harvest's own policy was sampled, so that each of its episodes is another, and nothing but the actions leads
    back to the end of one."""
    kept = bank.load(place / "kept")
    assert kept["actions"].shape == (4, _T, 2)
    ends = kept["positions"]
    assert len(torch.unique(ends, dim=0)) == 4
    environment = replayed(place)
    environment.reset(seed=7)
    for _ in range(_T - 1):
        environment.step(torch.randn(2, 1))  # which says nothing
    before = environment.table["positions"].clone()
    environment.advance(torch.randn(2, 1))
    after = environment.table["positions"]
    assert not torch.equal(before, after)
    torch.testing.assert_close(after, ends[2].expand_as(after))


def test_what_follows_the_last_action_is_that_action(place: Path) -> None:
    """They end early, in success."""
    actions = bank.load(place / "reached")["actions"]
    same = (actions[:, 1:] == actions[:, :-1]).all(dim=2)
    assert bool(same[:, -1].all())
    assert not bool(same[:, 0].any())
    for row in same:
        assert bool(row[int(row.nonzero()[0]) :].all()), "one of them goes on to the end"


def test_the_baseline_is_judged_from_other_starts(built_on: Path, place: Path) -> None:
    """As a command line: what succeeded from its start, from starts that vary."""
    own = f"actuation={{name: replay, run: {built_on / 'sleeve'}, file: {place / 'reached'}}}"
    given = (
        "experiment=miniature/sleeve",
        own,
        "job=judge",
        "job.run=null",
        "evaluation.final_episodes=16",
    )
    miniatures.train(*given, f"run.dir={place / 'judged'}", "run.video_seconds=0")
    found = json.loads((place / "judged" / "evaluation.json").read_text())
    assert found["episodes"] == 16
    assert found["measures"]["distance"]["spread"] > 0


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ("actuation.number=4", "has 4 episodes, counted from 0"),
        ("actuation.number=-1", "number"),
        ("control.decision=2", "Set control.decision=1"),
        ("actuation.file={one}", "has no actions of .*job.actions=true"),
    ],
)
def test_what_cannot_be_replayed_is_refused(place: Path, change: str, sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence):
        replayed(place, change.format(one=place / "one"))


def test_a_harvest_goes_on_within_episodes(place: Path) -> None:
    """What was decided before it was stopped is not forgotten."""
    words = ["experiment=miniature/sleeve", "job=harvest", f"job.run={place / 'run'}", "job.actions=true",
             "job.count=4", "job.ending=truncation", "job.decisions=20", "num_worlds=4"]  # fmt: skip
    straight, stopped, after = (Training(load_experiment(words)).prepare() for _ in range(3))
    for training in (straight, stopped):
        training.job.iterate(0)
    after.job.load_state_dict(stopped.job.state_dict())
    for training in (straight, after):
        training.job.iterate(0)
    kept = [t.job.state_dict()["found"]["actions"] for t in (straight, after)]
    assert torch.equal(*kept)
    for training in (straight, stopped, after):
        training.close()
