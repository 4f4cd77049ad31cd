"""Evaluation: deterministic episodes from starts that training never saw, judged by measures."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.running.environment import Step
from understudy.running.recorded import Recorded
from understudy.setup.building import Built, build_environment
from understudy.setup.config import Experiment
from understudy.task import Context, Policy
from understudy.task.terms import Reduction


@dataclass(frozen=True)
class Measured:
    """One measure over the episodes of an evaluation; NaN where no episode has it."""

    reduce: str  #: how an episode's values became one
    mean: float
    spread: float  #: standard deviation over episodes
    low: float  #: of the 95 % interval of the mean
    high: float

    @classmethod
    def of(cls, reduce: str, values: Tensor) -> Measured:
        """From one value an episode, (E,); what is not finite is none, as of episodes that went wrong in
        their first step."""
        values = values[values.isfinite()].double()
        if not len(values):
            return cls(reduce, *[math.nan] * 4)
        mean, n = float(values.mean()), len(values)
        spread = float(values.std()) if n > 1 else 0.0
        if reduce == "any":
            return cls(reduce, mean, spread, *wilson_interval(mean, n))
        reach = 1.96 * spread / math.sqrt(n)
        return cls(reduce, mean, spread, mean - reach, mean + reach)

    def as_json(self) -> dict[str, Any]:
        if math.isnan(self.mean):
            return {"reduce": self.reduce, "mean": None, "spread": None, "mean_95": None}
        found = {"reduce": self.reduce, "mean": self.mean, "spread": self.spread}
        return {**found, "mean_95": [self.low, self.high]}


@dataclass(frozen=True)
class Evaluation:
    """What an evaluation found. Shares are of episodes."""

    episodes: int
    success: str = ""  #: what a success is, in words
    success_rate: float | None = None  #: None where nothing is defined as success
    mean_episode_seconds: float | None = None
    violated: Mapping[str, float] = field(default_factory=dict)  #: by termination term
    cut: Mapping[str, float] = field(default_factory=dict)  #: by truncation that ended them
    measures: Mapping[str, Measured] = field(default_factory=dict)
    objective: str = "success_rate"  #: what searches maximise: this, or a measure
    seconds: float | None = None  #: the episodes' length
    #: False if it was stopped once success was out of reach; then the rate is the most it could be.
    complete: bool = True
    unsound: float = 0.0  #: share whose numbers went wrong; they are no success

    @property
    def objective_value(self) -> float | None:
        if self.objective == "success_rate":
            return self.success_rate
        value = self.measures[self.objective].mean
        return None if math.isnan(value) else value

    def row(self, kind: str = "evaluation") -> dict[str, float]:
        """The figures for a row of metrics: KIND/success_rate, or KIND/success_rate_at_most alone."""
        found = {f"{kind}/{name}": m.mean for name, m in self.measures.items() if self.complete}
        if self.success_rate is not None:
            name = "success_rate" if self.complete else "success_rate_at_most"
            found[f"{kind}/{name}"] = self.success_rate
        return found | ({f"{kind}/unsound": self.unsound} if self.unsound else {})

    def as_json(self, samples: int, changed: Sequence[str] = ()) -> dict[str, Any]:
        """After so many `samples`; `changed` are overrides with which the run was not trained."""
        found: dict[str, Any] = {
            "episodes": self.episodes,
            "seconds": self.seconds,
            "samples": samples,
            "policy": "deterministic",
            "starts": "never used in training",
            "mean_episode_seconds": self.mean_episode_seconds,
            "violated": dict(self.violated),
            "cut": dict(self.cut),
            "unsound": self.unsound,
            "measures": {name: m.as_json() for name, m in self.measures.items()},
            "objective": {"name": self.objective, "value": self.objective_value},
        }
        if self.success_rate is not None:
            low, high = wilson_interval(self.success_rate, self.episodes)
            found |= {
                "success": self.success,
                "success_rate": self.success_rate,
                "success_rate_95": [low, high],
            }
        return found | ({"changed": list(changed)} if changed else {})

    def sentence(self) -> str:
        """The result in words."""
        known = {n: m.mean for n, m in self.measures.items() if not math.isnan(m.mean)}
        figures = [
            f"{n} {mean:.3g}" for n, mean in known.items() if n != "return" and self.complete
        ]
        if self.unsound:
            figures.append(f"numbers went wrong in {shown_share(self.unsound)} of the episodes")
        if self.success_rate is None:
            return "; ".join(figures or ["nothing was measured"]) + "."
        bound, early = ("", "") if self.complete else ("at most ", ", stopped early")
        text = f"{bound}{self.success_rate:.0%} of {self.episodes} episodes succeeded{early} ({self.success})"
        if cut := [f"{name} cut {share:.0%} short" for name, share in self.cut.items() if share]:
            cut.append(f"on average they lasted {self.mean_episode_seconds:.3g} s")
        return "; ".join([text, *cut, *figures]) + "."


def shown_share(share: float) -> str:
    """In per cent; never none of it where there is some, nor all of it where some is left."""
    text = f"{share:.0%}"
    return {"0%": "under 1%", "100%": "over 99%"}.get(text, text) if 0 < share < 1 else text


def wilson_interval(rate: float, n: int, z: float = 1.96) -> tuple[float, float]:
    """The Wilson score interval of a share `rate` of `n` (95 % by default)."""
    if n == 0:
        return 0.0, 1.0
    centre = rate + z * z / (2 * n)
    spread = z * math.sqrt(rate * (1 - rate) / n + z * z / (4 * n * n))
    scale = 1 + z * z / n
    return max(0.0, (centre - spread) / scale), min(1.0, (centre + spread) / scale)


@dataclass(frozen=True)
class Success:
    """What counts as a success, from ``evaluation.success``: surviving, a term, or a measure."""

    text: str
    term: str | None = None
    measure: str | None = None
    at_least: float = -math.inf
    at_most: float = math.inf

    def of(
        self, failed: Tensor, reached: Mapping[str, Tensor], measures: Mapping[str, Tensor]
    ) -> Tensor:
        """(N,) bool, of ended episodes: whether they failed, which terms fired, their measures."""
        if self.measure is not None:
            value = measures[self.measure]
            return (value >= self.at_least) & (value <= self.at_most)
        return reached[self.term] & ~failed if self.term is not None else ~failed


def success_of(experiment: Experiment) -> Success | None:
    """What ``evaluation.success`` says; unset, it is the success terms, else survival, else nothing."""
    options = experiment.root.evaluation
    outcomes = {t.name: t.extras["outcome"] for t in experiment.many("termination.terms")}
    chosen = options.success
    if chosen is None:
        chosen = next((n for n, outcome in outcomes.items() if outcome == "success"), None)
        if chosen is None and not experiment.failures:
            return None
        chosen = chosen or "survived"
    if isinstance(chosen, str) and chosen != "survived":
        if outcomes.get(chosen) != "success":
            raise ConfigError(
                f"evaluation.success={chosen} names no termination term with outcome=success. Name "
                "one, 'survived', or {measure: NAME, at_least: NUMBER}."
            )
        return Success(f"{chosen} within {options.seconds:g} s", term=chosen)
    if isinstance(chosen, str):
        if not experiment.failures:
            raise ConfigError(
                "evaluation.success=survived cannot be judged: no termination term is a failure. Add "
                "one, or choose a measure (evaluation.success={measure: NAME, at_least: NUMBER})."
            )
        return Success(f"survived {options.seconds:g} s without {', '.join(experiment.failures)}")
    experiment.need_measure(chosen.measure, "evaluation.success.measure")
    limits = [
        f"{word} {value:g}"
        for word, value in (("at least", chosen.at_least), ("at most", chosen.at_most))
        if value is not None
    ]
    return Success(
        f"{chosen.measure} {' and '.join(limits)}",
        measure=chosen.measure,
        at_least=-math.inf if chosen.at_least is None else chosen.at_least,
        at_most=math.inf if chosen.at_most is None else chosen.at_most,
    )


class Reducer:
    """Reduces a measure's values over the steps of an episode, in place."""

    def __init__(self, reduce: Reduction, num_worlds: int, device: torch.device) -> None:
        self.reduce: Reduction = reduce
        self._value = torch.zeros(num_worlds, device=device)
        self._steps = torch.zeros(num_worlds, device=device)

    def start(self) -> None:
        self._value.fill_({"min": math.inf, "max": -math.inf}.get(self.reduce, 0.0))
        self._steps.zero_()

    def digest(self, value: Tensor, running: Tensor) -> None:
        """One step's `value` (N,) of the episodes that are `running` (N,)."""
        combined = {
            "last": lambda: value,
            "min": lambda: torch.minimum(self._value, value),
            "max": lambda: torch.maximum(self._value, value),
            "any": lambda: torch.maximum(self._value, (value != 0).float()),
            "sum": lambda: self._value + value,
            "mean": lambda: self._value + value,
        }[self.reduce]()
        self._value.copy_(torch.where(running, combined, self._value))
        self._steps += running

    def result(self) -> Tensor:
        """(N,); NaN where there was no step."""
        value = self._value / self._steps if self.reduce == "mean" else self._value
        return torch.where(self._steps > 0, value, torch.nan)


