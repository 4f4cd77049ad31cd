"""The batched environment: assembles a task from named parts and steps N worlds of it.

Everything is masked tensor arithmetic over all worlds; there is no Python loop over worlds and, on
an accelerator, nothing is fetched to the host inside :meth:`Environment.step`. Tensors that live
longer than a step are changed in place, so that a step can be captured and replayed.
"""

from __future__ import annotations

import contextlib
import functools
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.random import WorldStreams
from understudy.running import promises
from understudy.running.promises import Parts
from understudy.running.rewards import Rewards
from understudy.running.soundness import rows, sound, without_unsound
from understudy.running.statistics import EpisodeStatistics
from understudy.running.step import Step
from understudy.running.table import FieldTable
from understudy.task import Context, Memory, Shape, State
from understudy.task.terms import Term, Wired

__all__ = ["OWN_FIELDS", "Environment"]

#: What this step's terminations made of the episode: it failed; it succeeded; a failure term, or
#: one that only reports, holds.
_OUTCOMES = ("failed", "succeeded", "violated")
#: Fields that the environment itself provides, beside ``action`` (A,) and ``previous_NAME``, which
#: is any field before this step. The outcomes are set once this step's terminations are known, so
#: only rewards and measures may read them; only measures may read ``reward``.
OWN_FIELDS: dict[str, Shape] = dict.fromkeys(
    ("episode_time", "episode_step", "episode_limit", "difficulty", *_OUTCOMES, "reward"), ()
)
_PREVIOUS = "previous_"

# OpenMP would wait for threads that a forked process does not have.
os.register_at_fork(after_in_child=lambda: torch.set_num_threads(1))


