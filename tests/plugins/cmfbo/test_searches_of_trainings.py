"""``understudy sweep search=cmfbo/toy``: real trainings, policies handed on, and being killed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from deaths import die_after

from understudy.command.cli import main

QUICK = (
    "search=cmfbo/toy",
    "budget.samples=1024",
    "evaluation.criterion=null",
    "evaluation.episodes=8",
    "evaluation.final_episodes=8",
    "evaluation.seconds=1.0",
    "outer_loop.trials=4",
    "outer_loop.initial=2",
    "outer_loop.epsilon=1e9",
)


def rows(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "journal.jsonl").read_text().splitlines()]


def asked(folder: Path) -> list[dict[str, Any]]:
    return [row["trial"] for row in rows(folder) if row["event"] == "asked"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("search")
    assert main(["sweep", *QUICK, f"run.dir={folder}"]) == 0
    return folder


def test_trials_are_trained_at_their_difficulty(whole: Path) -> None:
    """…, with the options of their point, from the policy of an earlier one."""
    trials = asked(whole)
    assert [t["fidelity"] for t in trials] == [0.0, 0.0, 1.0, 1.0]
    for trial in trials:
        run = json.loads((whole / trial["key"] / "run.json").read_text())
        config = run["config"]
        assert config["difficulty"] == trial["fidelity"]
        assert config["learner"]["epochs"] == trial["point"]["learner.epochs"]
        assert config["actuation"]["strength"] == trial["point"]["actuation.strength"]
        start = trial["start"]
        assert (config.get("start") or {}).get("run") == (start and str(whole / start["trial"]))
    summary = json.loads((whole / "summary.json").read_text())
    assert [row["trial"] for row in summary if row["found"] == "answer"] in (["trial2"], ["trial3"])


@pytest.mark.parametrize("after", [3, 6])
def test_killed_and_started_again(whole: Path, tmp_path: Path, after: int) -> None:
    folder = tmp_path / "search"
    die_after(after, folder, *QUICK)
    assert len(rows(folder)) == after
    assert main(["sweep", *QUICK, f"run.dir={folder}"]) == 0
    assert asked(folder) == asked(whole)


def test_an_option_that_is_none_is_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Refused before a trial begins, with status 2."""
    bad = "outer_loop.parameters={learner.epoch: {low: 1, high: 8, integer: true}}"
    quick = [o for o in QUICK if not o.startswith("outer_loop.e")]
    assert main(["sweep", *quick, bad, f"run.dir={tmp_path / 's'}"]) == 2
    message = capsys.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "s").exists()
    assert "learner has no option 'epoch'. Did you mean 'epochs'?" in message


def test_a_range_that_is_none_is_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = "outer_loop.parameters={learner.clip: {low: 0.0, high: 0.2, scale: log}}"
    assert main(["sweep", *QUICK, bad, f"run.dir={tmp_path / 's'}"]) == 2
    assert "outer_loop.parameters.learner.clip.low=0 is not possible" in capsys.readouterr().err
    assert not (tmp_path / "s").exists()


@pytest.mark.parametrize("executor", ["in_process", "processes"])
def test_a_task_without_difficulty_is_refused(
    executor: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By the first trial, in a sentence, and with nothing told: its trials would all be the same."""
    command = [
        "sweep", "experiment=spacetime/walk", "outer_loop=cmfbo", "outer_loop.trials=4",
        "outer_loop.parameters={learner.epochs: {low: 1, high: 8, integer: true}}",
        "num_worlds=8", "budget.samples=256", f"executor={executor}", f"run.dir={tmp_path}",
    ]  # fmt: skip
    assert main(command) == 2
    (said,) = [t for t in capsys.readouterr().err.splitlines() if t.startswith("understudy: ")]
    assert said.startswith("understudy: Nothing in this task reads `difficulty`")
    assert "outer_loop.name=gp_ucb" in said
    assert {row["event"] for row in rows(tmp_path)} == {"asked"}
    assert not (tmp_path / "trial0" / "run.json").exists()


def test_a_difficulty_that_only_the_curriculum_uses(tmp_path: Path) -> None:
    """Its time limit follows from it, although no part reads it."""
    command = [
        "sweep", "experiment=miniature/go", "outer_loop=boca", "outer_loop.trials=1",
        "outer_loop.parameters={learner.epochs: {low: 1, high: 8, integer: true}}",
        "curriculum={name: linear, samples: 128, knots: {episode_limit: [[0.0, 0.5], [1.0, 1.0]]}}",
        "num_worlds=8", "budget.samples=256", "evaluation.episodes=4", "evaluation.seconds=0.5",
        "evaluation.objective=return", "executor=in_process", "run.video_seconds=0", f"run.dir={tmp_path}",
    ]  # fmt: skip
    assert main(command) == 0
    assert rows(tmp_path)[-1]["report"]["status"] == "ok"


@pytest.mark.parametrize("loop", ["random_search", "gp_ucb", "boca", "cmfbo"])
def test_a_search_without_an_objective_is_refused(
    loop: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It ran, ranked nothing, and said so nowhere; before a trial, and with what could be maximised."""
    command = [
        "sweep", "experiment=miniature/go", f"outer_loop={loop}", "outer_loop.trials=2",
        "outer_loop.parameters={learner.epochs: {low: 1, high: 8, integer: true}}",
        "executor=in_process", f"run.dir={tmp_path / 's'}",
    ]  # fmt: skip
    assert main(command) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert "evaluation.objective=success_rate, and nothing in this task says" in said
    assert "(distance, return)" in said
    assert not (tmp_path / "s").exists()


def test_a_finished_trial_is_listed_as_finished(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = [
        "sweep", "experiment=miniature/go", "outer_loop=random_search", "outer_loop.trials=1",
        "outer_loop.parameters={learner.gamma: {low: 0.9, high: 0.99}}", "evaluation.objective=return",
        "num_worlds=8", "budget.samples=256", "evaluation.episodes=4", "evaluation.seconds=0.5",
        "executor=in_process", "run.video_seconds=0", f"run.dir={tmp_path}",
    ]  # fmt: skip
    assert main(command) == 0
    capsys.readouterr()
    assert main(["runs", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "trial0" in said
    assert "unfinished" not in said


@pytest.mark.parametrize(
    ("option", "said"),
    [
        ("device", "says where and how a trial runs"),
        ("simulator.threads", "says where and how a trial runs"),
        ("checkpoint.keep", "says where and how a trial runs"),
        ("run.video_seconds", "says where and how a trial runs"),
        ("run.dir", "says where and how a trial runs"),
        ("executor.workers", "a sweep says that of each of its trials"),
        ("seed", "to differ in what is searched, not by chance"),
        ("evaluation.seconds", "says how trials are judged"),
        ("evaluation.objective", "says how trials are judged"),
        ("motion.name", "motion.name=1 is not possible: it takes a text"),
        ("scene.character", "scene.character=1 is not possible: it takes a text"),
    ],
)  # fmt: skip
def test_what_a_search_cannot_mean_is_refused_before_a_trial(
    option: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Trials failed one by one, or the luckiest seed and the easiest judge were found best."""
    command = [
        "sweep", "experiment=spacetime/walk", "outer_loop=random_search", "outer_loop.trials=2",
        f"outer_loop.parameters={{{option}: {{low: 1, high: 2, integer: true}}}}",
        "evaluation.objective=return", "executor=in_process", f"run.dir={tmp_path / 's'}",
    ]  # fmt: skip
    assert main(command) == 2
    assert said in capsys.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "s").exists()
