"""The loop of every run: iterate a job, record, evaluate now and then, and stop for a reason.

The loop knows no algorithm. Between iterations its whole state is in :meth:`Training.state_dict`,
so a run that is stopped at any moment continues from its last checkpoint as if it had not been
stopped; on a CPU, to the last bit.
"""

from __future__ import annotations

import contextlib
import math
import signal
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch

from understudy import distributed
from understudy.errors import PreemptedError, RunError, said
from understudy.records import checkpoint
from understudy.records.observer import RunObserver
from understudy.records.recording import Recording
from understudy.records.runs import Run, differences, versions
from understudy.running.jobs import Job, Judgement
from understudy.setup.config import Experiment
from understudy.setup.root import BudgetOptions
from understudy.signals import StopRequest, is_stop
from understudy.task import State

__all__ = ["Progress", "Reporter", "Training"]


@dataclass
class Progress:
    """How far a run is."""

    iteration: int = 0
    samples: int = 0
    seconds: float = 0.0  #: of iterations, over all resumes; without evaluations and compiling
    evaluated_at: int = 0  #: samples at the last evaluation
    evaluations: int = 0  #: how many there were; each draws starts of its own
    met: bool = False  #: whether the criterion is met
    #: The last iteration's row, if the training stopped before the evaluation due after it.
    pending: dict[str, Any] = field(default_factory=dict)

    def spent(self, budget: BudgetOptions) -> float:
        """The share of the `budget` that is spent."""
        return max(
            self.samples / (budget.samples or math.inf),
            self.seconds / (60 * (budget.minutes or math.inf)),
        )

    def state_dict(self) -> State:
        return dict(vars(self))


@dataclass
class Reporter:
    """To whom the loop tells what happens; by default, to nobody."""

    message: Callable[[str], None] = lambda text: None
    observers: Sequence[RunObserver] = field(default_factory=tuple)

    def notify(self, event: str, *arguments: Any) -> None:
        """Tell the observers. One that fails is named, and told nothing more."""
        for observer in tuple(self.observers):
            try:
                getattr(observer, event)(*arguments)
            except BaseException as error:  # it only watches: the run goes on
                if is_stop(error):
                    raise
                self.observers = [o for o in self.observers if o is not observer]
                self.message(f"The observer {type(observer).__name__} is left out: {said(error)}")


