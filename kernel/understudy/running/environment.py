"""The batched environment: assembles a task from named parts and steps N worlds of it.

Everything is masked tensor arithmetic over all worlds; there is no Python loop over worlds and, on
an accelerator, nothing is fetched to the host inside :meth:`Environment.step`.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import torch
from torch import Tensor

from understudy.errors import ConfigError, TrainingError
from understudy.random import WorldStreams
from understudy.task import Actuation, Encoder, Fields, InitialStates, Shape, Simulator, State

#: Fields that the environment itself provides; ``failed`` (bool) is set once this step's
#: terminations are known, so only rewards may read it.
OWN_FIELDS: dict[str, Shape] = {"episode_time": (), "episode_step": (), "failed": ()}

#: Numbers of this size and beyond count as non-finite, as they do for MuJoCo.
LARGEST = 1e10

#: What a termination term that fires does to the episode; ``report`` only reports it.
Outcome = Literal["failure", "truncation", "success", "report"]


@dataclass(frozen=True)
class Term:
    """A reward or termination term: a pure function of fields, with its options bound."""

    name: str
    function: Callable[..., Tensor]
    options: Mapping[str, Any] = field(default_factory=dict)
    weight: float = 1.0
    outcome: Outcome = "failure"

    @functools.cached_property
    def reads(self) -> tuple[str, ...]:
        """The fields it is called with: its positional parameters, in order."""
        return tuple(
            p.name
            for p in inspect.signature(self.function).parameters.values()
            if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)
        )


@dataclass
class Parts:
    """The built parts of a task."""

    simulator: Simulator
    fields: Sequence[tuple[str, Fields]]
    encoders: Mapping[str, Encoder]
    actuation: Actuation
    initial_states: InitialStates
    rewards: Sequence[Term]
    terminations: Sequence[Term]
    combine: Literal["sum", "product"] = "product"


@dataclass
class Step:
    """What one step of all worlds gave. Rows of ended episodes already begin the next one in
    ``observations``; ``final_observations`` (None if no episode was truncated) has their last."""

    observations: dict[str, Tensor]
    rewards: Tensor  #: (N,) float32
    terminated: Tensor  #: (N,) bool: failed or succeeded, nothing follows
    failed: Tensor  #: (N,) bool: terminated by a failure
    truncated: Tensor  #: (N,) bool
    final_observations: dict[str, Tensor] | None
    endings: dict[str, Tensor]  #: by termination term: (N,) bool, violated in this step


class FieldTable:
    """Values of state fields at the present state, each computed when first asked for."""

    def __init__(
        self,
        simulator: Simulator,
        providers: Sequence[tuple[str, Fields]],
        own: Mapping[str, Shape],
    ) -> None:
        self._simulator = simulator
        self._provider: dict[str, Fields] = {}
        self._values: dict[str, Tensor] = {}
        self.shapes: dict[str, Shape] = {**simulator.fields, **own}
        self.source: dict[str, str] = {
            **dict.fromkeys(simulator.fields, "simulator"),
            **dict.fromkeys(own, "environment"),
        }
        for name, provider in providers:
            for item, shape in provider.provides.items():
                if item in self.shapes:
                    raise ConfigError(
                        f"fields.{name} provides the field '{item}', which {self.source[item]} "
                        "provides already. Remove one of them (~fields.NAME)."
                    )
                self.shapes[item], self._provider[item] = shape, provider
                self.source[item] = f"fields.{name}"

    def clear(self, own: Mapping[str, Tensor]) -> None:
        """Forget all values: the state has changed. `own` are the environment's fields now."""
        self._values = dict(own)

    def __getitem__(self, name: str) -> Tensor:
        value = self._values.get(name)
        if value is None:
            provider = self._provider.get(name)
            if provider is None:
                value = self._values[name] = self._simulator.read(name)
            else:
                self._values.update(provider.compute(**{k: self[k] for k in provider.reads}))
                value = self._values[name]
        return value

    def set(self, name: str, value: Tensor) -> None:
        """Set a field of the environment's own."""
        self._values[name] = value

    def pick(self, names: Sequence[str]) -> dict[str, Tensor]:
        return {name: self[name] for name in names}


def _as_physics(method: Callable[..., Any]) -> Callable[..., Any]:
    """Run a method of the environment with settings of its own, whatever the learner has chosen.

    Matrix products are full float32: TF32 keeps three digits, too few for positions and rotations.
    On the CPU there is one torch thread: the tensors are small, so more would gain nothing, and idle
    ones of torch's pool would spin on the cores that the simulator's threads need.
    """

    @functools.wraps(method)
    def wrapped(self: Environment, *args: Any, **options: Any) -> Any:
        threads, products = torch.get_num_threads(), torch.backends.cuda.matmul
        reduced = products.allow_tf32
        alone = self.device.type == "cpu" and threads > 1
        if alone:
            torch.set_num_threads(1)
        products.allow_tf32 = False
        try:
            return method(self, *args, **options)
        finally:
            products.allow_tf32 = reduced
            if alone:
                torch.set_num_threads(threads)

    return wrapped


