"""What observers are told when an evaluation was recorded."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import worlds
from worlds import PADDLE_TASK, SMALL, PaddleScene

from understudy.records.observer import RunObserver
from understudy.records.recording import Recording
from understudy.records.runs import Run
from understudy.running.training import Training
from understudy.setup import plugins as setup_plugins
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import hookimpl, load
from understudy.setup.registry import Registrar
from understudy_judging import commands
from understudy_training import workflow

QUICK = (
    *PADDLE_TASK, *SMALL, "budget.samples=128", "evaluation.episodes=4", "evaluation.seconds=0.2",
    "evaluation.final_episodes=4", "run.video_seconds=0.1", "control.frequency=50",
)  # fmt: skip


class Watcher(RunObserver):
    """Keeps what it is told."""

    def __init__(self) -> None:
        self.seen: list[tuple[Recording, set[str]]] = []

    def judged(self, run: Run, recording: Recording | None, tell: Callable[[str], None]) -> None:
        self.seen.append((recording, {f.name for f in run.path.iterdir()}))
        tell("I have seen it.")


class Breaking(RunObserver):
    """Fails at the first recording."""

    def judged(self, run: Run, recording: Recording | None, tell: Callable[[str], None]) -> None:
        raise ValueError("too dark")


class Watch:
    """The plugin of both."""

    def __init__(self, watcher: Watcher) -> None:
        self.watcher = watcher

    @hookimpl
    def understudy_register(self, register: Registrar) -> None:
        register.component("observer", "breaking", Breaking)
        register.component("observer", "watcher", lambda: self.watcher)


@pytest.mark.parametrize("fields", [("qpos",), ()])
def test_observers_are_told_after_training_and_render(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    fields: tuple[str, ...],
) -> None:
    watcher, path = Watcher(), tmp_path / "run"
    plugins = load(
        only=["mujoco", "networks", "ppo", "reinforcement"],
        extra=[("test", sys.modules[worlds.__name__]), ("watch", Watch(watcher))],
    )
    for module in (setup_plugins, workflow):
        monkeypatch.setattr(module, "installed", lambda: plugins)
    monkeypatch.setattr(PaddleScene, "recorded", fields)
    overrides = [*QUICK, f"run.dir={path}"]
    monkeypatch.setattr(workflow, "load_experiment", lambda given: load_experiment(given, plugins))
    assert workflow.train(overrides) == 0
    assert commands.Render().run(argparse.Namespace(run=str(path), overrides=[])) == 0
    messages = capsys.readouterr().err
    assert messages.count("The observer Breaking is left out: ValueError: too dark") == 2
    assert messages.count("I have seen it.") == 2
    assert len(watcher.seen) == 2
    for recording, files in watcher.seen:
        assert "evaluation.json" in files
        assert ("recording.npz" in files) == bool(fields)
        if not fields:
            assert recording is None, "there is nothing to see"
            continue
        assert isinstance(recording.scene, PaddleScene)
        assert recording.control_dt == pytest.approx(0.02)
        assert {k: v.shape for k, v in recording.tracks.items()} == dict.fromkeys(fields, (5, 8))
    first, second = (recording for recording, _ in watcher.seen)
    for field in fields:  # the same policy shows the same motion
        np.testing.assert_array_equal(first.tracks[field], second.tracks[field])
        with np.load(path / "recording.npz") as arrays:
            np.testing.assert_array_equal(arrays[field], second.tracks[field])
            assert int(arrays["first_episode"]) == second.first_episode


def test_every_control_period_of_a_decision_is_recorded(monkeypatch: pytest.MonkeyPatch) -> None:
    """0.1 s of 50 a second, in decisions of three, from the first state on; then nobody watches."""
    plugins = load(
        only=["mujoco", "networks", "ppo", "reinforcement"],
        extra=[("test", sys.modules[worlds.__name__])],
    )
    monkeypatch.setattr(PaddleScene, "recorded", ("qpos", "action"))
    given = [*QUICK, "control.decision=3", "num_worlds=4"]
    training = Training(load_experiment(given, plugins)).prepare()
    _, recording = training.judge(0.1)
    environment = training.job.evaluator.built.environment  # type: ignore[attr-defined]
    assert recording is not None
    assert recording.control_dt == pytest.approx(0.02)
    assert recording.tracks["qpos"].shape == (5, 8)
    steps = np.abs(np.diff(recording.tracks["qpos"], axis=0)).max(axis=1)
    assert (steps > 0).all(), "no state twice"
    actions = recording.tracks["action"]
    np.testing.assert_array_equal(actions[[1, 2]], actions[[0, 0]])
    assert (actions[3] != actions[2]).any(), "the next decision"
    assert environment.on_period is None
    _, nothing = training.judge(0.0)
    assert nothing is None
    training.close()
