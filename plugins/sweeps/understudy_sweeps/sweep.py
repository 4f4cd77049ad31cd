"""Outer loops over whole runs: ``understudy sweep ablation=…`` or ``outer_loop=grid …``.

The journal (``journal.jsonl`` in the sweep's folder) has a row when a trial is asked for, when it
reports, and when it is finished, with the whole trial in the first. Starting the same sweep again
tells the outer loop what the journal knows, goes on with what was asked for and not finished, and
asks for the rest.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import re
import sys
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote

from hydra.core.override_parser.types import Quote, QuotedString

from understudy import distributed
from understudy.errors import ConfigError, FileError, RunError, TrainingError
from understudy.records import runs
from understudy.records.checkpoint import write_atomically
from understudy.running.evaluation import Evaluation
from understudy.running.training import Reporter, Training
from understudy.running.trials import Executor, OuterLoop, Report, Trial, Work
from understudy.setup.composition import compose_raw, load_experiment, replaced
from understudy.setup.config import Experiment, validate
from understudy.setup.plugins import installed


def sweep(overrides: Sequence[str]) -> int:
    """Run the sweep that `overrides` describe; prints a table and the sweep's folder."""
    experiment = validate(compose_raw(overrides), installed().registry)
    if distributed.requested() > 1:
        raise ConfigError("A sweep runs its trials in one process: start it without torchrun.")
    seed = experiment.root.seed
    loop: OuterLoop = experiment.need("outer_loop").build(seed)
    identity = _identity(experiment, loop)
    folder = Path(experiment.root.run.dir or Path("runs") / f"sweep-{identity}")
    folder.mkdir(parents=True, exist_ok=True)
    base = [o for o in overrides if not re.match(r"[+~]*(run\.dir|outer_loop|executor)\b", o)]
    executor: Executor = experiment.need("executor").build(Work(tuple(base), str(folder)))
    book = runs.Run(folder, {})
    book.lock()
    try:
        _refuse_another(folder / "sweep.json", identity)
        journal = Journal.open(folder / "journal.jsonl")
        _carry_out(loop, executor, journal)
        table = loop.summary()
        book.write_json("summary.json", table)
    finally:
        executor.close()
        book.unlock()
    _print_table(table)
    print(f"sweep: {folder}")
    return 0


def _carry_out(loop: OuterLoop, executor: Executor, journal: Journal) -> None:
    """Replay the journal, then ask, run and tell until there is nothing left to ask for."""
    waiting: list[Trial] = []
    for event in journal.events:  # in the order in which it happened
        if isinstance(event, Report):
            loop.tell(event)
        elif loop.recall(event) and event.key not in journal.finished:
            waiting.append(event)
    number = len(journal.asked)
    running = 0
    while True:
        while executor.free() > 0:
            trial = waiting.pop(0) if waiting else None
            if trial is None:
                trial = loop.ask(number)
                if trial is None:
                    break
                number += 1
                journal.ask(trial)
            executor.start(_placed(trial, journal))
            running += 1
        if running == 0:
            return
        report = executor.wait()
        journal.tell(report)
        running -= report.final
        if loop.tell(report) == "stop" and not report.final:
            executor.stop(report.key)


def _placed(trial: Trial, journal: Journal) -> Trial:
    """The trial, beginning from the run folder of the earlier trial that its ``start`` names."""
    start = dict(trial.start or {})
    earlier = start.pop("trial", None)
    if earlier is None:
        return trial
    if earlier not in journal.finished:
        raise RunError(f"Trial '{trial.key}' begins from '{earlier}', which is not finished.")
    return dataclasses.replace(trial, start={**start, "run": journal.finished[earlier].run})


def _identity(experiment: Experiment, loop: OuterLoop) -> str:
    """What the sweep compares: its configuration less what may be added to it later."""
    raw = experiment.effective()
    for key in ("run", "executor", "seed"):
        raw.pop(key)
    for name in loop.extendable:
        raw["outer_loop"].pop(name)
    text = json.dumps(raw, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:8]


def _refuse_another(path: Path, identity: str) -> None:
    """A folder belongs to one sweep: its trials are known by their names alone."""
    mark = json.dumps({"sweep": identity}).encode()
    if path.exists() and path.read_bytes() != mark:
        raise RunError(
            f"{path.parent} holds another sweep. Give run.dir another folder, or repeat that one."
        )
    write_atomically(path, mark)