class Environment:
    """N worlds of one task.

    Parameters
    ----------
    parts : Parts
        what the task consists of.
    num_worlds, device, seed
        N; where the tensors live; the root of the environment's random streams.
    control_dt : float
        seconds per step.
    episode_seconds : float
        episodes are truncated at this length.
    known_fields : mapping from field name to the components that provide it, for errors.

    Raises
    ------
    ConfigError
        if a part reads a field that nothing provides, or a term has the wrong shape.
    """

    def __init__(
        self,
        parts: Parts,
        *,
        num_worlds: int,
        device: torch.device,
        seed: int,
        control_dt: float,
        episode_seconds: float,
        known_fields: Callable[[str], Sequence[str]] = lambda name: (),
    ) -> None:
        self.parts = parts
        self.num_worlds, self.device, self.control_dt = num_worlds, device, control_dt
        self.max_steps = max(1, round(episode_seconds / control_dt))
        self._streams = WorldStreams(seed, "initial_states", num_worlds, device)
        initial = parts.initial_states
        self.table = FieldTable(
            parts.simulator, parts.fields, {**OWN_FIELDS, **initial.episode_fields}
        )
        self._check_fields(known_fields)
        self.episode_step = torch.zeros(num_worlds, dtype=torch.int64, device=device)
        self._episode_fields = {
            name: torch.zeros((num_worlds, *shape), device=device)
            for name, shape in initial.episode_fields.items()
        }
        self._nowhere = torch.zeros(num_worlds, dtype=torch.bool, device=device)
        self.observations: dict[str, Tensor] = {}
        self.statistics = EpisodeStatistics(
            [t.name for t in parts.terminations], num_worlds, device
        )
        #: Worlds quarantined since the start because their numbers went wrong.
        self.quarantined = torch.zeros((), dtype=torch.int64, device=device)
        #: Called once, with (snapshot before the step, controls, world mask), at the first failure.
        self.on_quarantine: Callable[[dict[str, Tensor], Tensor, Tensor], None] | None = None

    @property
    def action_size(self) -> int:
        return self.parts.actuation.action_size

    @property
    def observation_shapes(self) -> dict[str, Shape]:
        return {name: encoder.shape for name, encoder in self.parts.encoders.items()}

    def _check_fields(self, known_fields: Callable[[str], Sequence[str]]) -> None:
        parts = self.parts
        wanted: list[tuple[str, Sequence[str]]] = [
            *((f"fields.{name}", provider.reads) for name, provider in parts.fields),
            *((f"encoder.{name}", encoder.reads) for name, encoder in parts.encoders.items()),
            ("actuation", parts.actuation.reads),
            ("initial_states", parts.initial_states.records),
            *((f"reward.terms.{term.name}", term.reads) for term in parts.rewards),
            *((f"termination.terms.{term.name}", term.reads) for term in parts.terminations),
        ]
        for who, names in wanted:
            for name in names:
                if name not in self.table.shapes:
                    givers = known_fields(name)
                    hint = f" It would come from {' or '.join(givers)}." if givers else ""
                    raise ConfigError(
                        f"{who} needs the state field '{name}', which nothing in this task "
                        f"provides.{hint}"
                    )
        missing = [name for name in parts.initial_states.episode_fields if name in OWN_FIELDS]
        if missing:
            raise ConfigError(
                f"initial_states provides '{missing[0]}', which the environment owns."
            )

    # ------------------------------------------------------------------ running

    @torch.no_grad()
    @_as_physics
    def reset(self, seed: int | None = None) -> dict[str, Tensor]:
        """Begin a new episode in every world; returns the observations.

        With `seed`, the random streams begin anew too, so what follows repeats exactly.
        """
        if seed is not None:
            self._streams = WorldStreams(seed, "initial_states", self.num_worlds, self.device)
        everywhere = torch.ones(self.num_worlds, dtype=torch.bool, device=self.device)
        self._begin(everywhere)
        self._check_shapes()
        self.statistics.forget_running()
        self.observations = self._first()
        return self.observations

    @torch.no_grad()
    @_as_physics
    def step(self, action: Tensor) -> Step:
        """Apply `action` (N, A), advance one control period, judge, and begin ended worlds anew."""
        parts, table = self.parts, self.table
        control = parts.actuation.control(action, **table.pick(parts.actuation.reads))
        unsound = ~sound(control)
        snapshot = parts.simulator.snapshot() if self.on_quarantine else None
        parts.simulator.step(torch.where(unsound.unsqueeze(1), 0.0, control))
        self.episode_step += 1
        self._refresh()

        endings = {term.name: self._evaluate(term) for term in parts.terminations}
        outcomes = {
            "failure": unsound,
            "truncation": self.episode_step >= self.max_steps,
            "success": torch.zeros_like(unsound),
        }
        for term in parts.terminations:
            if term.outcome != "report":
                outcomes[term.outcome] = outcomes[term.outcome] | endings[term.name]
        table.set("failed", outcomes["failure"])
        rewards = self._reward()
        unsound = unsound | parts.simulator.failed() | ~sound(rewards)
        reached = self._encode()
        for value in reached.values():
            unsound = unsound | ~sound(value)
        terminated = outcomes["failure"] | outcomes["success"] | unsound
        truncated = outcomes["truncation"] & ~terminated
        ended = terminated | truncated
        rewards = torch.where(unsound, 0.0, rewards)
        self.statistics.digest(rewards, ended, truncated, unsound, endings, self.episode_step)

        final: dict[str, Tensor] | None = None
        if self.device.type == "cpu" and not bool(ended.any()):
            self.observations = reached
        else:
            self._quarantine(unsound, snapshot, control)
            self._begin(ended)
            self.observations = self._first()
            final = {  # an unsound world's numbers must reach nothing, so it shows its next episode
                name: torch.where(_rows(unsound, value), self.observations[name], value)
                for name, value in reached.items()
            }
        failed = outcomes["failure"] | unsound
        return Step(self.observations, rewards, terminated, failed, truncated, final, endings)

    def _evaluate(self, term: Term) -> Tensor:
        return term.function(*(self.table[name] for name in term.reads), **term.options)

    def _reward(self) -> Tensor:
        total: Tensor | None = None
        for term in self.parts.rewards:
            value = self._evaluate(term)
            if self.parts.combine == "sum":
                value = value * term.weight
                total = value if total is None else total + value
            else:
                value = value if term.weight == 1.0 else value**term.weight
                total = value if total is None else total * value
        if total is None:
            raise ConfigError("reward.terms is empty: a task needs at least one reward term.")
        return total

    def _encode(self) -> dict[str, Tensor]:
        return {
            name: encoder.encode(**self.table.pick(encoder.reads))
            for name, encoder in self.parts.encoders.items()
        }

    def _first(self) -> dict[str, Tensor]:
        """The observations after :meth:`_begin`; zero in worlds that began unsound and fail next."""
        return {
            name: torch.where(_rows(sound(value), value), value, 0.0)
            for name, value in self._encode().items()
        }

    def _begin(self, worlds: Tensor) -> None:
        before = self._streams.state_dict()
        initial = self.parts.initial_states.sample(self._streams)
        self._streams.give_back(~worlds, before)  # what a world draws depends on no other world
        self.parts.simulator.set_state(
            worlds, {name: initial[name] for name in self.parts.simulator.state_fields}
        )
        for name, value in self._episode_fields.items():
            value.copy_(torch.where(_rows(worlds, value), initial[name], value))
        self.episode_step.masked_fill_(worlds, 0)
        self._refresh()

    def _refresh(self) -> None:
        self.table.clear(
            {
                "episode_step": self.episode_step,
                "episode_time": self.episode_step * self.control_dt,
                "failed": self._nowhere,
                **self._episode_fields,
            }
        )

    def _quarantine(
        self, unsound: Tensor, snapshot: dict[str, Tensor] | None, control: Tensor
    ) -> None:
        self.quarantined += unsound.sum()
        if self.on_quarantine is not None and bool(unsound.any()):
            assert snapshot is not None
            self.on_quarantine(snapshot, control, unsound)
            self.on_quarantine = None

    def _check_shapes(self) -> None:
        """Every field's and term's shape, once, at the border."""
        n = self.num_worlds

        def check(who: str, value: Tensor, shape: Shape) -> None:
            if tuple(value.shape) != (n, *shape):
                raise ConfigError(
                    f"{who} has shape {tuple(value.shape)}; it must be {(n, *shape)}, one row per world."
                )

        for name, provider in self.parts.fields:
            given = provider.compute(**self.table.pick(provider.reads))
            for item, shape in provider.provides.items():
                if item not in given:
                    raise ConfigError(
                        f"fields.{name} promises the field '{item}' and does not return it."
                    )
                check(f"the field '{item}' of fields.{name}", given[item], shape)
        for name, encoder in self.parts.encoders.items():
            check(
                f"encoder.{name}", encoder.encode(**self.table.pick(encoder.reads)), encoder.shape
            )
        for kind, terms in (
            ("reward", self.parts.rewards),
            ("termination", self.parts.terminations),
        ):
            for term in terms:
                value = self._evaluate(term)
                check(f"{kind}.terms.{term.name}", value, ())
                if kind == "termination" and value.dtype != torch.bool:
                    raise ConfigError(
                        f"termination.terms.{term.name} returns {value.dtype}; it must return bool."
                    )
        self._reward()

    # ------------------------------------------------------------------ state

    def state_dict(self) -> State:
        """Everything that decides the future of the worlds, exactly."""
        return {
            "simulator": self.parts.simulator.snapshot(),
            "initial_states": self.parts.initial_states.state_dict(),
            "streams": self._streams.state_dict(),
            "episode_step": self.episode_step.clone(),
            "episode_fields": {k: v.clone() for k, v in self._episode_fields.items()},
            "observations": {k: v.clone() for k, v in self.observations.items()},
            "statistics": self.statistics.state_dict(),
            "quarantined": self.quarantined.clone(),
        }

    def load_state_dict(self, state: State) -> None:
        self.parts.simulator.restore(state["simulator"])
        self.parts.initial_states.load_state_dict(state.get("initial_states", {}))
        self._streams.load_state_dict(state["streams"])
        self.episode_step.copy_(state["episode_step"])
        for name, value in self._episode_fields.items():
            value.copy_(state["episode_fields"][name])
        self.observations = {k: v.clone().to(self.device) for k, v in state["observations"].items()}
        self.statistics.load_state_dict(state["statistics"])
        self.quarantined.copy_(state["quarantined"])
        self._refresh()

    def close(self) -> None:
        self.parts.simulator.close()


