"""Coarser physics at a training's beginning: when it sharpens, what counts, and resuming across the change."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
import torch
from counted_task import LINE_TASK, line_plugins
from worlds import make_training, resumed

from understudy.errors import ConfigError, RunError
from understudy.running.training import Training
from understudy.setup.composition import load_experiment
from understudy.setup.validation import validate
from understudy_reinforcement.evaluation import Evaluation
from understudy_reinforcement.policy import Policy
from understudy_reinforcement.resolution import resolution_of

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
    training.job.sharpen()  # type: ignore[attr-defined]
    after = training.job.environment.parts.simulator  # type: ignore[attr-defined]
    assert after._substeps == 4
    torch.testing.assert_close(after.x, before.x, rtol=0, atol=0)  # it goes on from the same state


def test_the_criterion_at_coarse_physics_only_sharpens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    overrides = ["evaluation.criterion=0.9", "evaluation.every_samples=0", "evaluation.gate=0", "budget.samples=8000"]  # fmt: skip
    training = made(tmp_path / "run", *overrides)
    asked: list[str] = []

    rates = {1: [0.5, 1.0], 4: [0.2, 0.95, 0.9]}

    class Answers:
        """In place of evaluators, by physics steps of a control period."""

        def __init__(self, substeps: int) -> None:
            self._substeps = substeps

        def run(self, policy: Policy, draw: str, episodes: int, **_: object) -> Evaluation:
            asked.append(f"{self._substeps} {draw}")
            return Evaluation(episodes, "", rates[self._substeps].pop(0))

    monkeypatch.setattr(training.job, "_evaluator", Answers)
    assert training.train() == "criterion"
    assert asked == [
        "1 rehearsal/1",
        "1 rehearsal/2",
        "4 evaluation/3",
        "4 evaluation/4",
        "4 confirmation/4",
    ]
    assert training.run is not None
    rows = training.run.metrics()
    assert hertz(rows) == [10.0, 10.0, 40.0, 40.0]
    assert [row.get("rehearsal/success_rate") for row in rows] == [0.5, 1.0, None, None]
    assert [row.get("evaluation/success_rate") for row in rows] == [None, None, 0.2, 0.95]


def test_a_rehearsal_that_was_given_up_sharpens_nothing() -> None:
    """Its rate is the most that it could be."""
    training = made(None, "evaluation.criterion=0.9", "budget.samples=1280")
    resolution, progress = training.job.resolution, training.progress  # type: ignore[attr-defined]
    given_up = Evaluation(64, "", 0.95, complete=False)
    assert not resolution.ripe(given_up.row("rehearsal"), progress)
    assert not resolution.ripe(Evaluation(64, "", 0.95).row("evaluation"), progress)
    assert resolution.ripe(Evaluation(64, "", 0.95).row("rehearsal"), progress)


def test_it_sharpens_at_a_difficulty() -> None:
    for difficulty, marked in ((0.8, False), (0.5, True)):
        training = made(None, "difficulty=0.7", f"resolution.difficulty={difficulty}", "budget.samples=64", "resolution.budget=1")  # fmt: skip
        assert ("mark/physics at 40 Hz" in training.iterate()) == marked


def test_the_last_evaluation_is_at_the_tasks_own_physics() -> None:
    """Whether or not the training got there."""
    training = made(None)
    training.judge()
    evaluators = training.job._evaluators  # type: ignore[attr-defined]
    assert list(evaluators) == [4]
    assert evaluators[4].built.environment.parts.simulator._substeps == 4


@pytest.mark.parametrize(
    ("stop", "every"), [(2, "null"), (6, "null"), (6, 1000)], ids=["before", "after", "set back"]
)
def test_resuming_across_the_change_is_exact(tmp_path: Path, stop: int, every: object) -> None:
    """Stopped before and after it; of eight iterations the first four are coarse. The next evaluation may be set
    back to before the beginning, where a checkpoint was taken for one that counts what cannot be."""
    overrides = ["budget.samples=64", "resolution.budget=0.5", f"evaluation.every_samples={every}"]
    whole = made(tmp_path / "whole", *overrides)
    length = len(list(whole.rows()))
    cut = made(tmp_path / "cut", *overrides)
    rows = cut.rows()
    for _ in range(stop * length // 8):
        next(rows)
    rows.close()
    cut.close()
    assert cut.run is not None
    assert (cut.progress.evaluated_at < 0) == (every != "null")
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
    experiment = load_experiment([*COARSE, "resolution.substeps=8"], line_plugins())
    with pytest.raises(ConfigError, match=r"resolution\.substeps=8.*control\.substeps=4"):
        Training(experiment)


def test_without_the_section_physics_is_the_tasks_own_throughout() -> None:
    """As with one that says so, which every older run's configuration has."""
    experiment = load_experiment([*LINE_TASK], line_plugins())
    older = {**experiment.effective(), "resolution": {"substeps": None, "difficulty": None, "budget": 0.75}}  # fmt: skip
    assert "resolution" not in experiment.effective()
    assert resolution_of(experiment) == resolution_of(validate(older, line_plugins().registry))
    assert "substeps" not in make_training(line_plugins(), LINE_TASK).state_dict()


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
    episodes = training.experiment.root.evaluation.final_episodes
    hertz, finer = training.job.evaluate_finer("final", episodes)  # type: ignore[attr-defined]
    assert hertz == 80.0
    simulator = training.job._evaluator(8).built.environment.parts.simulator  # type: ignore[attr-defined]
    assert simulator._substeps == 8
    assert finer.episodes == episodes


@pytest.mark.parametrize("substeps", [0, -3, 1.5, True])
def test_a_checkpoint_of_impossible_substeps_is_refused(substeps: object) -> None:
    """The engine raised its own error in the middle of the first iteration."""
    training = made(None)
    state = training.state_dict()
    with pytest.raises(RunError, match=f"'substeps' (cannot be {substeps}|is a number here)"):
        training.load_state_dict({**state, "substeps": substeps})