def _as_physics(method: Callable[..., Any]) -> Callable[..., Any]:
    """Run a method of the environment with torch's settings for physics, not the learner's.

    Matrix products are full float32: TF32 keeps three digits, too few for positions and rotations.
    On the CPU torch has one thread: the tensors are too small to gain from more, and idle threads
    of its pool would spin on the cores that the simulator's threads need.
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
            with torch.no_grad():
                return method(self, *args, **options)
        finally:
            products.allow_tf32 = reduced
            if alone:
                torch.set_num_threads(threads)

    return wrapped


def _replace(kept: Tensor, value: Tensor, worlds: Tensor | None) -> None:
    """Write `value` (N, …) into `kept`: in all worlds, or where `worlds` (N,) is true."""
    kept.copy_(value if worlds is None else torch.where(rows(worlds, kept), value, kept))


class Environment:
    """N worlds of one task.

    `context` has N, device, seed and rates, and the value of the field ``difficulty``, unless the
    curriculum provides that. Episodes are truncated at `episode_seconds`, or at the curriculum's
    ``episode_limit`` (except in evaluations). `known_fields` tells which components provide a
    field, for errors. A ConfigError if a part reads a field that nothing provides.
    """

    def __init__(
        self,
        parts: Parts,
        context: Context,
        *,
        episode_seconds: float,
        known_fields: Callable[[str], Sequence[str]] = lambda name: (),
    ) -> None:
        self.parts, self._context = parts, context
        num_worlds, device, seed = context.num_worlds, context.device, context.seed
        self.num_worlds, self.device, self.control_dt = num_worlds, device, context.control_dt
        curriculum = parts.curriculum
        set_by_curriculum = dict(curriculum.provides) if curriculum else {}
        parameters = parts.simulator.parameters
        varies = parts.initial_states.varies
        self._varied = [*varies, *(n for n in set_by_curriculum if n in parameters)]
        if self._varied:
            parts.simulator.vary(self._varied)
        #: The model's values of these, for other starts of an evaluation, which may vary fewer.
        self._model = {name: parts.simulator.read(name).clone() for name in varies}
        constants: dict[str, Shape] = {"difficulty": (), "episode_limit": ()}
        constants |= {n: s for n, s in set_by_curriculum.items() if n not in parameters}

        def zeros(shape: Shape, dtype: torch.dtype = torch.float32) -> Tensor:
            return torch.zeros((num_worlds, *shape), dtype=dtype, device=device)

        shapes = {**constants, **parts.initial_states.episode_fields}
        #: Constants of the running episodes, (N, …).
        self._constants = {name: zeros(shape) for name, shape in shapes.items()}
        self._constants["difficulty"].fill_(context.difficulty)
        self._constants["episode_limit"].fill_(episode_seconds)
        #: What the environment keeps for actuation and memories, (N, …), by field.
        self._kept: dict[str, Tensor] = {}
        self.action = zeros((parts.actuation.part.action_space.size,))
        own = {**OWN_FIELDS, "action": tuple(self.action.shape[1:])}
        self.table = FieldTable(parts.simulator, parts.fields, own)
        extra = {n: s for n, s in constants.items() if n not in OWN_FIELDS}
        self.table.add(extra, "the curriculum")
        self.table.add(parts.initial_states.episode_fields, "initial_states")
        for part in (parts.actuation, *parts.memories.values()):
            kept = {part.provides[name]: shape for name, shape in part.part.keeps.items()}
            self.table.add(kept, part.where)
            self._kept |= {name: zeros(shape) for name, shape in kept.items()}
        self._resolve_fields(known_fields)
        self.episode_step = zeros((), torch.int64)
        self._nowhere, self._nothing = zeros((), torch.bool), zeros(())
        self.unsound = zeros((), torch.bool)  #: worlds whose physics went wrong in this step
        self._streams = WorldStreams(seed, "initial_states", num_worlds, device)
        self._memory_streams = {
            name: WorldStreams(seed, f"memory/{name}", num_worlds, device)
            for name, memory in parts.memories.items()
            if memory.part.uniforms
        }
        self.observations: dict[str, Tensor] = {}
        #: Fields of the states reached that a :class:`Step` is to contain, (N, …).
        self.next_fields: Sequence[str] = ()
        self.statistics = EpisodeStatistics(parts.terminations, num_worlds, device)
        #: How often a world's numbers went wrong, since the start.
        self.quarantined = torch.zeros((), dtype=torch.int64, device=device)
        #: Called once, when numbers first go wrong in some worlds (W,), with all that it takes to
        #: repeat it: ``worlds``, the simulator's ``snapshot`` before the decision, its ``controls``
        #: (K, W, U) in order, and the ``substeps`` of each (None: a control period).
        self.on_quarantine: Callable[[State], None] | None = None
        #: Called before each control period.
        self.on_period: Callable[[], None] | None = None
        self._controls: list[Tensor] = []
        #: By reward term: its summand, or factor, of the last decision's reward, (N,).
        self.rewarded: dict[str, Tensor] = {}
        self.rewards = Rewards(parts.rewards, parts.combine, num_worlds, device)
        self.captured_step = parts.simulator.replayed(self._step, self)

    @property
    def action_size(self) -> int:
        return self.parts.actuation.part.action_space.size

    @property
    def observation_shapes(self) -> dict[str, Shape]:
        return {name: encoder.part.shape for name, encoder in self.parts.encoders.items()}

    @property
    def observation_columns(self) -> dict[str, tuple[str, ...]]:
        """By observation: the names of its columns, flattened; numbers if it names none."""
        return {
            name: tuple(e.part.columns) or tuple(map(str, range(math.prod(e.part.shape))))
            for name, e in self.parts.encoders.items()
        }

    def __repr__(self) -> str:
        sees = ", ".join(f"{name} {list(s)}" for name, s in self.observation_shapes.items())
        return (
            f"Environment({self.num_worlds} worlds on {self.device}, {1 / self.control_dt:g} Hz; "
            f"sees {sees}; acts {self.action_size})"
        )

    @property
    def decision(self) -> int:
        """Control periods that one action lasts."""
        chosen = self.parts.curriculum.decision() if self.parts.curriculum else None
        return chosen or self._context.decision

    def _resolve_fields(self, givers: Callable[[str], Sequence[str]]) -> None:
        """Check that every field that is read exists, leave out optional ones that do not, and add
        the ``previous_`` fields that are read."""
        parts, table = self.parts, self.table

        def exists(name: str) -> bool:
            return name.removeprefix(_PREVIOUS) in table.shapes

        def resolved(term: Term) -> Term:
            kept = {p: f for p, f in term.reads.items() if p not in term.optional or exists(f)}
            return replace(term, reads=kept)

        parts.rewards, parts.terminations, parts.measures = (
            [resolved(term) for term in terms]
            for terms in (parts.rewards, parts.terminations, parts.measures)
        )
        wanted = list(self.readers())
        asked = {name for _, names in wanted for name in names if name.startswith(_PREVIOUS)}
        previous = sorted(name for name in asked if name not in table.shapes and exists(name))
        shapes = {name: table.shapes[name.removeprefix(_PREVIOUS)] for name in previous}
        table.add(shapes, "the environment")
        self._previous: dict[str, Tensor | None] = dict.fromkeys(previous)
        for who, names in wanted:
            table.need(who, names, givers)
        for name in parts.initial_states.reads:
            if name not in self._constants or name in parts.initial_states.episode_fields:
                raise ConfigError(
                    f"initial_states needs '{name}' of the curriculum, which does not provide it. "
                    "Choose another curriculum (curriculum=…) or other initial states."
                )

    def readers(self) -> Iterator[tuple[str, Sequence[str]]]:
        """Every part that reads fields: its place in the configuration, and the fields."""
        parts = self.parts
        encoders, memories = parts.encoders.values(), parts.memories.values()
        for part in (*parts.fields, *encoders, parts.actuation, *memories):
            yield part.where, tuple(part.reads.values())
        for term in (*parts.rewards, *parts.terminations, *parts.measures):
            yield term.where, tuple(term.reads.values())
        yield "initial_states", parts.initial_states.rollout_fields
        yield "curriculum", parts.curriculum.rollout_fields if parts.curriculum else ()

    @_as_physics
    def reset(self, seed: int | None = None, draw: str = "") -> dict[str, Tensor]:
        """Begin a new episode in every world; returns the observations.

        With `seed`, the random streams restart too, so that what follows repeats exactly; `draw`
        names other streams of that seed, so that an evaluation has starts that no training had.
        """
        if seed is not None:
            end = f"/{draw}" if draw else ""
            self._streams.restart(seed, f"initial_states{end}")
            for name, streams in self._memory_streams.items():
                streams.restart(seed, f"memory/{name}{end}")
        everywhere = torch.ones(self.num_worlds, dtype=torch.bool, device=self.device)
        try:
            self._begin(everywhere)
            promises.check_shapes(self.parts, self.table, self.action)
        except promises.MISFITS:
            with contextlib.suppress(*promises.MISFITS):
                promises.name_misfit(self.parts, self.table, self.action)
            raise  # of a part's own
        self.observations = self._first()
        return self.observations

    def step(self, action: Tensor) -> Step:
        """Apply `action` (N, A) for one decision, judge, and begin ended worlds anew."""
        return self.captured_step(action)

    def _step(self, action: Tensor) -> Step:
        step = self.advance(action)
        ended = step.ended
        if self.device.type != "cpu" or bool(ended.any()):
            reached = {name: value.clone() for name, value in step.observations.items()}
            step.observations = self.begin(ended)
            step.final_observations = {  # an unsound world's numbers must not go anywhere
                name: torch.where(rows(step.unsound, value), step.observations[name], value)
                for name, value in reached.items()
            }
        return step

    @_as_physics
    def advance(self, action: Tensor) -> Step:
        """Apply `action` (N, A) for one decision and judge the states reached. These stay, to be
        read, recorded or harvested, until :meth:`begin`."""
        parts, table = self.parts, self.table
        if not self.observations or action.shape != self.action.shape:
            raise ConfigError(f"Give actions of shape {tuple(self.action.shape)} after a reset().")
        self._remember()
        self.action.copy_(action)
        table.put({"action": self.action})
        self.unsound.zero_()
        self._controls.clear()
        before = parts.simulator.snapshot() if self.on_quarantine else None
        self._simulate()

        endings = {term.name: self.evaluate(term) for term in parts.terminations}
        seconds = table["episode_time"]
        outcomes: dict[str, Tensor] = {
            "failure": self.unsound,
            "truncation": seconds >= self._constants["episode_limit"] - 0.5 * self.control_dt,
            "success": self._nowhere,
            "report": self._nowhere,
        }
        for term in parts.terminations:
            outcomes[term.outcome] = outcomes[term.outcome] | endings[term.name]
        failed = outcomes["failure"]
        violated = failed | outcomes["report"]
        succeeded = outcomes["success"] & ~failed
        table.put({"failed": failed, "succeeded": succeeded, "violated": violated})
        rewards = self._reward()
        reached = self.encode()
        unsound = self.unsound | ~sound(rewards)
        for value in reached.values():
            unsound = unsound | ~sound(value)
        failed, succeeded, violated = failed | unsound, succeeded & ~unsound, violated | unsound
        terminated = failed | succeeded
        truncated = outcomes["truncation"] & ~terminated
        rewards = rewards.masked_fill(unsound, 0.0)
        table.put(
            {"failed": failed, "succeeded": succeeded, "violated": violated, "reward": rewards}
        )
        self._quarantine(unsound, before)
        self.observations = reached
        kept = {name: without_unsound(table[name]).clone() for name in self.next_fields}
        summed = self.statistics.returns.add_(rewards).clone()
        step = Step(reached, rewards, terminated, failed, truncated, unsound, summed, endings, kept)
        self.statistics.digest(step, seconds)
        return step

    @_as_physics
    def begin(self, worlds: Tensor) -> dict[str, Tensor]:
        """Begin new episodes where `worlds` (N,) is true; returns the observations of all."""
        self._begin(worlds)
        self.observations = self._first()
        return self.observations

    @_as_physics
    def measure(self) -> dict[str, Tensor]:
        """Each measure of the states reached, (N,) float32."""
        return {term.name: self.evaluate(term).float() for term in self.parts.measures}

    def _simulate(self) -> None:
        """Simulate one decision, with new controls as often as the actuation's ``every`` says."""
        actuation, simulator = self.parts.actuation.part, self.parts.simulator
        pieces = self._context.substeps if actuation.every == "substep" else 1
        length = 1 if actuation.every == "substep" else None
        control = applied = None
        for _ in range(self.decision):
            if self.on_period is not None:
                self.on_period()
            for _ in range(pieces):
                if control is None or applied is None or actuation.every != "decision":
                    control = self._control()
                    good = sound(control)
                    self.unsound |= ~good
                    applied = torch.where(good.unsqueeze(1), control, 0.0)
                if self.on_quarantine is not None:
                    self._controls.append(control.clone())
                simulator.step(applied, length)
                self.unsound |= simulator.failed()  # the next step might hide it
                self.refresh()
            self.episode_step += 1
            self.refresh()
            for name, memory in self.parts.memories.items():
                kept = {own: self._kept[field] for own, field in memory.provides.items()}
                self._keep(memory, memory.part.advance(kept, **self._taken(name, memory)))

    def _control(self) -> Tensor:
        """(N, U), as the actuation gives it."""
        wired, table = self.parts.actuation, self.table
        if wired.part.keeps:
            self._keep(wired, wired.part.advance(self.action, **table.pick(wired.reads)))
        return wired.part.control(self.action, **table.pick(wired.reads))

    def _taken(self, name: str, memory: Wired[Memory]) -> dict[str, Tensor]:
        """The arguments of a memory: fields, and random numbers."""
        given = self.table.pick(memory.reads)
        if memory.part.uniforms:
            given["uniforms"] = self._memory_streams[name].uniform(memory.part.uniforms)
        return given

    def _keep(
        self, part: Wired[Any], values: Mapping[str, Tensor], worlds: Tensor | None = None
    ) -> None:
        """Keep the `values` of a part: in all worlds, or where `worlds` (N,) is true."""
        promises.returned(self.num_worlds, part.where, part.part.keeps, values)
        for name, field_name in part.provides.items():
            kept, value = self._kept[field_name], values[name]
            if value is kept:
                continue  # unchanged, so fields computed from it stay valid
            _replace(kept, value, worlds)
            self.table.put({field_name: kept})

    def _remember(self, worlds: Tensor | None = None) -> None:
        """Keep the present values of fields that are read as ``previous_``: in all worlds, or where
        `worlds` (N,) is true."""
        for name, kept in self._previous.items():
            if kept is None:  # the first time: one of the fields below may be computed from it
                shape = (self.num_worlds, *self.table.shapes[name])
                self.table.put({name: torch.zeros(shape, device=self.device)})
        values = {name: self.table[name.removeprefix(_PREVIOUS)] for name in self._previous}
        for name, value in values.items():  # all were read, as they may depend on one another
            kept = self._previous[name]
            if kept is None:
                kept = self._previous[name] = value.clone()
            else:
                _replace(kept, value, worlds)
            self.table.put({name: kept})

    def evaluate(self, term: Term) -> Tensor:
        return term.function(**self.table.pick(term.reads), **term.options)

    def _reward(self) -> Tensor:
        values = [self.evaluate(term) for term in self.parts.rewards]
        reward, self.rewarded = self.rewards.combined(values)
        return reward

    def encode(self) -> dict[str, Tensor]:
        return {
            name: encoder.part.encode(**self.table.pick(encoder.reads))
            for name, encoder in self.parts.encoders.items()
        }

    def _first(self) -> dict[str, Tensor]:
        """The observations after :meth:`_begin`; 0 in worlds that began unsound and fail next."""
        return {name: without_unsound(value) for name, value in self.encode().items()}

    def _begin(self, worlds: Tensor) -> None:
        self.statistics.returns.masked_fill_(worlds, 0.0)
        parts, before = self.parts, self._streams.state_dict()
        given = dict(parts.curriculum.begin(self._streams)) if parts.curriculum else {}
        self._hold(worlds, given)
        initial = parts.initial_states.sample(
            self._streams, **{name: self._constants[name] for name in parts.initial_states.reads}
        )
        self._streams.give_back(~worlds, before)  # what a world draws depends on no other world
        given |= initial
        varied = parts.initial_states.varies
        anew = [n for n in self._varied if n not in self._model or n in varied]
        promises.check_initial(parts, self.num_worlds, anew, given)
        self._hold(worlds, initial)
        simulator, given = parts.simulator, {**self._model, **given}
        simulator.set_state(worlds, {n: given[n] for n in (*simulator.state_fields, *self._varied)})
        if parts.initial_states.settle:
            others = simulator.snapshot()
            idle = torch.zeros((self.num_worlds, simulator.control_size), device=self.device)
            for _ in range(parts.initial_states.settle):
                simulator.step(idle)
            simulator.restore(others, ~worlds)
        self.episode_step.masked_fill_(worlds, 0)
        self.action.masked_fill_(worlds.unsqueeze(1), 0.0)
        self.refresh()
        self._remember(worlds)  # for actuation and memories, which may begin from such fields
        actuation = parts.actuation
        if actuation.part.keeps:
            self._keep(actuation, actuation.part.begin(**self.table.pick(actuation.reads)), worlds)
        for name, memory in parts.memories.items():
            streams = self._memory_streams.get(name)
            drawn = streams.state_dict() if streams else {}
            self._keep(memory, memory.part.begin(**self._taken(name, memory)), worlds)
            if streams:
                streams.give_back(~worlds, drawn)
        self._remember(worlds)

    def _hold(self, worlds: Tensor, values: Mapping[str, Tensor]) -> None:
        """Set the constants of the episodes that begin."""
        for name, constant in self._constants.items():
            if name in values and not (self._context.evaluating and name == "episode_limit"):
                _replace(constant, values[name], worlds)

    def refresh(self) -> None:
        """Forget every value but the environment's own: the state has changed."""
        self.table.values = {
            "episode_step": self.episode_step,
            "episode_time": self.episode_step * self.control_dt,
            **dict.fromkeys(_OUTCOMES, self._nowhere),
            "reward": self._nothing,
            "action": self.action,
            **self._constants,
            **self._kept,
            **{name: kept for name, kept in self._previous.items() if kept is not None},
        }

    def _quarantine(self, unsound: Tensor, before: dict[str, Tensor] | None) -> None:
        self.quarantined += unsound.sum()
        if self.on_quarantine is not None and before is not None and bool(unsound.any()):
            wrong, every = unsound.nonzero().squeeze(1), self.parts.actuation.part.every
            fault = {
                "snapshot": {name: value[wrong] for name, value in before.items()},
                "controls": torch.stack(self._controls)[:, wrong],
                "substeps": 1 if every == "substep" else None,
                "worlds": wrong,
            }
            self.on_quarantine(fault)
            self.on_quarantine = None

    def state_dict(self) -> State:
        """Everything that the future of the worlds depends on, exactly."""
        parts = self.parts
        return {
            "simulator": parts.simulator.snapshot(),
            "initial_states": parts.initial_states.state_dict(),
            "curriculum": parts.curriculum.state_dict() if parts.curriculum else {},
            "streams": self._streams.state_dict(),
            "memory_streams": {k: s.state_dict() for k, s in self._memory_streams.items()},
            "tensors": {k: v.clone() for k, v in self._tensors().items()},
            "observations": {k: v.clone() for k, v in self.observations.items()},
            "statistics": self.statistics.state_dict(),
        }

    def _tensors(self) -> dict[str, Tensor]:
        """By name: the environment's own tensors that outlive a step."""
        return {
            "action": self.action,
            "episode_step": self.episode_step,
            "quarantined": self.quarantined,
            **{f"constant/{k}": v for k, v in self._constants.items()},
            **{f"kept/{k}": v for k, v in self._kept.items()},
            **{k: v for k, v in self._previous.items() if v is not None},
        }

    def load_state_dict(self, state: State) -> None:
        """Continue from a :meth:`state_dict`; only after a :meth:`reset`."""
        parts = self.parts
        parts.simulator.restore(state["simulator"])
        parts.initial_states.load_state_dict(state["initial_states"])
        if parts.curriculum:
            parts.curriculum.load_state_dict(state["curriculum"])
        self._streams.load_state_dict(state["streams"])
        for name, streams in self._memory_streams.items():
            streams.load_state_dict(state["memory_streams"][name])
        for name, value in self._tensors().items():
            value.copy_(state["tensors"][name])
        self.observations = {k: v.clone().to(self.device) for k, v in state["observations"].items()}
        self.statistics.load_state_dict(state["statistics"])
        self.refresh()

    def close(self) -> None:
        self.parts.simulator.close()
