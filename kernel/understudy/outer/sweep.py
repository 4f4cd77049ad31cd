"""Outer loops over trainings: ``understudy sweep ablation=…`` or ``outer_loop=grid …``.

The journal (``journal.jsonl`` in the sweep's folder) has one row per finished trial. Starting the same
sweep again tells the outer loop what the journal knows and asks for the rest, so a sweep that was
stopped goes on where it was; a trial that was cut short resumes from its own checkpoint.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from understudy import distributed
from understudy.errors import ConfigError, RunError, TrainingError
from understudy.outer.trials import Executor, OuterLoop, Result, Trial
from understudy.records import runs
from understudy.records.checkpoint import write_atomically
from understudy.running.training import Reporter, Training
from understudy.setup.config import compose_raw, load_experiment, validate
from understudy.setup.plugins import installed


def sweep(overrides: Sequence[str]) -> int:
    """Run the sweep that `overrides` describe; prints a table and the sweep's folder."""
    raw = compose_raw(overrides)
    experiment = validate(raw, installed().registry)
    if experiment.outer_loop is None:
        raise ConfigError("outer_loop is not set. Choose one: understudy sweep outer_loop=grid …")
    if experiment.executor is None:
        raise ConfigError("executor is not set. Choose one: executor=in_process.")
    loop: OuterLoop = experiment.outer_loop.build(None)
    executor: Executor = experiment.executor.build(None)
    folder = Path(experiment.root.run.dir or Path("runs") / f"sweep-{_fingerprint(raw)}")
    if distributed.requested() > 1:
        raise ConfigError("A sweep runs its trials in one process: start it without torchrun.")
    folder.mkdir(parents=True, exist_ok=True)
    book = runs.Run(folder, {})
    book.lock()
    _refuse_another(folder / "sweep.json", raw)
    journal = folder / "journal.jsonl"
    known = read_journal(journal)
    rows = [json.dumps(dataclasses.asdict(result)) + "\n" for result in known]
    write_atomically(journal, "".join(rows).encode())  # without a row that a crash cut short
    for result in known:
        loop.tell(result)
    base = [o for o in overrides if not re.match(r"[+~]*(run\.dir|outer_loop|executor|seed)\b", o)]

    def train(trial: Trial) -> Result:
        return run_trial(trial, base, folder)

    while (trial := loop.ask()) is not None:
        for result in executor.run([trial], train):
            with open(journal, "a", encoding="utf-8") as file:
                file.write(json.dumps(dataclasses.asdict(result)) + "\n")
            loop.tell(result)
    table = loop.summary()
    book.write_json("summary.json", table)
    book.unlock()
    _print_table(table)
    print(f"sweep: {folder}")
    return 0


def _refuse_another(path: Path, raw: Mapping[str, Any]) -> None:
    """A folder belongs to one sweep: its trials are known by their names alone."""
    mark = json.dumps({"sweep": _fingerprint(raw)}).encode()
    if path.exists() and path.read_bytes() != mark:
        raise RunError(
            f"{path.parent} holds another sweep. Give run.dir another folder, or repeat that one."
        )
    write_atomically(path, mark)


def _fingerprint(raw: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(raw, sort_keys=True, default=str).encode()).hexdigest()[:8]


def read_journal(path: Path) -> list[Result]:
    """The results of a journal; a row cut short by a crash is left out."""
    results = []
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                results.append(Result(**json.loads(line)))
            except (ValueError, TypeError):
                continue
    return results


def run_trial(trial: Trial, base: Sequence[str], folder: Path) -> Result:
    """Train one trial in its own run folder, or go on with it; a failure becomes a result."""
    path = folder / quote(trial.key, safe="")
    overrides = [*base, *trial.overrides, f"run.dir={path}"]
    print(f"{trial.key}: {path}", file=sys.stderr)
    try:
        training, evaluation = _train(path, overrides)
    except (ConfigError, TrainingError) as error:  # anything else is no finding: it stops the sweep
        return Result(trial.key, f"failed: {error}", run=str(path))
    return Result(
        trial.key,
        "ok",
        objective=evaluation.success_rate,
        features={
            "within_all_bounds": evaluation.within_all_bounds,
            "mean_episode_seconds": evaluation.mean_episode_seconds,
        },
        cost=float(training.progress.samples),
        run=str(path),
    )


def _train(path: Path, overrides: list[str]) -> tuple[Training, Any]:
    reporter = Reporter(message=lambda text: print(text, file=sys.stderr))
    if (path / "run.json").exists():
        run = runs.open_run(path)
        run.lock()
        training = Training(validate(run.config, installed().registry), reporter).attach(run)
        training.resume()
    else:
        experiment = load_experiment(overrides)
        training = Training(experiment, reporter)
        run = runs.create(experiment, overrides, training.sources())
        training.attach(run)
    try:
        training.train()
        evaluation = training.evaluate()
        run.write_json("evaluation.json", evaluation.as_json(training.progress.samples))
        return training, evaluation
    finally:
        training.close()
        run.unlock()


def _print_table(rows: list[dict[str, Any]]) -> None:
    if not rows:
        return
    columns = list(rows[0])
    cells = [[_cell(row[c]) for c in columns] for row in rows]
    widths = [max(len(c), *(len(r[i]) for r in cells)) for i, c in enumerate(columns)]
    for row in [columns, *cells]:
        print("  ".join(f"{value:<{width}}" for value, width in zip(row, widths, strict=True)))


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"
    return "–" if value is None else str(value)
