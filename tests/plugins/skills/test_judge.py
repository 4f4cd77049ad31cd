"""``job=judge``: what one run learned, judged as another run's configuration says."""

from __future__ import annotations

from pathlib import Path

import pytest
from worlds import SMALL, assert_same_state, make_training, resumed

from understudy.errors import RunError
from understudy.running.training import Training
from understudy.setup.plugins import Plugins
from understudy.testing.fake import FAKE_TASK

FEW = (
    "evaluation.episodes=8", "evaluation.final_episodes=8", "evaluation.seconds=4", "budget.samples=512",
)  # fmt: skip


@pytest.fixture
def learned(plugins: Plugins, tmp_path: Path) -> tuple[str, Training]:
    training = make_training(plugins, [*FAKE_TASK, *SMALL, *FEW], tmp_path / "learned")
    training.train()
    assert training.run is not None
    training.run.unlock()
    return str(training.run.path), training


def test_a_policy_is_judged_and_nothing_is_learned(
    plugins: Plugins, tmp_path: Path, learned: tuple[str, Training]
) -> None:
    run, training = learned
    job = [*FAKE_TASK, *SMALL, *FEW, f"+job={{name: judge, run: {run}}}"]
    judged = make_training(plugins, job, tmp_path / "judged")
    assert judged.train() == "finished"
    assert judged.progress.iteration == 0
    assert judged.run is not None
    assert judged.run.metrics() == []
    policy = dict(training.job.state_dict()["policy"])
    assert_same_state(
        judged.job.state_dict(), {"policy": policy}, ["/policy/log_deviation"]
    )  # by samples
    same, _ = judged.judge()
    assert same == training.judge()[0]
    assert judged.job.sources()["policy"] == {"run": run, "behind": []}
    judged.run.unlock()
    assert resumed(plugins, tmp_path / "judged").judge()[0] == same


def test_under_conditions_that_training_did_not_know(
    plugins: Plugins, learned: tuple[str, Training]
) -> None:
    run, training = learned
    job = [*FAKE_TASK, *SMALL, *FEW, f"+job={{name: judge, run: {run}}}"]
    longer = make_training(plugins, [*job, "evaluation.seconds=2.5"]).judge()[0]
    assert longer.seconds == 2.5
    assert longer.measures["return"].mean != training.judge()[0].measures["return"].mean


def test_another_policy_is_refused_in_one_sentence(
    plugins: Plugins, learned: tuple[str, Training]
) -> None:
    run, _ = learned
    job = [*FAKE_TASK, *SMALL, f"+job={{name: judge, run: {run}}}", "policy.hidden=[9]"]
    with pytest.raises(RunError, match=rf"^job\.run: the policy of {run} does not fit: .*actor"):
        make_training(plugins, job)


def test_what_the_policy_was_not_trained_with_is_said(
    plugins: Plugins, learned: tuple[str, Training], capsys: pytest.CaptureFixture[str]
) -> None:
    run, training = learned
    job = [*FAKE_TASK, *SMALL, *FEW, f"+job={{name: judge, run: {run}}}"]
    make_training(plugins, job)
    assert "Unlike" not in capsys.readouterr().err
    frequency = training.job.experiment.effective()["control"]["frequency"]
    make_training(plugins, [*job, f"control.frequency={frequency / 2}"])
    said = capsys.readouterr().err
    assert (
        f"Unlike in the training of {run}: control.frequency: {frequency} → {frequency / 2}" in said
    )