def _rows(mask: Tensor, like: Tensor) -> Tensor:
    """`mask` (N,) shaped to broadcast over the rows of `like` (N, …)."""
    return mask.view(-1, *([1] * (like.dim() - 1)))


def sound(value: Tensor) -> Tensor:
    """(N,) bool: the rows of `value` (N, …) in which every number is finite and of sane size."""
    return (
        (value.abs() < LARGEST).flatten(1).all(dim=1) if value.dim() > 1 else value.abs() < LARGEST
    )


class EpisodeStatistics:
    """Lengths, returns and reasons of ended episodes, summed on the device."""

    def __init__(self, terms: Sequence[str], num_worlds: int, device: torch.device) -> None:
        self.terms = list(terms)
        self._return = torch.zeros(num_worlds, device=device)
        names = [
            "episodes",
            "steps",
            "return",
            "truncated",
            "unsound",
            *(f"ended_by/{t}" for t in terms),
        ]
        self._names = names
        self._sums = torch.zeros(len(names), dtype=torch.float64, device=device)

    def forget_running(self) -> None:
        self._return.zero_()

    def digest(
        self,
        rewards: Tensor,
        ended: Tensor,
        truncated: Tensor,
        unsound: Tensor,
        endings: Mapping[str, Tensor],
        steps: Tensor,
    ) -> None:
        """Digest one step, before ended worlds begin anew; `steps` (N,) counts the episodes'."""
        self._return.add_(rewards)
        columns = [
            ended,
            steps * ended,
            self._return * ended,
            truncated,
            unsound,
            *(endings[t] & ended for t in self.terms),
        ]
        self._sums += torch.stack([c.to(torch.float32) for c in columns]).sum(1)
        self._return.masked_fill_(ended, 0.0)

    def collect(self, control_dt: float) -> dict[str, float]:
        """Means since the last call, in seconds and shares; resets the sums. One host transfer."""
        sums = dict(zip(self._names, self._sums.tolist(), strict=True))
        self._sums.zero_()
        episodes = sums["episodes"]
        row: dict[str, float] = {"episodes": episodes, "unsound": sums["unsound"]}
        if episodes:
            row["episode_seconds"] = sums["steps"] / episodes * control_dt
            row["return"] = sums["return"] / episodes
            row["truncated"] = sums["truncated"] / episodes
            for term in self.terms:
                row[f"ended_by/{term}"] = sums[f"ended_by/{term}"] / episodes
        return row

    def state_dict(self) -> State:
        return {"return": self._return.clone(), "sums": self._sums.clone()}

    def load_state_dict(self, state: State) -> None:
        self._return.copy_(state["return"])
        self._sums.copy_(state["sums"])


def refuse_hopeless(unsound: float, steps: int, num_worlds: int) -> None:
    """Stop a training in which most worlds fail numerically all the time.

    Raises
    ------
    TrainingError
        if more than a quarter of all world-steps of an iteration were quarantined.
    """
    share = unsound / max(1, steps * num_worlds)
    if share > 0.25:
        raise TrainingError(
            f"{share:.0%} of all steps ended in non-finite or diverged states. The usual causes are "
            "a time step too large for the gains, initial states in deep penetration, or an action "
            "scale far too large."
        )
