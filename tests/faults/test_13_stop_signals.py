"""Fault 13: a stop signal at any moment: the run saves at the next boundary and exits with 75."""

from __future__ import annotations

import os
import random
import signal
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from commands import begin_code, wait_for
from worlds import CLI, SMALL, assert_same_state, make_training, resumed

from understudy.errors import PreemptedError
from understudy.records import checkpoint
from understudy.records.observer import RunObserver
from understudy.records.runs import Run
from understudy.running.training import Training
from understudy.setup.plugins import Plugins
from understudy.signals import StopRequest
from understudy.testing.fake import FAKE_TASK

LONG = (*FAKE_TASK, *SMALL, "budget.samples=100000000", "checkpoint.minutes=1000")


def newest_equals(training: Training, run: Path) -> None:
    state, _, path = checkpoint.load_newest(run / "checkpoints")
    assert path.name == f"{training.progress.iteration:08d}"
    assert_same_state(state, training.state_dict(), ignore=())


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGUSR1, signal.SIGINT])
def test_each_signal(plugins: Plugins, tmp_path: Path, number: signal.Signals) -> None:
    before = signal.getsignal(number)
    training = make_training(plugins, LONG, tmp_path / "run")

    class Killer(RunObserver):
        def iteration(self, run: Run, row: Mapping[str, Any], stage: str) -> None:
            if row["iteration"] == 3:
                os.kill(os.getpid(), number)
                os.kill(os.getpid(), signal.SIGTERM)  # a second one does no harm

    training.reporter.observers = [Killer()]
    with pytest.raises(
        PreemptedError, match=r"everything is saved\. Continue with `understudy resume"
    ) as caught:
        training.train()
    assert caught.value.exit_status == 75
    assert training.progress.iteration in (3, 4), "at the next boundary"
    newest_equals(training, tmp_path / "run")
    assert signal.getsignal(number) == before, "handlers are given back"


@pytest.mark.parametrize(
    ("numbers", "waits"),
    [
        ((signal.SIGINT,), True),
        ((signal.SIGINT, signal.SIGINT), False),
        ((signal.SIGTERM, signal.SIGINT), True),
        ((signal.SIGTERM, signal.SIGTERM), True),  # schedulers repeat themselves
        ((signal.SIGINT, signal.SIGTERM), True),
    ],
)
def test_a_second_ctrl_c_does_not_wait_for_a_long_iteration(
    plugins: Plugins,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    numbers: tuple[int, ...],
    waits: bool,
) -> None:
    training, done = make_training(plugins, LONG, tmp_path / "run"), []
    iterate = training.iterate
    told: list[str] = []

    def long() -> Any:
        if training.progress.iteration == 2:
            for number in numbers:
                os.kill(os.getpid(), number)
            done.append("waited")
        return iterate()

    monkeypatch.setattr(training, "iterate", long)
    with (
        StopRequest(at_once=True, tell=told.append),  # as the command line's
        pytest.raises(PreemptedError if waits else KeyboardInterrupt),
    ):
        training.train()
    assert done == (["waited"] if waits else [])
    once = "Stopping once what is begun is finished. A second Ctrl-C stops at once."
    assert told == [once] * (numbers[0] == signal.SIGINT)
    assert training.run is not None
    training.run.unlock()
    again = resumed(plugins, tmp_path / "run")
    assert again.progress.iteration == (3 if waits else 0), "what was saved goes on"


def test_at_random_moments(plugins: Plugins, tmp_path: Path) -> None:
    """Twenty stops at any instruction; the training that was stopped so ends like any other."""
    rng, run = random.Random(0), tmp_path / "run"
    training = make_training(plugins, LONG, run)
    for _ in range(20):
        numbers = [signal.SIGTERM, signal.SIGUSR1, signal.SIGINT]
        while numbers.count(signal.SIGINT) == 2 or len(numbers) != 2:  # two of those do not wait
            numbers = rng.choices([signal.SIGTERM, signal.SIGUSR1, signal.SIGINT], k=2)
        shots = [threading.Timer(rng.uniform(0.001, 0.08), os.kill, (os.getpid(), n)) for n in numbers]  # fmt: skip
        # a shot before or after train() must not end the test itself
        guard = {n: signal.signal(n, lambda *_: None) for n in (15, 10, 2)}
        started = time.monotonic()
        for shot in shots:
            shot.start()
        late = threading.Timer(
            0.2, os.kill, (os.getpid(), signal.SIGTERM)
        )  # if both came too early
        late.start()
        with pytest.raises(PreemptedError):
            training.train()
        assert time.monotonic() - started < 5
        for shot in (*shots, late):
            shot.cancel()
            shot.join()
        for n, handler in guard.items():
            signal.signal(n, handler)
        newest_equals(training, run)
        assert training.run is not None
        training.run.unlock()
        iteration = training.progress.iteration
        training = resumed(plugins, run)
        assert training.progress.iteration == iteration
    straight = make_training(plugins, LONG)
    for _ in range(training.progress.iteration):
        straight.iterate()
    assert_same_state(straight.state_dict(), training.state_dict())


