"""Words of a command line that nothing in a training reads."""

from __future__ import annotations

from pathlib import Path

import pytest

from understudy.command.cli import main

GO = (
    "experiment=miniature/go",
    "num_worlds=8",
    "budget.samples=128",
    "evaluation.final_episodes=2",
    "evaluation.seconds=0.2",
    "run.video_seconds=0",
)


@pytest.mark.parametrize(
    ("word", "key"),
    [
        ("scenes.other={name: miniature/plane}", "scenes"),
        ("simulators={other: {name: miniature/plane}}", "simulators"),
        ("poses={name: miniature/arcs}", "poses"),
        ("chair={}", "chair"),
        ("outer_loop={name: grid}", "outer_loop"),
    ],
)
def test_what_nothing_reads_is_named(
    word: str, key: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was taken, and the training was as without it."""
    run = tmp_path / "run"
    told = f"{word} changes nothing: no part of this run reads {key}."
    assert main(["train", *GO, word, f"run.dir={run}"]) == 0
    assert told in capsys.readouterr().err
    assert main(["resume", str(run), word, "budget.samples=256"]) == 0
    assert told in capsys.readouterr().err


HARVEST = ("experiment=miniature/sleeve_bank", "job.count=2", "job.ending=any", "num_worlds=4")


@pytest.mark.parametrize(
    ("word", "key"),
    [
        ("control.frequency=10", "control"),
        ("episode.seconds=1", "episode"),
        ("difficulty=0.5", "difficulty"),
        ("reward.combine=sum", "reward"),
        ("reward.terms.other={name: value, weight: 2.0}", "reward"),
        ("termination.terms={}", "termination"),
    ],
)
def test_keys_of_the_root_that_a_job_does_not_read_are_named(
    word: str, key: str, built_on: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A harvest runs another run's task, and took what was said of its own without a word."""
    words = [*HARVEST, f"job.run={built_on / 'sleeve'}", f"run.dir={tmp_path / 'run'}"]
    assert main(["train", *words, word]) == 0
    told = [line for line in capsys.readouterr().err.splitlines() if "changes nothing" in line]
    assert told == [f"{word} changes nothing: no part of this run reads {key}."]


@pytest.mark.parametrize(
    "word",
    ["resolution.substeps=1", "learner.gamma=0.9", "memory.target.every=1.0", "control.frequency=31", "difficulty=0.5",
     "episode.seconds=2", "seed=3", "device=cpu", "evaluation.gate=0.5", "checkpoint.keep=2", "reward.combine=sum",
     "termination.terms.out={name: beyond, reads: {value: distance}, limit: 9.0}"],
)  # fmt: skip
def test_of_what_is_read_nothing_is_said(
    word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", *GO, word, f"run.dir={tmp_path / 'run'}"]) == 0
    assert "changes nothing" not in capsys.readouterr().err


def test_a_variant_whose_words_change_nothing_is_told_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two variants that are one were compared without a word."""
    words = ["variants={a: [], b: [chair={}]}", f"run.dir={tmp_path / 'sweep'}"]
    assert main(["sweep", *GO, *words]) == 0
    told = capsys.readouterr().err
    assert "b/seed0: chair={} changes nothing: no part of this run reads chair." in told
    assert "a/seed0: chair" not in told
    assert "Drawing the video" not in told  # run.video_seconds=0 leaves nothing to draw
