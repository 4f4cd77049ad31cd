"""One trial: a run folder in the sweep's, begun or continued, in the process that an executor chooses."""

from __future__ import annotations

import contextlib
import json
import math
import time
from collections.abc import Generator, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

import torch
from hydra.core.override_parser.types import Quote, QuotedString

from understudy.command.command import tell
from understudy.errors import ConfigError, FileError, RunError, TrainingError
from understudy.folders import read, write_atomically
from understudy.records import runs
from understudy.records.runs import Run
from understudy.running.jobs import Judgement
from understudy.running.training import Reporter, Training
from understudy.setup.composition import load_experiment, replaced
from understudy.signals import StopRequest
from understudy_reinforcement.job import Reinforcement
from understudy_report.progress import Lines
from understudy_report.values import mapping
from understudy_sweeps.loops import Report, Trial, Work
from understudy_training.unread import noting, unread
from understudy_training.workflow import leave_damaged_rows_out

__all__ = ["folder_of", "run_trial", "written"]

#: In a trial's folder: after how many samples the outer loop ended it early.
_STOPPED = "stopped.json"
#: In a trial's folder, once it is finished: what it was judged by.
JUDGED = "evaluation.json"
#: How the status begins of a trial which shows that the search makes no sense, or a variant of which a file is missing:
#: the sweep ends.
REFUSED = "refused: "
#: Seconds to wait for whoever still holds the folder: a process whose sweep was killed saves first.
PATIENCE = 60.0


def folder_of(key: str, sweep: str | Path) -> Path:
    """The run folder of the trial `key`, which is inside the sweep's whatever the key is."""
    name = quote(key, safe="")
    return Path(sweep) / (name if name.strip(".") else name.replace(".", "%2E"))


def note_stop(key: str, samples: float, work: Work) -> None:
    """Let the trial end with what it had learned after `samples`, however often it is begun anew."""
    path = folder_of(key, work.folder)
    path.mkdir(parents=True, exist_ok=True)
    write_atomically(path / _STOPPED, json.dumps({"samples": samples}).encode())


def check_device(work: Work) -> None:
    """Refuse a GPU that is not here before any trial: a search would take its failure for a finding.

    Raises
    ------
    ConfigError
        torch sees none; nothing else is asked of it here.
    """
    if work.device.startswith("cuda") and not torch.cuda.is_available():
        raise ConfigError(f"device={work.device}, but torch sees no CUDA GPU here. Use device=cpu.")


def run_trial(trial: Trial, work: Work) -> Generator[Report | None, bool | None, None]:
    """Carry out a trial in its own run folder, or continue it; a failure becomes a report.

    Gives a report after every evaluation and in the end, and None after every other iteration.
    Reports that an earlier process may have made before it ended are made again. Sending it True
    ends the trial early, with what it has learned by then. A caller that closes it leaves the trial
    saved and resumable.
    """
    path = folder_of(trial.key, work.folder)
    tell(f"{trial.key}: {path}")
    _await(path)
    try:
        training = _open(path, trial, work)
    except _Refused as error:
        yield Report(trial.key, f"{REFUSED}{error}", run=str(path))
        return
    except (ConfigError, FileError, RunError) as error:
        if isinstance(error, FileError) and trial.variant and not (path / "run.json").exists():
            said = f"Variant '{trial.variant}' cannot begin: {error} Mend that and repeat the command, which goes on."
            yield Report(trial.key, REFUSED + said, run=str(path))
            return
        yield Report(trial.key, f"failed: {error}", run=str(path))
        return
    run = training.run
    assert run is not None
    try:
        last = _stopped_at(run)
        stopped = yield from _iterate(trial, training, run, last)
        root = training.experiment.root
        with StopRequest(at_once=True):  # it may take minutes, and can be made again
            evaluation, recording = training.judge(root.run.video_seconds)
        if recording is not None and recording.tracks:
            recording.save(run.path / "recording.npz")
        run.write_json(JUDGED, evaluation.as_json(training.progress.samples))
        run.info["judged"] = training.progress.samples  # else it is listed as unfinished
        run.write_json("run.json", run.info)
        yield _result(trial, evaluation, training, "stopped" if stopped else training.outcome)
    except TrainingError as error:  # anything else is no finding: what carries it out says so
        samples = float(training.progress.samples)
        yield Report(trial.key, f"failed: {error}", cost=samples, run=str(path))
    finally:
        training.close()
        run.unlock()


def _iterate(
    trial: Trial, training: Training, run: Run, last: float
) -> Generator[Report | None, bool | None, bool]:
    """Train until the end, a stop, or `last` samples; returns whether it was stopped."""
    name = f"evaluation/{training.experiment.root.evaluation.objective}"

    def report(row: Mapping[str, Any]) -> Report | None:
        """Of an evaluation, be it one that was given up and has no objective."""
        if not any(key.startswith("evaluation/") for key in row):
            return None
        samples, objective = row["samples"], row.get(name)
        return Report(trial.key, "running", objective, _figures(row), samples, str(run.path))

    for row in run.metrics():
        again = report(row)
        if again is not None and (yield again):
            return True
    with contextlib.closing(training.rows()) as rows:
        while training.progress.samples < last:
            row = next(rows, None)
            if row is None:
                return False
            if (yield report(row)):
                return True
    return True


