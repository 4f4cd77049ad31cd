"""What the commands do: train, resume, evaluate, render; with progress, and files left behind."""

from __future__ import annotations

import contextlib
import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as Bar

from understudy import distributed
from understudy.errors import RunError
from understudy.records import checkpoint, runs
from understudy.records.runs import Run
from understudy.running.training import Outcome, Reporter, Training
from understudy.setup.building import device_of
from understudy.setup.config import Experiment, compose_raw, replaced, validate
from understudy.setup.plugins import installed


class Display:
    """Progress of a run: a live line on a terminal, a line now and then elsewhere."""

    def __init__(self, experiment: Experiment) -> None:
        self._console = Console(stderr=True, highlight=False)
        self._budget = experiment.root.budget
        self._live: Bar | None = None
        self._task: Any = None
        self._printed = 0.0
        if self._console.is_terminal:
            self._live = Bar(
                TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[note]}"),
                console=self._console, transient=True,
            )  # fmt: skip
            self._live.start()
            self._task = self._live.add_task("training", total=1.0, note="")

    def iteration(self, row: Mapping[str, Any]) -> None:
        done, left = self._share(row)
        return_ = row.get("episode/return")
        parts = [
            f"iteration {row['iteration']}",
            f"{row['samples']:,} samples",
            f"{row['samples_per_second']:,.0f}/s",
        ]
        if return_ is not None:
            parts += [f"return {return_:.1f}", f"episode {row['episode/episode_seconds']:.2f} s"]
        if row.get("stage"):
            parts.append(row["stage"])
        if left is not None:
            parts.append(f"at most {_clock(left)} left")
        text = " · ".join(parts)
        if self._live is not None:
            self._live.update(self._task, completed=done, note=text)
        elif time.monotonic() - self._printed > 10:
            self._printed = time.monotonic()
            self._console.print(text, soft_wrap=True)

    def _share(self, row: Mapping[str, Any]) -> tuple[float, float | None]:
        """The share of the budget that is spent, and the seconds left at this speed."""
        shares = []
        if self._budget.samples:
            shares.append(row["samples"] / self._budget.samples)
        if self._budget.minutes:
            shares.append(row["seconds"] / (60 * self._budget.minutes))
        if not shares:
            return 0.0, None
        done = min(1.0, max(shares))
        return done, row["seconds"] * (1 - done) / max(done, 1e-9)

    def message(self, text: str) -> None:
        self._console.print(text, markup=False, soft_wrap=True)

    def close(self) -> None:
        if self._live is not None:
            self._live.stop()


def _clock(seconds: float) -> str:
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def train(experiment: Experiment, overrides: Sequence[str]) -> int:
    """Train a new run; prints ``run: PATH`` last."""
    distributed.start(experiment.root.device)
    with _together(experiment):
        training = Training(experiment).prepare()
        if distributed.rank() == 0:
            run = runs.create(experiment, overrides, training.job.sources())
            training.attach(run)
    return _carry_out(training)


def resume(path: str, overrides: Sequence[str]) -> int:
    """Continue the run at `path` to its criterion or budget."""
    run = runs.open_run(path)
    given = run.info["overrides"]
    if overrides:
        run.info["overrides"] = replaced(given, overrides)
        experiment = validate(compose_raw(run.info["overrides"]), installed().registry)
        run.info["config"] = experiment.effective() | {"run": run.config["run"]}
    experiment = validate(run.config, installed().registry)
    distributed.start(experiment.root.device)
    leading = distributed.rank() == 0
    with _together(experiment):
        if leading:
            run.lock()
        tell = Console(stderr=True, highlight=False)
        reporter = Reporter(
            message=lambda text: tell.print(text, markup=False) if leading else None
        )
        training = Training(experiment, reporter).prepare().attach(run)
        training.resume()
    if not leading:
        training.detach()
    elif overrides:  # what trains the weights from here on is what the folder says
        run.write_json("run.json", run.info)
    return _carry_out(training)


@contextlib.contextmanager
def _together(experiment: Experiment) -> Iterator[None]:
    """Inside, a process that refuses to start makes all of them refuse, instead of waiting for it."""
    failed = True
    try:
        yield
        failed = False
    finally:
        refused = distributed.anyone(failed, device_of(experiment.root.device))
        if refused:
            distributed.stop()
        if refused and not failed:
            raise RunError("Another process could not start; its own message says why.")


def _carry_out(training: Training) -> int:
    run = training.run
    if run is None:  # beside process 0, which alone writes and reports
        try:
            training.train()
        finally:
            training.close()
            distributed.stop()
        return 0
    display = Display(training.experiment)
    reporter = Reporter(display.iteration, display.message, installed().observers())
    training.reporter = reporter
    try:
        outcome = training.train()
        distributed.stop()
        display.close()
        _tell_outcome(training, outcome, display.message)
        _judge(training, run, reporter)
    finally:
        display.close()
        training.close()
        distributed.stop()
    print(f"run: {run.path}")
    run.unlock()
    return 0


def _tell_outcome(training: Training, outcome: Outcome, tell: Callable[[str], None]) -> None:
    progress = outcome.progress
    tell(
        f"Done ({outcome.reason}): {progress.samples:,} samples in {progress.seconds / 60:.1f} min "
        "of training."
    )
    for name, count in training.job.report().items():
        tell(f"The simulator counted {count} × {name.replace('_', ' ')}.")


def _judge(training: Training, run: Run, reporter: Reporter) -> None:
    """The last evaluation while recording: ``evaluation.json``, ``recording.npz``, and whatever the
    observers make of them."""
    evaluation, recording = training.judge(training.experiment.root.run.video_seconds)
    run.write_json("evaluation.json", evaluation.as_json(training.progress.samples))
    if recording is not None:
        recording.save(run.path / "recording.npz")
    reporter.notify("judged", run, recording, reporter.message)
    reporter.message(f"On starts never used in training: {evaluation.sentence()}")


def evaluate(path: str, overrides: Sequence[str]) -> int:
    """Evaluate the newest checkpoint of the run at `path`; writes ``evaluation.json``."""
    training, run, _ = _load(path, overrides)
    try:
        evaluation, _ = training.judge()
    finally:
        training.close()
    result = evaluation.as_json(training.progress.samples)
    run.write_json("evaluation.json", result)
    print(json.dumps(result, indent=1))
    return 0


def render(path: str, overrides: Sequence[str]) -> int:
    """Evaluate once more while recording, and draw video and report."""
    training, run, reporter = _load(path, overrides)
    reporter.observers = installed().observers()
    try:
        _judge(training, run, reporter)
    finally:
        training.close()
    print(f"run: {run.path}")
    return 0


def _load(path: str, overrides: Sequence[str]) -> tuple[Training, Run, Reporter]:
    run = runs.open_run(path)
    config = run.config
    if overrides:
        config = compose_raw(replaced(run.info["overrides"], overrides))
    reporter = Reporter(message=lambda text: print(text, file=sys.stderr))
    state, _, _ = checkpoint.load_newest(run.checkpoints, reporter.message)
    training = Training(validate(config, installed().registry), reporter)
    training.load_learned(state)
    return training, run, reporter
