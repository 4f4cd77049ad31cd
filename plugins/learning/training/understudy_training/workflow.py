"""What the commands train and resume do."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import torch

from understudy import distributed
from understudy.command.command import tell
from understudy.errors import ConfigError, RunError
from understudy.folders import opened
from understudy.options import at
from understudy.records import runs
from understudy.records.runs import Run
from understudy.running.training import Reporter, Training
from understudy.setup.building import device_of
from understudy.setup.composition import compose_raw, load_experiment
from understudy.setup.config import Experiment
from understudy.setup.plugins import installed
from understudy.setup.validation import validate
from understudy.signals import StopRequest
from understudy_training import processes, watching
from understudy_training.left_out import leave_out
from understudy_training.unread import noting, unread

__all__ = ["judge", "leave_damaged_rows_out"]


def train(overrides: Sequence[str]) -> int:
    """Train a new run; prints ``run: PATH`` last."""
    experiment = noting(load_experiment(overrides))
    processes.start(experiment.root.device)
    with _together(experiment):
        if distributed.rank() == 0 and (folder := experiment.root.run.dir):
            with contextlib.suppress(OSError):  # which making it tells of
                runs.refuse_a_second(Path(folder))  # not after the minutes that building may take
        training = Training(experiment).prepare()
        if distributed.rank() == 0:
            for note in (*training.job.notes(), *unread(experiment, overrides)):
                tell(note)
            with StopRequest() as stop:  # the folder is made whole or not at all
                run = runs.create(experiment, overrides, training.job.sources())
                stop.advise(f"Continue with `understudy resume {run.path}`.")
            training.attach(run)
    return _carry_out(training)


def resume(path: str, overrides: Sequence[str]) -> int:
    """Continue the run at `path` to its criterion or budget."""
    if path in installed().registry.names("skill") and not Path(path).exists():
        folder = f"runs/{path.replace('/', '-')}"
        raise RunError(
            f"{path} is a skill, whose training is over. `understudy play {path}` shows it, and `understudy play {path} "
            f"--unpack {folder}` makes a run with which another training begins: `understudy train experiment=NAME "
            f"start.run={folder}`."
        )
    run = runs.open_run(path)
    count = at(run.info, "machine.threads")  # the same bits follow at an equal number
    if type(count) is int and 0 < count <= runs.cores() and "OMP_NUM_THREADS" not in os.environ:
        torch.set_num_threads(count)
    if overrides:
        run.info["overrides"] = run.words(overrides)
        experiment = validate(compose_raw(run.info["overrides"]), installed().registry)
        config = experiment.effective()
        _refuse_another(run, experiment)
        config["run"] |= {"dir": at(run.config, "run.dir")}
        run.info["config"] = config
    experiment = noting(run.experiment())
    processes.start(experiment.root.device)
    leading = distributed.rank() == 0
    with _together(experiment), contextlib.ExitStack() as refused:
        refused.callback(run.unlock)  # of a program that goes on
        if leading:
            run.lock()
            leave_damaged_rows_out(run)
        reporter = Reporter(message=tell if leading else lambda text: None)
        training = Training(experiment, reporter).prepare().attach(run)
        training.resume()
        for note in unread(experiment, overrides):
            reporter.message(note)
        refused.pop_all()
    progress = training.progress
    judged = run.judged() == progress.samples and not training.changed
    if training.ended() and not progress.pending and judged:
        more = {"criterion": "evaluation.criterion=null", "budget": "a larger budget.samples=…"}
        hint = f" With {more[training.outcome]} it goes on." if training.outcome in more else ""
        if leading:
            tell(f"{run.path} is finished ({training.outcome}).{hint}")
            print(f"run: {run.path}")
        training.close()
        processes.stop()
        run.unlock()
        return 0
    if not leading:
        training.attach(None)
    elif overrides:  # what trains the weights from here on is what the folder says
        run.info["inputs"] = experiment.inputs.copy(run.path / "inputs")
        run.write_json("run.json", run.info)
    return _carry_out(training)


def _refuse_another(run: Run, experiment: Experiment) -> None:
    """Raise ConfigError if what the words make of `run` is another run by its seed or its folder."""
    begun, seed = at(run.config, "seed"), experiment.root.seed
    if type(begun) is int and seed != begun:
        raise ConfigError(
            f"seed={seed} is another run's: {run.path} was begun with seed {begun}, which cannot change. Give "
            f"`understudy train` seed={seed}, with start.run={run.path} if it is to begin with what "
            "was learned here."
        )
    folder = experiment.root.run.dir
    if folder and Path(folder).resolve() not in {
        Path(f).resolve() for f in (run.path, at(run.config, "run.dir")) if f
    }:
        raise ConfigError(
            f"run.dir={folder} is another run's folder: {run.path} goes on where it is. Leave it out, or copy the folder "
            f"and resume the copy: `cp -r {run.path} {folder}`."
        )


def leave_damaged_rows_out(run: Run) -> None:
    """Keep the rows of the metrics that a crash, or a full disk, cut short beside them, and say so: resuming leaves them out."""
    run.metrics()  # sees to it that it is a file, and of what size
    if not run.metrics_file.exists():
        return
    with opened(run.metrics_file, 2**34) as file:
        leave_out(run.metrics_file, (line for line in file if not _is_row(line)))


def _is_row(line: bytes) -> bool:
    try:
        return isinstance(json.loads(line.decode(errors="replace")), dict)
    except (ValueError, RecursionError):
        return False


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
            processes.stop()
        if refused and not failed:
            raise RunError("Another process could not start; its own message says why.")


def _carry_out(training: Training) -> int:
    run = training.run
    if run is not None:  # process 0, which alone writes and reports
        training.reporter = watching.reporter()
    try:
        reason, progress = training.train(), training.progress
        processes.stop()
        if run is None:
            return 0
        time = f"{progress.seconds / 60:.1f} min of training"
        if progress.seconds > 61 * (training.experiment.root.budget.minutes or progress.seconds):
            each = progress.seconds / progress.iteration / 60
            time += (
                f", more than budget.minutes, since an iteration takes {each:.1f} and is finished"
            )
        tell(f"Done ({reason}): {progress.samples:,} samples in {time}.")
        for name, count in training.job.report().items():
            tell(f"The simulator counted {count} × {name.replace('_', ' ')}.")
        judge(training, run, training.reporter)
        run.info["judged"] = progress.samples
        run.write_json("run.json", run.info)
    finally:
        training.close()
        processes.stop()
    print(f"run: {run.path}")
    run.unlock()
    return 0


def judge(
    training: Training,
    run: Run,
    reporter: Reporter,
    changed: Sequence[str] = (),
    seconds: float | None = None,
) -> None:
    """The last evaluation while recording: ``evaluation.json``, ``recording.npz``, and whatever the
    observers make of them. `changed` are overrides with which the run was not trained; `seconds`, of the
    recording, the run's own without it."""
    length = training.experiment.root.run.video_seconds if seconds is None else seconds
    evaluation, recording = training.judge(length)
    run.write_json("evaluation.json", evaluation.as_json(training.progress.samples, changed))
    if recording is not None:
        recording.save(run.path / "recording.npz")
    reporter.notify("judged", run, recording, reporter.message)
    reporter.message(f"On starts never used in training: {evaluation.sentence()}")
