"""Coarser physics at a training's beginning: when it sharpens, what counts, and resuming across the change."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
import torch
from counted_task import LINE_TASK, line_plugins
from worlds import make_training, resumed

from understudy.errors import ConfigError
from understudy.running.training import Training
from understudy.setup.composition import load_experiment
from understudy_reinforcement.evaluation import Evaluation

#: Four physics steps a control period, of which a training begins with one.
COARSE = (*LINE_TASK, "control.substeps=4", "resolution.substeps=1", "control.frequency=10")


def made(run: Path | None, *more: str) -> Training:
    return make_training(line_plugins(), [*COARSE, *more], run)


def hertz(rows: Sequence[dict[str, object]]) -> list[object]:
    return [row["physics_hz"] for row in rows]


def test_it_sharpens_when_its_share_of_the_budget_is_spent(tmp_path: Path) -> None:
    training = made(tmp_path / "run", "budget.samples=64", "resolution.budget=0.5")
    training.train()
    assert training.run is not None
    rows = training.run.metrics()
    half = len(rows) // 2
    assert hertz(rows) == [10.0] * half + [40.0] * half
    marks = [key for row in rows for key in row if key.startswith("mark/")]
    assert marks == ["mark/physics at 40 Hz"]
    assert "mark/physics at 40 Hz" in rows[half - 1]


def test_the_simulator_steps_as_often_as_the_resolution_says() -> None:
    training = made(None)
    before = training.job.environment.parts.simulator  # type: ignore[attr-defined]
    assert before._substeps == 1
    training.job.sharpen()
    after = training.job.environment.parts.simulator  # type: ignore[attr-defined]
    assert after._substeps == 4
    torch.testing.assert_close(after.x, before.x, rtol=0, atol=0)  # it goes on from the same state


def test_the_criterion_at_coarse_physics_only_sharpens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    overrides = ["evaluation.criterion=0.9", "evaluation.every_samples=0", "evaluation.gate=0", "budget.samples=8000"]  # fmt: skip
    training = made(tmp_path / "run", *overrides)
    asked: list[str] = []

    def answering(kind: str, rates: list[float]) -> object:
        def evaluate(draw: str, episodes: int, *, give_up_below: float | None = None) -> Evaluation:
            asked.append(f"{kind} {draw}")
            return Evaluation(episodes, "", rates.pop(0))

        return evaluate

    monkeypatch.setattr(training.job, "rehearse", answering("coarse", [0.5, 1.0]))
    monkeypatch.setattr(training.job, "evaluate", answering("fine", [0.2, 0.95, 0.9]))
    assert training.train() == "criterion"
    assert asked == [
        "coarse rehearsal/1",
        "coarse rehearsal/2",
        "fine evaluation/3",
        "fine evaluation/4",
        "fine confirmation/4",
    ]
    assert training.run is not None
    rows = training.run.metrics()
    assert hertz(rows) == [10.0, 10.0, 40.0, 40.0]
    assert [row.get("rehearsal/success_rate") for row in rows] == [0.5, 1.0, None, None]
    assert [row.get("evaluation/success_rate") for row in rows] == [None, None, 0.2, 0.95]


def test_the_last_evaluation_is_at_the_tasks_own_physics() -> None:
    """Whether or not the training got there."""
    training = made(None)
    training.judge()
    evaluators = training.job._evaluators  # type: ignore[attr-defined]
    assert list(evaluators) == [4]
    assert evaluators[4].built.environment.parts.simulator._substeps == 4


@pytest.mark.parametrize("stop", [2, 6])
def test_resuming_across_the_change_is_exact(tmp_path: Path, stop: int) -> None:
    """Stopped before and after it; of eight iterations the first four are coarse."""
    overrides = ["budget.samples=64", "resolution.budget=0.5"]
    whole = made(tmp_path / "whole", *overrides)
    length = len(list(whole.rows()))
    cut = made(tmp_path / "cut", *overrides)
    rows = cut.rows()
    for _ in range(stop * length // 8):
        next(rows)
    rows.close()
    cut.close()
    assert cut.run is not None
    cut.run.unlock()
    again = resumed(line_plugins(), tmp_path / "cut")
    again.train()
    ours, theirs = again.state_dict(), whole.state_dict()
    assert ours["substeps"] == theirs["substeps"] == 4
    for name, value in theirs["environment"]["simulator"].items():
        torch.testing.assert_close(ours["environment"]["simulator"][name], value, rtol=0, atol=0)
    for name, value in theirs["policy"].items():
        torch.testing.assert_close(ours["policy"][name], value, rtol=0, atol=0)


def test_physics_cannot_begin_finer_than_it_ends() -> None:
    with pytest.raises(ConfigError, match=r"resolution\.substeps=8.*control\.substeps=4"):
        load_experiment([*COARSE, "resolution.substeps=8"], line_plugins())


def test_after_sharpening_an_evaluation_comes_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """After half as many samples as else, and none too late."""
    training = made(None, "evaluation.criterion=0.9", "evaluation.every_samples=320", "evaluation.gate=0", "budget.samples=1280")  # fmt: skip
    looked: list[tuple[str, int]] = []

    def evaluate(kind: str, episodes: int, criterion: float | None) -> Evaluation:
        looked.append((kind, training.progress.samples))
        return Evaluation(episodes, "", 1.0 if kind == "rehearsal" else 0.0)

    monkeypatch.setattr(training, "_evaluate", evaluate)
    training.train()
    assert looked == [("rehearsal", 320), ("evaluation", 480), ("evaluation", 800), ("evaluation", 1120)]  # fmt: skip


def test_a_result_is_tried_at_half_the_time_step() -> None:
    """On the same starts, whatever physics a training began with."""
    training = made(None)
    hertz, finer = training.job.evaluate_finer(
        "final", training.experiment.root.evaluation.final_episodes
    ) or (0.0, None)
    assert hertz == 80.0
    simulator = training.job._evaluator(8).built.environment.parts.simulator  # type: ignore[attr-defined]
    assert simulator._substeps == 8
    assert finer is not None
    assert finer.episodes == training.experiment.root.evaluation.final_episodes
