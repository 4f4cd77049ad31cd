"""What the commands do: train, resume, evaluate, render; with progress, and files left behind."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from understudy import distributed
from understudy.errors import RunError
from understudy.records import checkpoint, runs
from understudy.records.recording import Recording
from understudy.records.runs import Run
from understudy.running.evaluation import Evaluation, Evaluator
from understudy.running.training import Outcome, Reporter, Training
from understudy.setup.building import build_policy
from understudy.setup.config import Experiment, compose_raw, replaced, validate
from understudy.setup.plugins import installed
from understudy.task.interfaces import Policy


class Display:
    """Progress of a training: a live line on a terminal, a line now and then elsewhere."""

    def __init__(self, experiment: Experiment) -> None:
        self._console = Console(stderr=True, highlight=False)
        self._budget = experiment.root.budget
        self._live: Progress | None = None
        self._task: Any = None
        self._printed = 0.0
        if self._console.is_terminal:
            self._live = Progress(
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
    training = Training(experiment)
    if distributed.rank() > 0:
        return _follow(training)
    run = runs.create(experiment, overrides, training.sources())
    return _carry_out(training.attach(run), run)


def _follow(training: Training) -> int:
    """Train beside process 0, which alone writes and reports."""
    try:
        training.train()
    finally:
        training.close()
        distributed.stop()
    return 0


def resume(path: str, overrides: Sequence[str]) -> int:
    """Continue the run at `path` to its criterion or budget."""
    run = runs.open_run(path)
    registry = installed().registry
    if overrides:
        composed = compose_raw(replaced(run.info["overrides"], overrides))
        composed["run"] = run.config["run"]
        run.info["config"] = composed
        run.info["overrides"] = replaced(run.info["overrides"], overrides)
    experiment = validate(run.config, registry)
    distributed.start(experiment.root.device)
    if distributed.rank() == 0:
        run.lock()
    leading = distributed.rank() == 0
    tell = Console(stderr=True, highlight=False)
    reporter = Reporter(message=lambda text: tell.print(text, markup=False) if leading else None)
    training = Training(experiment, reporter).attach(run)
    training.resume()
    if not leading:
        return _follow(training.detach())
    if overrides:  # what trains the weights from here on is what the folder says
        run.write_json("run.json", run.info)
    return _carry_out(training, run)


def _carry_out(training: Training, run: Run) -> int:
    display = Display(training.experiment)
    training.reporter = Reporter(display.iteration, display.message, installed().observers())
    try:
        outcome = training.train()
    finally:
        display.close()
        training.close()
        distributed.stop()
    _finish(training, run, outcome, display)
    print(f"run: {run.path}")
    run.unlock()
    return 0


def _finish(training: Training, run: Run, outcome: Outcome, display: Display) -> None:
    progress = outcome.progress
    minutes = progress.seconds / 60
    display.message(
        f"Done by its {outcome.reason}: {progress.samples:,} samples in {minutes:.1f} min of training."
    )
    for name, count in training.environment.parts.simulator.report().items():
        display.message(f"The simulator counted {count} × {name.replace('_', ' ')}.")
    evaluator = Evaluator(training.experiment, training.built.context)
    try:
        _evaluate_and_record(evaluator, training.policy, run, progress.samples, training.reporter)
    finally:
        evaluator.close()


def evaluate(path: str, overrides: Sequence[str]) -> int:
    """Evaluate the newest checkpoint of the run at `path`; writes ``evaluation.json``."""
    run, evaluator, policy, samples = _load(path, overrides)
    try:
        evaluation = evaluator.run(policy)
    finally:
        evaluator.close()
    result = evaluation.as_json(samples)
    run.write_json("evaluation.json", result)
    print(json.dumps(result, indent=1))
    return 0


def render(path: str, overrides: Sequence[str]) -> int:
    """Evaluate once more while recording, for whoever draws it."""
    run, evaluator, policy, samples = _load(path, overrides)
    reporter = Reporter(
        message=lambda text: print(text, file=sys.stderr), observers=installed().observers()
    )
    try:
        _evaluate_and_record(evaluator, policy, run, samples, reporter)
    finally:
        evaluator.close()
    print(f"run: {run.path}")
    return 0


def _load(path: str, overrides: Sequence[str]) -> tuple[Run, Evaluator, Policy, int]:
    run = runs.open_run(path)
    if overrides:
        run.info["config"] = compose_raw(replaced(run.info["overrides"], overrides))
    experiment = validate(run.config, installed().registry)
    state, _, _ = checkpoint.load_newest(run.checkpoints, lambda text: print(text, file=sys.stderr))
    evaluator = Evaluator(experiment)
    policy = build_policy(experiment, evaluator.built.context)
    try:
        policy.load_state_dict(state["policy"])
    except RuntimeError as error:
        raise RunError(
            f"The checkpoint of {path} does not fit this policy: {str(error).splitlines()[1].strip()}"
        ) from error
    policy.schedule(state["progress"]["samples"])
    return run, evaluator, policy, state["progress"]["samples"]


def _evaluate_and_record(
    evaluator: Evaluator, policy: Policy, run: Run, samples: int, reporter: Reporter
) -> Evaluation:
    """Evaluate while recording, write ``evaluation.json`` and ``recording.npz``, and tell the
    observers."""
    environment, scene = evaluator.built.environment, evaluator.built.scene
    fields = [name for name in scene.recorded if name in environment.table.shapes]
    limit = round(evaluator.experiment.root.run.video_seconds / environment.control_dt)
    recording: dict[str, list[torch.Tensor]] = {name: [] for name in fields}
    counted: list[torch.Tensor] = []

    def record(running: torch.Tensor) -> None:
        if fields and len(recording[fields[0]]) < limit:
            for name in fields:
                recording[name].append(environment.table[name][_SHOWN].clone())
            counted.append(running[_SHOWN].clone())

    evaluation = evaluator.run(policy, on_step=record)
    run.write_json("evaluation.json", evaluation.as_json(samples))
    recorded = Recording(
        tracks={k: torch.stack(v).cpu().numpy() for k, v in recording.items() if v},
        control_dt=environment.control_dt,
        first_episode=int(torch.stack(counted).sum()) if counted else 0,
        scene=scene,
    )
    if recorded.tracks:
        recorded.save(run.path / "recording.npz")
    reporter.message(
        f"{evaluation.success_rate:.0%} of {evaluation.episodes} episodes of {evaluation.seconds:g} s "
        f"succeeded; {evaluation.within_all_bounds:.0%} violated no bound."
    )
    reporter.notify("recorded", run, recorded, reporter.message)
    return evaluation


#: The world that is recorded and drawn.
_SHOWN = 0
