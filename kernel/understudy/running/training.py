"""The training loop: collect, learn, record, evaluate now and then, and stop for a reason.

The loop knows no algorithm. Between iterations its whole state is in :meth:`Training.state_dict`,
so a training that is stopped at any moment continues from its last checkpoint as if it had never
stopped; on the CPU, to the last bit.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

import torch
from torch import Tensor

from understudy import distributed
from understudy.errors import PreemptedError, RunError
from understudy.random import WorldStreams
from understudy.records import checkpoint
from understudy.records.runs import Run, differences, versions
from understudy.running.environment import refuse_hopeless
from understudy.running.evaluation import Evaluation, Evaluator
from understudy.setup.building import build_environment, build_learner, build_policy
from understudy.setup.config import Experiment
from understudy.task.interfaces import Rollout, RunObserver, State


class Collector:
    """Collects rollouts of fixed length; episodes run on across rollouts."""

    def __init__(self, environment: Any, policy: Any, seed: int) -> None:
        self.environment, self.policy = environment, policy
        self.streams = WorldStreams(seed, "actions", environment.num_worlds, environment.device)

    @torch.no_grad()
    def collect(self, steps: int) -> Rollout:
        environment, policy = self.environment, self.policy
        n, device = environment.num_worlds, environment.device

        def empty(shape: Sequence[int] = (), dtype: torch.dtype = torch.float32) -> Tensor:
            return torch.empty((steps, n, *shape), dtype=dtype, device=device)

        wanted = environment.parts.initial_states.records
        rollout = Rollout(
            observations={k: empty(v.shape[1:]) for k, v in environment.observations.items()},
            last_observations={},
            actions=empty((environment.action_size,)),
            log_probs=empty(),
            rewards=empty(),
            terminated=empty(dtype=torch.bool),
            truncated=empty(dtype=torch.bool),
            final_values=empty().zero_(),
            records={name: empty(environment.table.shapes[name]) for name in wanted},
        )
        for t in range(steps):
            observations = environment.observations
            for name, value in observations.items():
                rollout.observations[name][t] = value
            for name in wanted:
                rollout.records[name][t] = environment.table[name]
            distribution = policy.distribution(observations)
            action = distribution.sample(self.streams)
            rollout.actions[t] = action
            rollout.log_probs[t] = distribution.log_prob(action)
            step = environment.step(action)
            rollout.rewards[t] = step.rewards
            rollout.terminated[t] = step.terminated
            rollout.truncated[t] = step.truncated
            if step.final_observations is not None and (
                device.type != "cpu" or bool(step.truncated.any())
            ):
                values = policy.value(step.final_observations)
                rollout.final_values[t] = torch.where(step.truncated, values, 0.0)
        rollout.last_observations = dict(environment.observations)
        return rollout


class StopRequest:
    """Turns SIGTERM, SIGINT and SIGUSR1 into a flag that the loop reads at its next boundary."""

    SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGUSR1)

    def __init__(self) -> None:
        self.received: int | None = None
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> StopRequest:
        for number in self.SIGNALS:
            try:
                self._previous[number] = signal.signal(number, self._note)
            except ValueError:  # not in the main thread: whoever runs us handles signals
                break
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.received = number


@dataclass
class Progress:
    """How far a training is."""

    iteration: int = 0
    samples: int = 0
    seconds: float = 0.0  #: of training, over all resumes; evaluations not counted
    evaluated_at: int = 0  #: samples at the last evaluation
    best: float = -1.0  #: success rate of the best evaluation
    met: bool = False  #: whether an evaluation met the criterion
    failing: float = 1.0  #: share of the last rollout's steps that ended an episode early

    def state_dict(self) -> State:
        return dict(vars(self))


@dataclass
class Outcome:
    """How a training ended: ``criterion``, ``budget``, and the last complete evaluation."""

    reason: str
    progress: Progress
    evaluation: Evaluation | None = None


@dataclass
class Reporter:
    """Where the loop tells what happens; the command line replaces these."""

    iteration: Callable[[Mapping[str, Any]], None] = lambda row: None
    message: Callable[[str], None] = lambda text: None
    observers: Sequence[RunObserver] = field(default_factory=tuple)

    def notify(self, event: str, *arguments: Any) -> None:
        """Tell the observers; one that fails is named and told nothing more."""
        for observer in tuple(self.observers):
            try:
                getattr(observer, event)(*arguments)
            except Exception as error:  # it only watches: the run goes on
                self.observers = [o for o in self.observers if o is not observer]
                self.message(
                    f"The observer {type(observer).__name__} is left out: {type(error).__name__}: {error}"
                )


class Training:
    """A training of one experiment, new or resumed."""

    def __init__(self, experiment: Experiment, reporter: Reporter | None = None) -> None:
        self.experiment = experiment
        self.run: Run | None = None
        self.reporter = reporter or Reporter()
        root = experiment.root
        self.built = build_environment(experiment)
        self.environment = self.built.environment
        self.environment.reset()  # which also checks every term, before anything is written
        self.policy = build_policy(experiment, self.built.context)
        self.learner = build_learner(experiment, self.built.context, self.policy)
        self.collector = Collector(self.environment, self.policy, root.seed)
        self.progress = Progress()
        self._evaluator: Evaluator | None = None

    def attach(self, run: Run) -> Training:
        """Keep metrics, checkpoints and fault dumps in the folder of `run`."""
        self.run = run
        if self.environment.device.type == "cpu":
            self.environment.on_quarantine = self._dump_worlds
        self.learner.on_fault = self._dump_minibatch
        return self

    def detach(self) -> Training:
        """Write nothing: for the processes beside process 0."""
        self.run, self.environment.on_quarantine, self.learner.on_fault = None, None, None
        return self

    def sources(self) -> dict[str, Any]:
        """Where the data of each config section came from, with licences."""
        return {
            name: section.provenance()
            for name, section in self.built.context.sections.items()
            if hasattr(section, "provenance")
        }

    # ------------------------------------------------------------------ state

    def state_dict(self) -> State:
        return {
            "policy": dict(self.policy.state_dict()),
            "learner": self.learner.state_dict(),
            "environment": self.environment.state_dict(),
            "collector": self.collector.streams.state_dict(),
            "progress": self.progress.state_dict(),
        }

    def load_state_dict(self, state: State) -> None:
        """Continue from `state`.

        Raises
        ------
        RunError
            if it belongs to another model, task or number of worlds; names the first difference.
        """
        own = self.policy.state_dict()
        for name, value in own.items():
            other = state["policy"].get(name)
            if other is None or other.shape != value.shape:
                have = "nothing" if other is None else str(tuple(other.shape))
                raise RunError(
                    f"The checkpoint does not fit this policy: '{name}' is {tuple(value.shape)} here "
                    f"and {have} there. Resume with the configuration it was made with."
                )
        worlds = state["environment"]["episode_step"].shape[0]
        if worlds != self.environment.num_worlds:
            raise RunError(
                f"The checkpoint has {worlds} worlds and this configuration {self.environment.num_worlds}. "
                f"Set num_worlds={worlds}."
            )
        own_states = self.environment.parts.initial_states.state_dict()
        misfit = misshapen(own_states, state["environment"]["initial_states"], "initial_states")
        if misfit:
            raise RunError(
                f"The checkpoint does not fit this configuration: {misfit}. Resume with the "
                "configuration it was made with."
            )
        self.policy.load_state_dict(state["policy"])
        self.learner.load_state_dict(state["learner"])
        self.environment.load_state_dict(state["environment"])
        self.collector.streams.load_state_dict(state["collector"])
        self.progress = Progress(**state["progress"])

    def save(self) -> Path:
        assert self.run is not None
        path = self.run.checkpoints / f"{self.progress.iteration:08d}"
        meta = {
            "config": self.run.config,
            "versions": versions(),
            "sources": self.run.info["sources"],
        }
        checkpoint.save(path, self.state_dict(), meta)
        checkpoint.prune(self.run.checkpoints, self.experiment.root.checkpoint.keep)
        return path

    def resume(self) -> None:
        """Load the newest intact checkpoint of the run; a run without any starts from the beginning."""
        assert self.run is not None
        if not checkpoint.newest(self.run.checkpoints):
            self.run.keep_metrics_until(0)
            return
        state, meta, _ = checkpoint.load_newest(self.run.checkpoints, self.reporter.message)
        for change in differences(meta.get("config"), self.run.config):
            self.reporter.message(f"Differs from the checkpoint: {change}")
        for change in differences(meta.get("versions"), versions()):
            self.reporter.message(f"Version differs from the checkpoint: {change}")
        try:
            self.load_state_dict(state)
        except (KeyError, TypeError, ValueError, AttributeError, RuntimeError) as error:
            raise RunError(
                f"The newest checkpoint of {self.run.path} does not fit this configuration: "
                f"{type(error).__name__}: {error}. Resume with the configuration it was made with."
            ) from error
        if distributed.rank() > 0:  # the checkpoint's worlds are process 0's; others begin anew
            self.environment.reset()
        else:
            self.run.keep_metrics_until(self.progress.iteration)

    # ------------------------------------------------------------------ the loop

    def iterate(self) -> dict[str, Any]:
        """One iteration: collect, learn, adapt the initial states. Returns its metrics."""
        began = time.perf_counter()
        self.policy.schedule(self.progress.samples)
        rollout = self.collector.collect(self.learner.rollout_steps)
        collected = time.perf_counter()
        metrics = self.learner.update(rollout)
        self.policy.observe(rollout.observations)  # after it, so that old log-probabilities hold
        metrics |= {
            f"initial_states/{k}": v
            for k, v in self.environment.parts.initial_states.update(rollout).items()
        }
        progress = self.progress
        progress.failing = float(rollout.terminated.float().mean())
        samples = rollout.rewards.numel() * distributed.size()
        progress.iteration += 1
        progress.samples += samples
        ended = time.perf_counter()
        progress.seconds += ended - began
        episodes = self.environment.statistics.collect(self.environment.control_dt)
        refuse_hopeless(episodes["unsound"], rollout.rewards.shape[0], self.environment.num_worlds)
        return {
            "iteration": progress.iteration,
            "samples": progress.samples,
            "seconds": round(progress.seconds, 3),
            "samples_per_second": samples / (ended - began),
            "collect_share": (collected - began) / (ended - began),
            "reward": float(rollout.rewards.mean()),
            **{f"episode/{k}": v for k, v in episodes.items()},
            **{f"simulator/{k}": v for k, v in self.environment.parts.simulator.report().items()},
            **metrics,
        }

    def train(self) -> Outcome:
        """Train until the criterion is met or the budget is spent.

        Raises
        ------
        PreemptedError
            after a stop signal, when everything is saved.
        TrainingError
            when the numbers leave the finite for good.
        """
        run, root, progress = self.run, self.experiment.root, self.progress
        device = self.environment.device
        saved_at = progress.seconds
        outcome = "failed"
        with StopRequest() as stop:
            try:
                if run is not None:
                    self.reporter.notify("started", run)
                    if progress.iteration == 0:
                        self.save()
                while True:
                    due = distributed.rank() == 0 and not progress.met
                    evaluation = self._evaluate_if_due() if due else None
                    progress.met |= evaluation is not None and self._met(evaluation)
                    ending = 1 if progress.met else 2 if self._spent() else 0
                    choice = distributed.decided(ending, device)
                    if choice:
                        outcome = "criterion" if choice == 1 else "budget"
                        break
                    row = self.iterate()
                    stopping = distributed.anyone(stop.received is not None, device)
                    self.reporter.iteration(row)
                    if run is not None:
                        run.append_metrics(row)
                        self.reporter.notify("iteration", run, row)
                        due = progress.seconds - saved_at >= 60 * root.checkpoint.minutes
                        if due or stopping:
                            self.save()
                            saved_at = progress.seconds
                    if stopping:
                        outcome = "preempted"
                        where = f" Continue with `understudy resume {run.path}`." if run else ""
                        name = (
                            signal.Signals(stop.received).name
                            if stop.received
                            else "another process"
                        )
                        raise PreemptedError(
                            f"Stopped by {name} after {progress.samples} "
                            f"samples; everything is saved.{where}"
                        )
                if run is not None:
                    self.save()
                return Outcome(outcome, progress, evaluation)
            finally:
                if run is not None:
                    self.reporter.notify("finished", run, outcome)

    def _spent(self) -> bool:
        budget = self.experiment.root.budget
        samples = budget.samples is not None and self.progress.samples >= budget.samples
        return samples or (
            budget.minutes is not None and self.progress.seconds >= 60 * budget.minutes
        )

    def _met(self, evaluation: Evaluation) -> bool:
        criterion = self.experiment.root.evaluation.criterion
        return (
            criterion is not None and evaluation.complete and evaluation.success_rate >= criterion
        )

    def _evaluate_if_due(self) -> Evaluation | None:
        """Evaluate when training episodes last long enough for success to be plausible."""
        options = self.experiment.root.evaluation
        if options.criterion is None:
            return None
        if self.progress.samples - self.progress.evaluated_at < options.every_samples:
            return None
        survival_seconds = self.environment.control_dt / max(self.progress.failing, 1e-9)
        if survival_seconds < options.gate * options.seconds:
            return None
        return self.evaluate(give_up_below=options.criterion)

    def evaluate(self, give_up_below: float | None = None) -> Evaluation:
        if self._evaluator is None:
            self._evaluator = Evaluator(self.experiment, self.built.context)
        self.progress.evaluated_at = self.progress.samples
        evaluation = self._evaluator.run(self.policy, give_up_below=give_up_below)
        verb = "" if evaluation.complete else " (stopped early: out of reach)"
        self.reporter.message(
            f"Evaluation at {self.progress.samples:,} samples: {evaluation.success_rate:.0%} of "
            f"{evaluation.episodes} episodes of {evaluation.seconds:g} s succeeded{verb}, "
            f"{evaluation.mean_episode_seconds:.1f} s on average."
        )
        self.progress.best = max(
            self.progress.best, evaluation.success_rate if evaluation.complete else -1
        )
        return evaluation

    # ------------------------------------------------------------------ faults

    def _dump_worlds(self, snapshot: dict[str, Tensor], control: Tensor, worlds: Tensor) -> None:
        """Write the state before, and the controls of, the step in which `worlds` failed."""
        rows = worlds.nonzero().squeeze(1)
        self._dump(
            "step",
            {
                "snapshot": {k: v[rows] for k, v in snapshot.items()},
                "control": control[rows],
                "worlds": rows,
            },
        )

    def _dump_minibatch(self, tensors: Mapping[str, Tensor]) -> None:
        self._dump("update", {"minibatch": dict(tensors), "policy": dict(self.policy.state_dict())})

    def _dump(self, name: str, state: State) -> None:
        assert self.run is not None
        folder = self.run.path / "faults"
        meta = {"config": self.run.config, "versions": versions(), "samples": self.progress.samples}
        try:
            checkpoint.save(folder / name, state, meta)
            self.reporter.message(
                f"Numbers left the finite; what led to it is in {folder / name}.json."
            )
        except RunError as error:  # the training can go on without it
            self.reporter.message(f"Numbers left the finite, and {error}")

    def close(self) -> None:
        self.environment.close()
        if self._evaluator is not None:
            self._evaluator.close()


def misshapen(own: Any, other: Any, where: str) -> str:
    """The first place at which tensors of two nested states differ in shape, or ""."""
    if isinstance(own, Tensor):
        if not isinstance(other, Tensor) or own.shape != other.shape:
            have = tuple(other.shape) if isinstance(other, Tensor) else "nothing"
            return f"'{where}' is {tuple(own.shape)} here and {have} there"
    elif isinstance(own, Mapping):
        for name, value in own.items():
            given = other.get(name) if isinstance(other, Mapping) else None
            if found := misshapen(value, given, f"{where}/{name}"):
                return found
    return ""