class Evaluator:
    """One environment, kept between evaluations of the same training.

    Only failures, successes and truncations end an evaluation's episodes; failure terms that
    ``evaluation.failures`` does not name are reported.
    """

    def __init__(
        self, experiment: Experiment, context: Context | None = None, substeps: int | None = None
    ) -> None:
        """`substeps` are physics steps of a control period, the task's unless given; of `context`, whose
        sections it shares, it has the scene too if that is of the same physics."""
        substeps = experiment.root.control.substeps if substeps is None else substeps
        options = experiment.root.evaluation
        self.experiment, self.options, self._seed = experiment, options, experiment.root.seed
        self.success = success_of(experiment)
        self.built: Built = build_environment(
            experiment,
            num_worlds=options.episodes,
            episode_seconds=options.seconds,
            scene=context.scene if context and context.substeps == substeps else None,
            sections=dict(context.sections) if context else None,
            evaluating=True,
            substeps=substeps,
        )
        environment = self.built.environment
        n, device = environment.num_worlds, environment.device

        def flags() -> Tensor:
            return torch.zeros(n, dtype=torch.bool, device=device)

        self._running, self._failed, self._unsound = flags(), flags(), flags()
        self._fired = {t.name: flags() for t in environment.parts.terminations}
        self._seconds = torch.zeros(n, device=device)
        self._reducers = {"return": Reducer("sum", n, device)}
        for term in environment.parts.measures:
            self._reducers[term.name] = Reducer(term.reduce, n, device)
        self._step = Recorded(self._judge, environment)
        own = self.built.context
        self._starts = {c.name: c.build(own) for c in experiment.many("evaluation.starts")}

    def _judge(self, action: Tensor) -> Step:
        """One step of all worlds, digested where their first episode is still running."""
        environment, running = self.built.environment, self._running
        step = environment.advance(action)
        self._seconds.copy_(torch.where(running, environment.table["episode_time"], self._seconds))
        for name, fired in step.endings.items():
            self._fired[name] |= fired & running
        counted = running & ~step.unsound  # its measures may be no numbers
        for name, value in {"return": step.rewards, **environment.measure()}.items():
            self._reducers[name].digest(value, counted)
        self._failed |= step.failed & running
        self._unsound |= step.unsound & running
        ended = step.ended
        self._running &= ~ended
        if environment.device.type != "cpu" or bool(ended.any()):
            step.observations = environment.begin(ended)
        return step

    @torch.no_grad()
    def run(
        self,
        policy: Policy,
        draw: str,
        episodes: int,
        *,
        give_up_below: float | None = None,
        on_period: Callable[[Tensor], None] | None = None,
    ) -> Evaluation:
        """Run `episodes`, as many at once as there are worlds; each world counts until its first ending.

        Starts are drawn from the random streams named `draw`, which no training uses: the same
        policy and draw give the same result every time. With `give_up_below`, stops as soon as that
        success rate is out of reach. Before each control period, `on_period` is told which worlds
        (N,) count, unless it has put an end to that (``environment.on_period = None``).
        Each of ``evaluation.starts`` is judged beside it, on as many episodes as there are worlds.
        """
        begun: dict[str, Measured] = {}
        for name, part in reversed(self._starts.items()):  # the first stays, and decides
            self.built.environment.parts.initial_states = part
            if give_up_below is None and self.success:
                rows, _ = self._batch(policy, f"{draw}/{name}", self.built.environment.num_worlds)
                begun[f"success_from_{name}"] = Measured.of("any", rows["success"].float())
        found: list[dict[str, Tensor]] = []
        lost = done = 0
        complete = True
        while done < episodes and complete:
            count = min(self.built.environment.num_worlds, episodes - done)
            allowed = math.inf if give_up_below is None else episodes * (1 - give_up_below) - lost
            batch, complete = self._batch(
                policy, f"{draw}/{len(found)}", count, allowed + 1e-9, on_period
            )
            lost += count - int(batch["success"].sum()) if self.success else 0
            done = done + count if complete else episodes  # those that are left could all succeed
            found.append(batch)
            on_period = None
        joined = {name: torch.cat([batch[name] for batch in found]) for name in found[0]}
        rate = None if self.success is None else (done - lost) / done

        def shares(*outcomes: str) -> dict[str, float]:
            return {
                term.name: float(joined[f"fired/{term.name}"].float().mean())
                for term in self.built.environment.parts.terminations
                if term.outcome in outcomes
            }

        return Evaluation(
            episodes=done,
            success=self.success.text if self.success else "",
            success_rate=rate,
            mean_episode_seconds=float(joined["seconds"].mean()),
            violated=shares("failure", "report"),
            cut=shares("truncation"),
            measures={
                name: Measured.of(reducer.reduce, joined[f"measure/{name}"])
                for name, reducer in self._reducers.items()
            }
            | begun,
            objective=self.options.objective,
            seconds=self.options.seconds,
            complete=complete,
            unsound=float(joined["unsound"].float().mean()),
        )

    def _batch(
        self,
        policy: Policy,
        draw: str,
        count: int,
        allowed: float = math.inf,
        on_period: Callable[[Tensor], None] | None = None,
    ) -> tuple[dict[str, Tensor], bool]:
        """What `count` episodes gave, and whether all were run: not if more than `allowed` were lost."""
        environment = self.built.environment
        observations = environment.reset(self._seed, draw)
        self._running.fill_(True)
        self._running[count:] = False
        self._seconds.zero_()
        self._failed.zero_()
        self._unsound.zero_()
        for fired in self._fired.values():
            fired.zero_()
        for reducer in self._reducers.values():
            reducer.start()
        decision_seconds = environment.decision * environment.control_dt
        steps = max(1, math.ceil(self.options.seconds / decision_seconds - 1e-6))
        environment.on_period = partial(on_period, self._running) if on_period else None
        complete = True
        for step in range(steps):
            action = policy.distribution(observations).mode()
            observations = self._step(action).observations
            if step % 30 == 29 and on_period is None and not bool(self._running.any()):
                break  # all are over, and nobody watches the next ones
            if step % 30 == 29 and allowed < count and not self._within(allowed, count):
                complete = False
                break
        found = {
            "success": self._won() if complete else self._won() | self._running,
            "seconds": self._seconds,
            "unsound": self._unsound,
            **{f"measure/{name}": r.result() for name, r in self._reducers.items()},
            **{f"fired/{name}": fired for name, fired in self._fired.items()},
        }
        return {name: value[:count].clone() for name, value in found.items()}, complete

    def _within(self, allowed: float, count: int) -> bool:
        """Whether the success rate can still be reached: of episodes that are over, all is known."""
        return int((~self._running & ~self._won())[:count].sum()) <= allowed

    def _won(self) -> Tensor:
        """(N,) bool: which worlds' first episodes succeeded, as far as they are."""
        if self.success is None:
            return torch.ones_like(self._failed)
        measures = {name: reducer.result() for name, reducer in self._reducers.items()}
        return self.success.of(self._failed, self._fired, measures) & ~self._unsound

    def close(self) -> None:
        self.built.environment.close()