def test_during_a_save(plugins: Plugins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    training = make_training(plugins, [*LONG, "checkpoint.minutes=0"], tmp_path / "run")
    fsync = os.fsync

    def interrupted(descriptor: int) -> None:
        if training.progress.iteration >= 2:
            os.kill(os.getpid(), signal.SIGTERM)
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", interrupted)
    with pytest.raises(PreemptedError):
        training.train()
    newest_equals(training, tmp_path / "run")
    assert training.progress.iteration in (2, 3)
    assert not list((tmp_path / "run/checkpoints").glob(".*"))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_the_command(plugins: Plugins, tmp_path: Path, number: signal.Signals) -> None:
    run = tmp_path / "run"
    code, errors_file = f"{CLI}sys.exit(main(['train', *sys.argv[1:]]))", tmp_path / "errors"
    child = begin_code(
        code, *LONG, f"run.dir={run}", cwd=tmp_path, out=Path(os.devnull), err=errors_file
    )
    wait_for(child, run / "metrics.jsonl")
    os.kill(child.pid, number)
    child.join(30)
    errors = errors_file.read_text()
    assert child.exitcode == 75, errors
    last = errors.strip().splitlines()[-1]
    assert last.startswith(f"understudy: Stopped by {number.name} after ")
    assert last.endswith(f"Continue with `understudy resume {run}`.")
    assert resumed(plugins, run).progress.samples > 0


EVALUATED = (*FAKE_TASK, *SMALL, "budget.samples=1280", "evaluation.every_samples=256", "evaluation.gate=0",
             "evaluation.episodes=4", "evaluation.final_episodes=4", "evaluation.seconds=0.5")  # fmt: skip


@pytest.mark.parametrize("moment", ["before an evaluation", "in an evaluation", "after one"])
def test_an_evaluation_is_neither_lost_nor_doubled(
    plugins: Plugins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    """One that the signal keeps from being made, or ends, is made when the run goes on."""
    straight = make_training(plugins, EVALUATED, tmp_path / "straight")
    straight.train()
    training = make_training(plugins, EVALUATED, tmp_path / "run")
    evaluate, iterate, began, ended = training.job.evaluate, training.iterate, [], []

    def stopped_iterate() -> dict[str, Any]:
        row = iterate()
        if row["iteration"] == {"before an evaluation": 4, "after one": 5}.get(moment):
            signal.raise_signal(signal.SIGTERM)
        return row

    def stopped_evaluate(draw: str, episodes: int, **options: Any) -> Any:
        began.append(draw)
        if moment == "in an evaluation" and draw == "evaluation/2":
            signal.raise_signal(signal.SIGUSR1)
        found = evaluate(draw, episodes, **options)
        ended.append(draw)
        return found

    monkeypatch.setattr(training, "iterate", stopped_iterate)
    monkeypatch.setattr(training.job, "evaluate", stopped_evaluate)
    with pytest.raises(PreemptedError, match=r"after (512|640) samples"):
        training.train()
    newest_equals(training, tmp_path / "run")
    expected = 1 if moment == "before an evaluation" else 2
    assert began == [f"evaluation/{n + 1}" for n in range(expected)]
    assert len(ended) == (2 if moment == "after one" else 1), "a signal does not wait for its end"
    assert training.run is not None
    training.run.unlock()
    assert training.run is not None
    training.run.unlock()
    again = resumed(plugins, tmp_path / "run")
    again.train()
    assert_same_state(straight.state_dict(), again.state_dict())
    assert straight.run is not None
    assert again.run is not None
    clocks = ("seconds", "samples_per_second", "collect_share")
    one, other = (
        [{k: v for k, v in row.items() if k not in clocks} for row in run.metrics()]
        for run in (straight.run, again.run)
    )
    assert one == other
    assert sum("evaluation/return" in row for row in other) == 5


def test_a_signal_that_a_library_took_is_taken_back() -> None:
    with StopRequest():
        signal.signal(signal.SIGUSR1, signal.SIG_DFL)
        with StopRequest() as stop:
            signal.raise_signal(signal.SIGUSR1)
            assert stop.received == signal.SIGUSR1