@dataclass
class Journal:
    """What was asked and told, in order, and on disk."""

    path: Path
    events: list[Trial | Report] = field(default_factory=list)

    @classmethod
    def open(cls, path: Path) -> Journal:
        """The journal at `path`; a row cut short by a crash is left out."""
        journal = cls(path)
        if path.exists():
            for line in path.read_text(encoding="utf-8").splitlines():
                try:
                    row = json.loads(line)
                    found = (
                        _trial(row["trial"]) if row["event"] == "asked" else Report(**row["report"])
                    )
                except (ValueError, TypeError, KeyError):
                    continue
                journal.events.append(found)
        rows = [journal._row(event) for event in journal.events]
        write_atomically(path, "".join(rows).encode())
        return journal

    @property
    def asked(self) -> list[Trial]:
        return [event for event in self.events if isinstance(event, Trial)]

    @property
    def finished(self) -> dict[str, Report]:
        """The final reports, by trial."""
        return {e.key: e for e in self.events if isinstance(e, Report) and e.final}

    def ask(self, trial: Trial) -> None:
        if any(trial.key == other.key for other in self.asked):
            raise ConfigError(f"The outer loop asks for trial '{trial.key}' twice.")
        self._write(trial)

    def tell(self, report: Report) -> None:
        self._write(report)

    def _write(self, event: Trial | Report) -> None:
        self.events.append(event)
        with open(self.path, "a", encoding="utf-8") as file:
            file.write(self._row(event))

    def _row(self, event: Trial | Report) -> str:
        if isinstance(event, Trial):
            row = {"event": "asked", "trial": dataclasses.asdict(event)}
        else:
            kind = "finished" if event.final else "reported"
            row = {"event": kind, "report": dataclasses.asdict(event)}
        return json.dumps(row) + "\n"


def _trial(row: Mapping[str, Any]) -> Trial:
    return Trial(**{**row, "overrides": tuple(row["overrides"])})


# ---------------------------------------------------------------------- one trial


def run_trial(trial: Trial, work: Work) -> Generator[Report, bool | None, None]:
    """Carry out a trial in its own run folder, or go on with it; a failure becomes a report.

    Reports after every evaluation, and in the end; sending it True ends the trial early, with what
    it has learned by then. A caller that closes it leaves the trial saved and resumable.
    """
    path = Path(work.folder) / quote(trial.key, safe="")
    print(f"{trial.key}: {path}", file=sys.stderr)
    try:
        training = _open(path, _overrides(trial, work, path))
    except (ConfigError, FileError, RunError) as error:
        yield Report(trial.key, f"failed: {error}", run=str(path))
        return
    run = training.run
    assert run is not None
    try:
        name = f"evaluation/{training.experiment.root.evaluation.objective}"
        with contextlib.closing(training.rows()) as rows:
            for row in rows:
                if name in row:
                    stop = yield Report(
                        trial.key, "running", row[name], _figures(row), row["samples"], str(path)
                    )
                    if stop:
                        break
        evaluation, _ = training.judge()
        run.write_json("evaluation.json", evaluation.as_json(training.progress.samples))
        yield _result(trial, evaluation, training)
    except TrainingError as error:  # anything else is no finding: it stops the sweep
        samples = float(training.progress.samples)
        yield Report(trial.key, f"failed: {error}", cost=samples, run=str(path))
    finally:
        training.close()
        run.unlock()


def _overrides(trial: Trial, work: Work, path: Path) -> list[str]:
    own = [*trial.overrides, *(f"{name}={value!r}" for name, value in trial.point.items())]
    if trial.fidelity is not None:
        own.append(f"difficulty={trial.fidelity!r}")
    if trial.start is not None:
        own.append(f"start={written(trial.start)}")
    if trial.initial_states is not None:
        own.append(f"initial_states={written({'name': 'bank', 'file': trial.initial_states})}")
    return [*replaced(work.overrides, own), f"run.dir={path}"]


def written(value: Any) -> str:
    """Plain data as the value of an override: every string is quoted, whatever is in it."""
    if isinstance(value, Mapping):
        return "{" + ",".join(f"{key}:{written(item)}" for key, item in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ",".join(written(item) for item in value) + "]"
    if isinstance(value, str):
        return QuotedString(value, Quote.single).with_quotes()
    return json.dumps(value)


def _open(path: Path, overrides: list[str]) -> Training:
    reporter = Reporter(message=lambda text: print(text, file=sys.stderr))
    if (path / "run.json").exists():
        run = runs.open_run(path)
        run.lock()
        experiment = validate(run.config, installed().registry)
        training = Training(experiment, reporter).prepare().attach(run)
        training.resume()
        return training
    experiment = load_experiment(overrides)
    training = Training(experiment, reporter).prepare()
    return training.attach(runs.create(experiment, overrides, training.job.sources()))


def _figures(row: Mapping[str, Any]) -> dict[str, float]:
    prefix = "evaluation/"
    return {k.removeprefix(prefix): v for k, v in row.items() if k.startswith(prefix)}


def _result(trial: Trial, evaluation: Evaluation, training: Training) -> Report:
    assert training.run is not None
    return Report(
        trial.key,
        "ok",
        evaluation.objective_value,
        _figures(evaluation.row()),
        float(training.progress.samples),
        str(training.run.path),
    )


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