def _stopped_at(run: Run) -> float:
    try:
        return float(json.loads(read(run.path / _STOPPED))["samples"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return math.inf


def overrides_of(trial: Trial, work: Work) -> list[str]:
    """The configuration of the run that the trial is. It is a run like any other, so it has neither
    outer loop nor executor."""
    own: list[str] = []
    if trial.seed is not None:
        own.append(f"seed={trial.seed}")
    if trial.fidelity is not None:
        own.append(f"difficulty={trial.fidelity!r}")
    if trial.start is not None:
        own.append(f"start={written(trial.start)}")
    if trial.initial_states is not None:
        own.append(f"initial_states={written({'name': 'bank', 'file': trial.initial_states})}")
    own += [
        "outer_loop=null",
        "executor=null",
        f"run.dir={written(str(folder_of(trial.key, work.folder)))}",
    ]
    keys = {override.partition("=")[0] for override in own}
    for override in (*trial.overrides, *trial.point):
        key = override.lstrip("+~").partition("=")[0]
        if key in keys or key.partition(".")[0] in ("outer_loop", "executor"):
            instead = "give outer_loop.seeds the seeds" if key == "seed" else "leave it out"
            raise ConfigError(
                f"{override} is overruled, since a sweep says that of each of its trials: {instead}."
            )
    for override in trial.overrides:
        if override.lstrip("+~").partition("=")[0] in trial.point:
            raise ConfigError(f"{override} is overruled by what is searched: leave it out.")
    return replaced(work.overrides, [*trial.overrides, *_point(trial), *own])


def _point(trial: Trial) -> list[str]:
    return [f"{name}={value!r}" for name, value in trial.point.items()]


def written(value: Any) -> str:
    """Plain data as the value of an override, with every string quoted."""
    if isinstance(value, Mapping):
        return "{" + ",".join(f"{key}:{written(item)}" for key, item in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ",".join(written(item) for item in value) + "]"
    if isinstance(value, str):
        return QuotedString(value, Quote.single).with_quotes()
    return json.dumps(value)


class _Refused(Exception):
    """No trial of this search can mean what it is asked for; says why."""


def _open(path: Path, trial: Trial, work: Work) -> Training:
    reporter = Reporter(message=tell, observers=[Lines(tell)])
    if (path / "run.json").exists():
        run = runs.open_run(path)
        with contextlib.ExitStack() as refused:
            refused.callback(run.unlock)
            run.lock()
            leave_damaged_rows_out(run)
            experiment = run.experiment(config=_config_here(run))
            training = Training(experiment, reporter).prepare().attach(run)
            training.resume()
            refused.pop_all()
        return training
    overrides = overrides_of(trial, work)
    experiment = noting(load_experiment(overrides))
    training = Training(experiment, reporter).prepare()
    for note in unread(experiment, [*trial.overrides, *_point(trial)]):
        tell(f"{trial.key}: {note}")
    if trial.fidelity is not None:
        _check_difficulty(training)
    return training.attach(runs.create(experiment, overrides, training.job.sources()))


def _config_here(run: Run) -> Mapping[str, Any]:
    """Its configuration; the run that it begins with is beside it where it was so before their folder was copied."""
    start, made = mapping(run.config.get("start")), mapping(run.config.get("run")).get("dir")
    begun = start.get("run")
    if not isinstance(begun, str) or not isinstance(made, str):
        return run.config
    before = Path(made).parent
    if not before.parts or not Path(begun).is_relative_to(before):
        return run.config
    here = run.path.parent / Path(begun).relative_to(before)
    return {**run.config, "start": {**start, "run": str(here)}}


def _check_difficulty(training: Training) -> None:
    """Refuse a trial that is asked for at some difficulty of a task that has none."""
    if isinstance(training.job, Reinforcement) and not training.job.has_difficulty():
        raise _Refused(
            "Nothing in this task reads `difficulty`, so trials at a low one would be neither easier "
            "nor cheaper, and tell nothing. Choose an experiment whose parts read it, a search of whole "
            "trials (outer_loop.name=gp_ucb), or one by another fidelity (outer_loop.name=boca "
            "'outer_loop.fidelity={option: budget.samples, low: …, high: …, integer: true}')."
        )


def _await(path: Path) -> None:
    """Make the folder `path`, and wait until no other process trains in it.

    Raises
    ------
    RunError
        if somebody still does after ``PATIENCE``, or the folder cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunError(f"The run folder {path} cannot be made: {error.strerror}.") from error
    folder, deadline = Run(path, {}), time.monotonic() + PATIENCE
    while True:
        try:
            folder.lock()
            return folder.unlock()
        except RunError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.1)


def _figures(row: Mapping[str, Any]) -> dict[str, float]:
    """What was measured, by name; and how far the curriculum is, as the row names it."""
    return {
        name.removeprefix("evaluation/"): value
        for name, value in row.items()
        if name.startswith(("evaluation/", "curriculum/")) and isinstance(value, int | float)
    }


def _result(trial: Trial, evaluation: Judgement, training: Training, outcome: str) -> Report:
    assert training.run is not None
    return Report(
        trial.key,
        "ok",
        evaluation.objective_value,
        _figures(evaluation.row()),
        float(training.progress.samples),
        str(training.run.path),
        outcome,
    )