class Training:
    """The loop of a run, new or resumed: iterate the job until the criterion or the budget."""

    def __init__(self, experiment: Experiment, reporter: Reporter | None = None) -> None:
        self.experiment = experiment
        self.run: Run | None = None
        self.reporter = reporter or Reporter()
        self.job: Job = experiment.job.build(experiment, like=Job)
        self.progress = Progress()
        self.outcome = ""
        #: Whether the checkpoint that was resumed has another task, learner or way of judging.
        self.changed = False

    def prepare(self) -> Training:
        """Build and check all that iterations need, before anything is written."""
        self.job.prepare()
        return self

    def attach(self, run: Run | None) -> Training:
        """Write metrics, checkpoints and fault dumps into the folder of `run`; None, for processes
        other than process 0, writes nothing."""
        self.run = run
        self.job.watch(run, lambda text: self.reporter.message(text))
        return self

    def state_dict(self) -> State:
        return {**self.job.state_dict(), "progress": self.progress.state_dict()}

    def load_state_dict(self, state: State) -> None:
        """Continue from `state`; a RunError names the first place at which its form differs."""
        self._load(state, self.state_dict(), self.job.load_state_dict)

    def load_learned(self, state: State) -> None:
        """Take from `state` what is judged, without preparing iterations."""
        own = {"progress": self.progress.state_dict()}
        self._load(state, own, lambda s: self.job.load_learned(s, s["progress"]["samples"]))

    def _load(self, state: State, own: State, load: Callable[[State], None]) -> None:
        try:
            progress = {"pending": {}, **state["progress"]}
            for misfit in checkpoint.misshapen(own, {**state, "progress": progress}, ""):
                raise ValueError(misfit)
            numbers = progress | {"evaluated_at": abs(progress["evaluated_at"])}  # maybe below 0
            for name, number in vars(Progress()).items():
                fits = type(found := numbers[name]) in (int, type(number))
                if type(number) in (int, float) and not (fits and 0 <= found < 2**63):
                    raise ValueError(f"'progress' cannot be {name}={found}")
            load(state)
            self.progress = Progress(**progress)
        except (LookupError, TypeError, ValueError, AttributeError, RuntimeError) as error:
            raise RunError(
                f"The checkpoint does not fit this configuration: {error if isinstance(error, ValueError) else repr(error)}. "
                "Use the configuration it was made with."
            ) from error

    def save(self) -> None:
        """Write a checkpoint, unless this process writes nothing."""
        if (run := self.run) is None:
            return
        run.check_held()
        path = run.checkpoints / f"{self.progress.iteration:08d}"
        meta = {"config": run.config, "versions": versions(), "sources": run.info["sources"]}
        meta["threads"] = torch.get_num_threads()  # the last bits of large products depend on it
        checkpoint.save(path, self.state_dict(), meta)
        checkpoint.prune(run.checkpoints, self.experiment.root.checkpoint.keep, path)
        self._saved_at = self.progress.seconds

    def resume(self) -> None:
        """Load the newest intact checkpoint of the run; a run that was stopped before its first one
        starts anew. A RunError if it is not of a training, does not fit, or is lost."""
        assert self.run is not None
        if not checkpoint.newest(self.run.checkpoints):
            if self.run.metrics():
                raise RunError(
                    f"{self.run.checkpoints} has no checkpoint, so the training that "
                    f"{self.run.metrics_file.name} tells of cannot go on. Restore the checkpoints "
                    "from a copy, or train anew in another folder."
                )
            self.run.keep_metrics_until(0)
            return
        state, meta, _ = checkpoint.load_newest(self.run.checkpoints, self.reporter.message)
        if "config" not in meta:  # as of an unpacked skill
            raise RunError(
                f"{self.run.path} holds what was learned, but not where the training stood. "
                "Begin another one with it: "
                f"`understudy train experiment=NAME start.run={self.run.path}`."
            )
        for change in differences(meta.get("config"), self.run.config):
            self.reporter.message(f"Differs from the checkpoint: {change}")
        for change in differences(meta.get("versions"), versions()):
            self.reporter.message(f"Version differs from the checkpoint: {change}")
        now = torch.get_num_threads()
        if meta.get("threads", now) != now and self.job.device.type == "cpu":
            self.reporter.message(
                f"Threads differ from the checkpoint: {meta['threads']} → {now}. On a CPU "
                "the bits are the same only with an equal number: "
                f"OMP_NUM_THREADS={meta['threads']}."
            )
        self.load_state_dict(state)
        if distributed.rank() > 0:  # the checkpoint's worlds are process 0's
            self.job.forget_worlds()
        else:
            self.run.keep_metrics_until(self.progress.iteration)
        self.changed = _meaning(meta.get("config")) != _meaning(self.run.config)
        self.progress.met &= not self.changed

    def iterate(self) -> dict[str, Any]:
        """One iteration of the job; returns its row of metrics."""
        began = time.perf_counter()
        metrics = self.job.iterate(self.progress.samples)
        seconds = time.perf_counter() - began - metrics.pop("compiling", 0.0)
        samples = metrics.pop("consumed")
        progress = self.progress
        progress.iteration += 1
        progress.samples += samples
        progress.seconds += seconds
        return {
            "iteration": progress.iteration,
            "samples": progress.samples,
            "seconds": round(progress.seconds, 3),
            "samples_per_second": samples / seconds,
            **metrics,
        }

    def train(self) -> str:
        """Iterate until the ``criterion`` is met, the ``budget`` is spent, or the job is
        ``finished``; returns which. A PreemptedError after a stop signal, once everything is saved;
        a TrainingError if numbers stop being finite for good."""
        for _ in self.rows():
            pass
        return self.outcome

    def rows(self) -> Generator[dict[str, Any], None, None]:
        """As :meth:`train`, pausing after each iteration. A caller that stops early leaves the run
        saved and resumable, as a stop signal does."""
        run, root, progress = self.run, self.experiment.root, self.progress
        self._saved_at = progress.seconds
        self.outcome = "failed"
        with StopRequest() as stop:
            try:
                if run is not None:
                    self.reporter.notify("started", run)
                    if progress.iteration == 0:
                        self.save()
                while progress.pending or not self.ended():
                    row, progress.pending = progress.pending or self.iterate(), {}
                    if distributed.rank() == 0 and stop.received is None:
                        with contextlib.suppress(KeyboardInterrupt):  # `stop` has it, too
                            row |= self._evaluate_if_due()
                    stopping = distributed.anyone(stop.received is not None, self.job.device)
                    if stopping and distributed.decided(int(self._due() != ""), self.job.device):
                        progress.pending = row
                    else:
                        row |= self.job.between(row, progress)
                        if run is not None:
                            run.append_metrics(row)
                            self.reporter.notify("iteration", run, row, self.job.stage())
                    due = progress.seconds - self._saved_at >= 60 * root.checkpoint.minutes
                    if due or stopping:
                        self.save()
                    if stopping:
                        raise self._preempted(stop.received)
                    try:
                        yield row
                    except GeneratorExit:
                        self.outcome = "stopped"
                        self.save()
                        raise
                self.save()
                if run is not None:
                    self.job.products(run)
            finally:
                if run is not None:
                    self.reporter.notify("finished", run, self.outcome)

    def _preempted(self, received: int | None) -> PreemptedError:
        self.outcome = "preempted"
        name = signal.Signals(received).name if received else "another process"
        where = f" Continue with `understudy resume {self.run.path}`." if self.run else ""
        done = f"after {self.progress.samples} samples; everything is saved."
        return PreemptedError(f"Stopped by {name} {done}{where}")

    def ended(self) -> bool:
        """Whether there is nothing left to iterate; sets the outcome. Process 0 decides."""
        reasons = ("", "criterion", "budget", "finished")
        progress, minutes = self.progress, self.experiment.root.budget.minutes or math.inf
        # An iteration as long as those before it is not begun if it would end after the time.
        late = progress.seconds * (1 + 1 / max(progress.iteration, 1)) > 60 * minutes
        spent = progress.spent(self.experiment.root.budget) >= 1 or late
        own = 1 if progress.met else 2 if spent else 3 if self.job.finished() else 0
        choice = distributed.decided(own, self.job.device)
        self.outcome = reasons[choice] or self.outcome
        return choice > 0

    def _due(self) -> str:
        """The kind of evaluation that is due; "" if none is, or none is worth its time."""
        waited = self.progress.samples - self.progress.evaluated_at
        return self.job.judging() if waited >= self.experiment.root.evaluation.every else ""

    def _evaluate_if_due(self) -> dict[str, float]:
        """Evaluate if it is time; returns the figures for the row of metrics. The criterion is met
        if it holds on one draw of starts and then on a second, larger one."""
        options, progress, met = self.experiment.root.evaluation, self.progress, False
        if not (kind := self._due()):
            return {}
        first = self._evaluate(kind, options.episodes, options.criterion)
        row = first.row(kind)
        if kind == "evaluation" and _reaches(first, options.criterion):
            second = self._evaluate("confirmation", options.final_episodes, options.criterion)
            met, row = _reaches(second, options.criterion), row | second.row("confirmation")
        progress.evaluated_at, progress.met = progress.samples, met
        progress.evaluations += 1
        return row

    def _evaluate(self, kind: str, episodes: int, criterion: float | None) -> Judgement:
        draw = f"{kind}/{self.progress.evaluations + 1}"
        least = 0.0 if criterion and not self.experiment.root.evaluation.give_up else criterion
        with StopRequest(at_once=True):  # it may take minutes, and can be repeated
            evaluation = self.job.evaluate(draw, episodes, give_up_below=least)
        self.reporter.message(
            f"{kind.capitalize()} at {self.progress.samples:,} samples: {evaluation.sentence()}"
        )
        return evaluation

    def judge(self, record_seconds: float | None = None) -> tuple[Judgement, Recording | None]:
        """The last evaluation, on starts of its own; `record_seconds` of it are recorded."""
        episodes = self.experiment.root.evaluation.final_episodes
        if record_seconds is None:
            return self.job.evaluate("final", episodes), None
        return self.job.record("final", episodes, record_seconds)

    def close(self) -> None:
        self.job.close()


def _meaning(config: Any) -> dict[str, Any]:
    """What a configuration says about what is learned and judged, not where or for how long."""
    aside = ("run", "budget", "checkpoint", "device")
    known = config.items() if isinstance(config, Mapping) else ()
    return {k: v for k, v in known if k not in aside}


def _reaches(evaluation: Judgement, criterion: float | None) -> bool:
    if (rate := evaluation.success_rate) is None or criterion is None:
        return False
    return evaluation.complete and rate >= criterion
