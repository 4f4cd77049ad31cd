"""The highest bar that a run clears, from the command line."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from worlds import SMALL

from understudy.command.cli import main
from understudy_jumping import heights
from understudy_reinforcement.evaluation import Evaluation

TINY = (
    "task=jumping/high", *SMALL, "num_worlds=4", "control.substeps=5", "learner.rollout_steps=8",
    "curriculum.start=0.5", "budget.samples=32", "evaluation.episodes=4", "evaluation.final_episodes=4",
    "run.video_seconds=0",
)  # fmt: skip


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A training that came to a bar of 1.25 m."""
    folder = tmp_path_factory.mktemp("heights") / "run"
    assert main(["train", *TINY, f"run.dir={folder}"]) == 0
    return folder


def test_a_run_that_clears_nothing_is_said_so(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Judged where it is: at 1.25 m, and at 0.5 m, from which no step leads further down."""
    assert main(["jumping", "heights", str(run), "--step", "1.0"]) == 2
    said = capsys.readouterr()
    assert [line.partition(" high")[0] for line in said.out.splitlines()] == ["1.25 m", "0.50 m"]
    assert "clears nothing in 50% of its attempts" in said.err
    assert not (run / heights.FILE).exists()


def test_the_highest_bar_is_the_first_at_which_enough_succeed(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def judged(path: str, wanted: float, words: list[str]) -> tuple:
        assert (path, wanted, words[0]) == (str(run), 0.6, "num_worlds=2")
        rate = 0.75 if float(words[1].removeprefix("difficulty=")) < 0.44 else 0.55
        return Evaluation(episodes=100, success="landed", success_rate=rate), 32

    monkeypatch.setattr(heights, "_judged", judged)
    words = ["--success", "0.6", "--step", "0.05", "num_worlds=2"]
    assert main(["jumping", "heights", str(run), *words]) == 0
    found = json.loads((run / heights.FILE).read_text())
    assert found["highest"]["height"] == pytest.approx(1.15)
    assert [rate for _, rate in found["tried"]] == [0.55, 0.55, 0.75]
    assert found["highest"]["evaluation"]["success_rate"] == 0.75
    said = capsys.readouterr().out
    assert "1.15 m high in 75% [66%, 82%]" in said
    assert "--from" not in said


def test_bars_above_the_target(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The arena of a run up to 2 m is made greater; all attempts of so short a training fail, and count
    as successes here."""
    judged = heights._judged

    def generous(path: str, wanted: float, words: list[str]) -> tuple:
        found, samples = judged(path, 0.0, words)
        return replace(found, success_rate=1.0), samples

    monkeypatch.setattr(heights, "_judged", generous)
    words = ["--from", "2.3", "--step", "2"]
    assert main(["jumping", "heights", str(run), *words]) == 0
    said = capsys.readouterr().out
    assert said.startswith("2.30 m high: ")
    assert "Nothing higher was tried; to try more: --from 2.80." in said
    found = json.loads((run / heights.FILE).read_text())["highest"]
    assert found["height"] == 2.3
    assert found["evaluation"]["measures"]["obstacle_height"]["mean"] == pytest.approx(2.3)


@pytest.mark.parametrize(
    "words",
    [
        "--step 0", "--step -0.1", "--step nan", "--step 1e-300", "--from inf", "--from nan",
        "--from 1e300", "--success 2", "--success 0", "--success nan",
    ],
)  # fmt: skip
def test_impossible_numbers_are_refused(
    run: Path, words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(heights, "_judged", lambda *_: pytest.fail("it was judged"))
    assert main(["jumping", "heights", str(run), *words.split()]) == 2
    said = capsys.readouterr().err
    assert "not above 0" in said or "tries more than 1000 obstacles" in said


def at_difficulty(monkeypatch: pytest.MonkeyPatch, curriculum: Any) -> None:
    state = {"environment": {"curriculum": curriculum}}
    monkeypatch.setattr(heights, "newest_state", lambda _: state)


@pytest.mark.parametrize("difficulty", [0.5, [0.5], [0.2, 0.5]])
def test_curricula_of_one_difficulty_and_of_several(
    run: Path, difficulty: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_difficulty(monkeypatch, {"difficulty": difficulty})
    assert heights._trained(str(run))[0] == pytest.approx(1.25)


@pytest.mark.parametrize(
    "curriculum", [None, {}, *({"difficulty": d} for d in (None, [], "high", [None], [2.0]))]
)
def test_a_run_without_a_rising_bar_is_refused(
    run: Path, curriculum: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    at_difficulty(monkeypatch, curriculum)
    assert main(["jumping", "heights", str(run)]) == 2
    assert "is no run of a jump whose bar rises" in capsys.readouterr().err


def test_a_skill_which_has_no_worlds_is_tried_from_the_target(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was refused as no run of a jump."""
    monkeypatch.setattr(heights, "newest_state", lambda path: {"policy": {}})
    reached, arena = heights._trained(str(run))
    assert reached == arena.height[1] > 1.25


@pytest.mark.parametrize(
    ("arena", "sentence"),
    [
        (None, "is no run of a jump whose bar rises"),
        ({"heigth": [0.5, 2.0]}, "Did you mean"),
        ({"height": [2.0, 0.5]}, "the first is the lower one"),
        ({"height": None}, "arena.height"),
        ([], "arena=[] is not possible"),
    ],
)
def test_arenas_of_strangers_are_data(
    run: Path, tmp_path: Path, arena: Any, sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(run, tmp_path / "run")
    info = json.loads((run / "run.json").read_text())
    info["config"]["arena"] = arena
    (tmp_path / "run" / "run.json").write_text(json.dumps(info))
    assert main(["jumping", "heights", str(tmp_path / "run")]) == 2
    assert sentence in capsys.readouterr().err


def test_another_run_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["jumping", "heights", str(tmp_path)]) == 2
    assert "is no run folder" in capsys.readouterr().err


def test_the_simulator_that_it_learned_in_need_not_be_here(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / "run"
    shutil.copytree(run, copy)
    info = json.loads((copy / "run.json").read_text())
    info["config"]["simulator"] = {"name": "elsewhere"}
    (copy / "run.json").write_text(json.dumps(info))
    words = [str(copy), "--step", "1.0", "simulator=mujoco"]
    assert main(["jumping", "heights", *words]) == 2
    assert "clears nothing" in capsys.readouterr().err
