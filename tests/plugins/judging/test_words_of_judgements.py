"""Words that follow `understudy evaluate RUN`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from understudy.command.cli import main


@pytest.mark.parametrize("command", ["evaluate", "render"])
@pytest.mark.parametrize(
    "word",
    ["run.dir=elsewhere", "+run.dir=elsewhere", "start.run=x", "start={run: x}", "~start", "budget.samples=3",
     "checkpoint.keep=3", "outer_loop=grid", "executor.workers=2", "learner.gamma=0.5", "learner=trpo",
     "resolution.substeps=2", "evaluation.criterion=0.5", "evaluation.every_samples=1"],
)  # fmt: skip
def test_what_changes_trainings_alone_is_refused(
    word: str, command: str, built_on: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was taken, and made no difference: run.dir wrote nothing there."""
    before = sorted((built_on / "go").rglob("*"))
    assert main([command, str(built_on / "go"), word]) == 2
    assert (
        f"{word} changes a training, and nothing of a judgement: leave it out."
        in capsys.readouterr().err
    )
    assert sorted((built_on / "go").rglob("*")) == before


@pytest.mark.parametrize(
    ("words", "episodes", "told"),
    [(["evaluation.episodes=3"], 8, True), (["episodes=3"], 3, False),
     (["episodes=3", "evaluation.episodes=3"], 3, False)],
)  # fmt: skip
def test_that_episodes_at_once_are_not_those_in_all_is_said(
    words: list[str], episodes: int, told: bool, built_on: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of `evaluation.episodes=3`, eight were judged, and nothing was said."""
    assert main(["evaluate", str(built_on / "go"), "half_step=false", *words]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["episodes"] == episodes
    sentence = "evaluation.episodes=3 says how many run at once here, and 8 are judged: episodes=3"
    assert (sentence in said.err) == told


@pytest.mark.parametrize("command", ["evaluate", "render"])
@pytest.mark.parametrize("word", ["chair={}", "poses={name: miniature/arcs}", "episode.seconds=2"])
def test_what_nothing_reads_is_named(
    command: str, word: str, built_on: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was taken as another evaluation, with a file of its own."""
    assert main([command, str(built_on / "go"), word]) == 0
    key = word.partition("=")[0].partition(".")[0]
    told = f"{word} changes nothing: no part of this run reads {key}."
    assert told in capsys.readouterr().err
