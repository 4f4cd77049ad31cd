"""Reinforcement learning as a job: collect, learn, adapt where episodes begin."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from typing import Any

import torch
from torch import Tensor

from understudy import distributed
from understudy.errors import ConfigError
from understudy.records.checkpoint import misshapen
from understudy.records.recording import Recording
from understudy.records.runs import Run
from understudy.running.environment import Environment
from understudy.running.jobs import Job
from understudy.running.training import Progress
from understudy.setup.building import Built, build_environment, device_of
from understudy.setup.config import Experiment
from understudy.task import State
from understudy_reinforcement import promised
from understudy_reinforcement.collector import Collector
from understudy_reinforcement.evaluation import Evaluation
from understudy_reinforcement.evaluator import Evaluator
from understudy_reinforcement.faults import Faults
from understudy_reinforcement.hopeless import Hopeless, refuse_negative, unsound_parts
from understudy_reinforcement.learner import Learner
from understudy_reinforcement.policy import Policy, build_policy
from understudy_reinforcement.resolution import REHEARSAL, Resolution
from understudy_reinforcement.start import take_over
from understudy_reinforcement.success import success_of

__all__ = ["Reinforcement", "sources_of"]

#: The world that is recorded and drawn.
_SHOWN = 0
#: Decisions for which is looked for the part whose numbers go wrong.
_SOUGHT = 1000


class _Moment:
    """The moment at which the work before it is done; on a GPU, that is later than the call."""

    def __init__(self, device: torch.device) -> None:
        self._event = torch.cuda.Event(enable_timing=True) if device.type == "cuda" else None
        self._clock = time.perf_counter()
        if self._event is not None:
            self._event.record()

    def __sub__(self, earlier: _Moment) -> float:
        """Seconds between two moments; waits for both."""
        if self._event is None or earlier._event is None:
            return self._clock - earlier._clock
        self._event.synchronize()
        return 1e-3 * earlier._event.elapsed_time(self._event)


def _refuse_no_weight(experiment: Experiment) -> None:
    """Refuse rewards that are the same whatever happens: a sum of nothing, or a product of powers of 0."""
    weights = [term.extras["weight"] for term in experiment.many("reward.terms")]
    if weights and not any(weights):
        names = ", ".join(term.where for term in experiment.many("reward.terms"))
        raise ConfigError(
            f"Nothing can be learned from a reward whose terms all have weight=0 ({names}). Give one of them another weight."
        )


class Reinforcement(Job):
    """Collects rollouts, has the learner learn from them, adapts where episodes begin: the job of a run whose
    configuration names none."""

    environment: Environment
    policy: Policy
    learner: Learner
    collector: Collector

    def __init__(self, options: None, experiment: Experiment) -> None:
        self.experiment = experiment
        self.device = device_of(experiment.root.device)
        self.built: Built | None = None
        self.resolution = Resolution(experiment)
        self._evaluators: dict[int, Evaluator] = {}  # by physics steps of a control period
        #: Share of the last rollout's steps in which an episode failed.
        self._failing = 1.0
        self._faults: Faults | None = None
        #: Until it was said that every decision is an episode.
        self._tell: Callable[[str], None] | None = None
        self._samples = 0  # consumed before this iteration
        self._started: Mapping[str, Any] = {}
        #: By observation which of actor and critic read it.
        self._readers: dict[str, list[str]] = {}

    def prepare(self) -> None:
        experiment = self.experiment
        success_of(experiment)  # refused now, not when the training comes to its first evaluation
        _refuse_no_weight(experiment)
        self.built = built = build_environment(experiment, substeps=self.resolution.substeps)
        self.environment = built.environment
        promised.check_curriculum(self.environment.parts.curriculum)
        observations = promised.begin(self.environment)
        self.policy = build_policy(experiment, built.context)
        self._readers = self.policy.readers(observations)
        learner = experiment.need("learner")
        self.learner = learner.build(built.context, self.policy, like=Learner)
        self._hopeless = Hopeless(self.environment.num_worlds)
        initial, curriculum = self._adapting()
        learner = self.learner
        asking = [initial, learner, *([curriculum] if curriculum else [])]
        fields = [name for part in asking for name in part.rollout_fields]
        seed = experiment.root.seed
        self.collector = Collector(self.environment, self.policy, seed, fields, learner.next_fields)
        self.collector.check_room(learner.rollout_steps)
        if start := experiment.sections.get("start"):
            self._started = take_over(start, self.policy, initial, curriculum, experiment.registry)
            self.environment.reset(seed)  # episodes begin as what was taken over says

    def _adapting(self) -> tuple[Any, Any]:
        return self.environment.parts.initial_states, self.environment.parts.curriculum

    def _go_over(self, substeps: int) -> None:
        """Continue from the same state with so many physics steps per control period."""
        if substeps == self.resolution.substeps:
            return
        if type(substeps) is not int or substeps < 1:
            raise ValueError(f"'substeps' cannot be {substeps}")
        assert self.built is not None
        state, sections = self.environment.state_dict(), dict(self.built.context.sections)
        self.environment.close()
        self.built = build_environment(self.experiment, sections=sections, substeps=substeps)
        self.environment = self.collector.environment = self.built.environment
        self.environment.reset()  # makes what a state is loaded into
        self.environment.load_state_dict(state)
        if (left := self._evaluators.pop(self.resolution.substeps, None)) is not None:
            left.close()
        self.resolution.substeps = substeps
        self._watch()

    def sharpen(self) -> dict[str, float]:
        """Change to the task's own physics; returns the mark for the learning curves."""
        self._go_over(self.resolution.own)
        return {f"mark/{self.resolution.in_words}": 1.0}

    def watch(self, run: Run | None, tell: Callable[[str], None]) -> None:
        self._faults = Faults(run, tell) if run is not None else None
        self._tell = tell
        self._watch()

    def _tell_of_first_decisions(self, episodes: Mapping[str, float]) -> None:
        """Say once that each decision of an iteration failed an episode, and by which terms of its row `episodes`: most
        often a limit is in another unit than its term's."""
        control, tell = self.experiment.root.control, self._tell
        if (
            tell is None
            or self.experiment.root.episode.seconds < 1.5 * control.decision / control.frequency
        ):
            return
        self._tell = None
        shares = {k.removeprefix("ended_by/"): v for k, v in episodes.items() if "ended_by/" in k}
        terms = ", ".join(f"termination.terms.{name}" for name, share in shares.items() if share)
        tell(
            f"All {episodes['episodes']:.0f} episodes of an iteration failed at their first decision, by {terms or 'states that are unsound'}: "
            "nothing can be learned so. Check the limits there, and their units."
        )

    def _watch(self) -> None:
        """Have environment and learner report one fault each; none if nobody watches."""
        self.environment.on_quarantine = self.learner.on_fault = None
        if (faults := self._faults) is None:
            return

        def step(fault: State) -> None:
            faults.keep("step", fault, self._samples)

        def update(minibatch: Mapping[str, Tensor]) -> None:
            policy = dict(self.policy.state_dict())
            faults.keep("update", {"minibatch": dict(minibatch), "policy": policy}, self._samples)

        if self.device.type == "cpu":  # on a GPU, looking would cost a wait in each step
            self.environment.on_quarantine = step
        self.learner.on_fault = update

    def iterate(self, samples: int) -> dict[str, Any]:
        self._samples = samples
        began = _Moment(self.device)
        self.policy.schedule(samples)
        rollout = self.collector.collect(self.learner.rollout_steps)
        collected = _Moment(self.device)
        metrics = promised.figures("learner", self.learner.update(rollout))
        self.policy.observe(rollout.observations)  # after it, so that old log-probabilities hold
        initial, curriculum = self._adapting()
        found = promised.figures("initial_states", initial.update(rollout))
        metrics |= {f"initial_states/{k}": v for k, v in found.items()}
        if curriculum is not None:
            found = promised.figures("curriculum", curriculum.update(rollout))
            metrics |= {
                k if k.startswith("mark/") else f"curriculum/{k}": v for k, v in found.items()
            }
        metrics["physics_hz"] = self.resolution.hertz
        if self.resolution.coarse and self.resolution.hard(self.environment):
            metrics |= self.sharpen()
        self._failing = float(rollout.failed.float().mean())
        episodes = self.environment.statistics.collect()
        if self._failing == 1.0 and self._tell is not None:
            self._tell_of_first_decisions(episodes)
        refuse_negative(self.environment)
        self._hopeless.refuse(episodes, rollout.rewards.shape[0], self._unsound_parts)
        ended = _Moment(self.device)
        return {
            "collect_share": (collected - began) / (ended - began),
            "consumed": rollout.rewards.numel() * distributed.size(),
            "compiling": self.collector.compiling,
            "reward": float(rollout.rewards.mean()),
            **{f"reward/{k}": v for k, v in self.collector.rewarded.items()},
            **{f"episode/{k}": v for k, v in episodes.items()},
            **{f"simulator/{k}": v for k, v in self.report().items()},
            **metrics,
        }

    def _unsound_parts(self) -> str:
        """The parts whose numbers go wrong, found by continuing for a while, at the end of the training."""
        environment, found = self.environment, list[str]()
        with torch.no_grad():
            for _ in range(_SOUGHT):
                action = self.policy.distribution(environment.observations).mode()
                ended = environment.advance(action).ended
                found = unsound_parts(environment)
                if found:
                    break
                environment.begin(ended)
        return " and ".join(found) or "a part that did not show itself again"

    def between(self, row: Mapping[str, Any], progress: Progress) -> Mapping[str, Any]:
        resolution = self.resolution
        if not resolution.coarse:
            return {}
        if not distributed.decided(int(resolution.ripe(row, progress)), self.device):
            return {}
        resolution.look_soon(progress)
        return self.sharpen()

    def finished(self) -> bool:
        curriculum = self.environment.parts.curriculum
        return curriculum is not None and curriculum.finished()

    def stage(self) -> str:
        curriculum = self.environment.parts.curriculum
        stages = [promised.stage(curriculum)] if curriculum else []
        resolution = self.resolution
        return ", ".join([*stages, resolution.in_words] if resolution.coarse else stages)

    def judging(self) -> str:
        """ "" until episodes last long enough without a failure for success to be plausible."""
        options, environment = self.experiment.root.evaluation, self.environment
        lasting = environment.decision * environment.control_dt / max(self._failing, 1e-9)
        if lasting < options.gate * options.seconds:
            return ""
        return REHEARSAL if self.resolution.coarse else "evaluation"

    @property
    def evaluator(self) -> Evaluator:
        """The one at the task's own physics."""
        return self._evaluator(self.resolution.own)

    def _evaluator(self, substeps: int) -> Evaluator:
        if substeps not in self._evaluators:
            context = self.built.context if self.built else None
            self._evaluators[substeps] = Evaluator(self.experiment, context, substeps)
        return self._evaluators[substeps]

    def evaluate(
        self, draw: str, episodes: int, *, give_up_below: float | None = None
    ) -> Evaluation:
        rehearsal = draw.startswith(f"{REHEARSAL}/")
        evaluator = self._evaluator(self.resolution.substeps) if rehearsal else self.evaluator
        return evaluator.run(self.policy, draw, episodes, give_up_below=give_up_below)

    def evaluate_finer(self, draw: str, episodes: int) -> tuple[float, Evaluation]:
        """As :meth:`evaluate`, with half the physics time step; and its rate in Hz."""
        control = self.experiment.root.control
        substeps = 2 * control.substeps
        return control.frequency * substeps, self._evaluator(substeps).run(
            self.policy, draw, episodes
        )

    def record(
        self, draw: str, episodes: int, seconds: float
    ) -> tuple[Evaluation, Recording | None]:
        built = self.evaluator.built
        environment, scene = built.environment, built.scene
        dt = environment.control_dt
        names = [name for name in scene.recorded if name in environment.table.shapes]
        frames: dict[str, list[Tensor]] = {name: [] for name in names}
        counted: list[Tensor] = []

        def see(running: Tensor) -> None:
            for name in names:
                frames[name].append(environment.table[name][_SHOWN].clone())
            counted.append(running[_SHOWN].clone())
            if len(counted) >= round(seconds / dt):
                environment.on_period = None

        watch = see if names and seconds > 0 else None
        evaluation = self.evaluator.run(self.policy, draw, episodes, on_period=watch)
        if not counted:
            return evaluation, None
        tracks = {k: torch.stack(v).cpu().numpy() for k, v in frames.items()}
        return evaluation, Recording(tracks, dt, int(torch.stack(counted).sum()), scene)

    def sources(self) -> Mapping[str, Any]:
        found = sources_of(self.built) if self.built else {}
        return found | ({"start": self._started} if self._started else {})

    def notes(self) -> list[str]:
        shapes = self.environment.observation_shapes
        seen = [
            f"{name} {list(shapes[name])} ({' and '.join(who)})"
            for name, who in self._readers.items()
            if who
        ]
        unread = [name for name, who in self._readers.items() if not who]
        known = self.environment.parts.encoders.keys() - set(unread)
        chosen = self.experiment.need("policy")
        where, read = [("policy.observation", []), *_naming(chosen.effective(), "policy", known)][
            -1
        ]
        missed = [
            f"No network reads the observation '{name}'. To have it read, write "
            f"{where}=[{','.join([*read, name])}]; `understudy describe policy/{chosen.component.name}` "
            "has what else a network may read."
            for name in unread
        ]
        difficulty = self.experiment.root.difficulty
        if difficulty != 1.0 and not self.has_difficulty():
            missed.append(
                f"difficulty={difficulty:g} changes nothing: no part of this task reads it."
            )
        criterion = self.experiment.root.evaluation.criterion
        if criterion is not None and success_of(self.experiment) is None:
            missed.append(
                f"evaluation.criterion={criterion:g} is never met: nothing in this task says whether an episode succeeded. Say it by "
                "evaluation.success={measure: NAME, at_least: NUMBER}."
            )
        return [f"The policy reads {', '.join(seen) or 'no observation'}.", *missed]

    def has_difficulty(self) -> bool:
        """Whether the task has one: a part reads the field ``difficulty``, or the curriculum derives something from it, such as
        a time limit, a parameter of the simulator, or the length of decisions."""
        environment = self.environment
        curriculum = environment.parts.curriculum
        if curriculum is not None and (
            curriculum.decision() is not None or bool(set(curriculum.provides) - {"difficulty"})
        ):
            return True
        read = {name for _, names in environment.readers() for name in names}
        read.update(environment.parts.initial_states.reads)
        return not read.isdisjoint(("difficulty", "previous_difficulty"))

    def report(self) -> Mapping[str, int]:
        return self.environment.parts.simulator.report()

    def state_dict(self) -> State:
        return {
            "policy": dict(self.policy.state_dict()),
            "learner": self.learner.state_dict(),
            "environment": self.environment.state_dict(),
            "collector": self.collector.streams.state_dict(),
            "failing": self._failing,
            **self.resolution.state_dict(),
        }

    def load_state_dict(self, state: State) -> None:
        self.policy.load_state_dict(state["policy"])
        self.learner.load_state_dict(state["learner"])
        self._go_over(state.get("substeps", self.resolution.substeps))
        self.environment.load_state_dict(state["environment"])
        self.collector.streams.load_state_dict(state["collector"])
        if not 0 <= (failing := state["failing"]) <= 1:
            raise ValueError(f"'failing' cannot be {failing}")
        self._failing = failing

    def load_learned(self, state: State, samples: int) -> None:
        self.policy = build_policy(self.experiment, self.evaluator.built.context)
        own = dict(self.policy.state_dict())
        for misfit in misshapen(own, state.get("policy"), "policy"):
            raise ValueError(misfit)
        self.policy.load_state_dict(state["policy"])
        self.policy.schedule(samples)

    def forget_worlds(self) -> None:
        self.environment.reset()

    def close(self) -> None:
        if self.built is not None:
            self.built.environment.close()
        for evaluator in self._evaluators.values():
            evaluator.close()


def sources_of(built: Built) -> dict[str, Any]:
    """Where what `built` is made of comes from: its sections' data with their licences, and facts of its scene."""
    sections = built.context.sections.items()
    found = {name: one.provenance() for name, one in sections if hasattr(one, "provenance")}
    facts = built.scene.describe()
    return found | ({"scene": facts} if facts else {})


def _naming(options: Any, where: str, names: Set[str]) -> Iterator[tuple[str, Sequence[str]]]:
    """The key paths in nested `options` at which one of the `names` is, and which one."""
    if isinstance(options, Mapping):
        for key, value in options.items():
            yield from _naming(value, f"{where}.{key}", names)
        return
    found = (
        [options]
        if isinstance(options, str)
        else list(options or ())
        if isinstance(options, (list, tuple))
        else []
    )
    if found and all(name in names for name in found):
        yield where, found
