"""A task whose every number can be worked out by hand: a point on a line that actions push.

One physics step moves the point by its gain times the control, so with whole numbers all arithmetic
is exact. Its simulator hands out its own memory, as engines may.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType, SimpleNamespace
from typing import Any

import torch
from torch import Tensor, nn

from understudy.random import WorldStreams
from understudy.running.environment import Environment
from understudy.running.promises import Parts
from understudy.running.step import Step
from understudy.setup import composition
from understudy.setup import plugins as setup_plugins
from understudy.setup.plugins import Plugins, hookimpl, load
from understudy.setup.registry import Registrar
from understudy.task import (
    Actuation,
    Context,
    Encoder,
    InitialStates,
    Rollout,
    Scene,
    Shape,
    Simulator,
    State,
    box,
)
from understudy.task.terms import Term, Wired, make_term, renamed
from understudy.testing import fake
from understudy_inspect import commands, origins
from understudy_reinforcement.learner import Learner
from understudy_reinforcement.policy import Distribution, Policy
from understudy_sweeps import sweep
from understudy_training import workflow


class LineScene(Scene):
    """A line."""

    def __init__(self, options: None = None, context: Context | None = None) -> None:
        pass

    def describe(self) -> dict[str, Any]:
        return {}


class Line(Simulator):
    """``x`` (N, 1) moves by ``gain`` × control in each physics step; the gain is 1 unless varied."""

    fields: Mapping[str, Shape] = {"x": (1,)}
    state_fields = ("x",)
    control_size = 1
    parameters: Mapping[str, Shape] = {"gain": ()}

    def __init__(self, options: None, context: Any) -> None:
        n = context.num_worlds
        self._substeps = context.substeps
        self.x, self.gain = torch.zeros(n, 1), torch.ones(n)
        #: The ``substeps`` of every call of :meth:`step`.
        self.calls: list[int | None] = []

    def vary(self, names: Sequence[str]) -> None:
        super().vary([name for name in names if name not in self.parameters])
        self.fields = {**self.fields, **{name: self.parameters[name] for name in names}}

    def read(self, name: str) -> Tensor:
        return {"x": self.x, "gain": self.gain}[name]

    def set_state(self, worlds: Tensor, state: Mapping[str, Tensor]) -> None:
        self.x.copy_(torch.where(worlds.unsqueeze(1), state["x"], self.x))
        if "gain" in state:
            self.gain.copy_(torch.where(worlds, state["gain"], self.gain))

    def step(self, control: Tensor, substeps: int | None = None) -> None:
        self.calls.append(substeps)
        for _ in range(substeps or self._substeps):
            self.x += self.gain.unsqueeze(1) * control

    def failed(self) -> Tensor:
        return ~(self.x.abs() < 1e10).all(1)

    def snapshot(self) -> dict[str, Tensor]:
        return {"x": self.x.clone(), "gain": self.gain.clone()}

    def restore(self, snapshot: Mapping[str, Tensor], worlds: Tensor | None = None) -> None:
        which = torch.ones(len(self.x), dtype=torch.bool) if worlds is None else worlds
        self.x.copy_(torch.where(which.unsqueeze(1), snapshot["x"], self.x))
        self.gain.copy_(torch.where(which, snapshot["gain"], self.gain))


class Where(Encoder):
    """The position, (N, 1): the simulator's own memory."""

    reads = ("x",)
    shape = (1,)

    def __init__(self, options: None = None, context: Context | None = None) -> None:
        pass

    def encode(self, x: Tensor) -> Tensor:
        return x


class Push(Actuation):
    """The action is the control."""

    action_space = box(1)

    def __init__(self, options: None = None, context: Context | None = None) -> None:
        pass

    def control(self, action: Tensor) -> Tensor:
        return action


class Starts(InitialStates):
    """Whole numbers in [0, `count`), drawn; ``taken`` (N, 1) each time."""

    @dataclass(frozen=True)
    class Options:
        count: int = 1

    def __init__(self, options: Options | None = None, context: Context | None = None) -> None:
        self.count = (options or self.Options()).count
        self.taken: list[Tensor] = []

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        self.taken.append((streams.uniform(1) * self.count).floor())
        return {"x": self.taken[-1]}


def value(x: Tensor) -> Tensor:
    """The position."""
    return x[:, 0]


def beyond(x: Tensor, *, limit: float = 1e6) -> Tensor:
    """At `limit` or further."""
    return x[:, 0] >= limit


@dataclass(frozen=True)
class Certain(Distribution):
    """Always `mean` (…, 1)."""

    mean: Tensor

    def sample(self, streams: WorldStreams) -> Tensor:
        return self.mean.detach()

    def mode(self) -> Tensor:
        return self.mean

    def log_prob(self, action: Tensor) -> Tensor:
        return torch.zeros(action.shape[:-1])

    def entropy(self) -> Tensor:
        return torch.zeros(self.mean.shape[:-1])

    def divergence(self, other: Any) -> Tensor:
        return torch.zeros(self.mean.shape[:-1])

    def map(self, change: Callable[[Tensor], Tensor]) -> Certain:
        return Certain(change(self.mean))


class Steady(Policy):
    """Pushes equally everywhere: ``push`` is its actor, ``worth`` its critic, ``seen`` what it
    normalises by."""

    seen: Tensor

    @dataclass(frozen=True)
    class Options:
        push: float = 0.0
        width: int = 1  #: of the critic

    def __init__(self, options: Options | None = None, context: Context | None = None) -> None:
        super().__init__()
        options = options or self.Options()
        self.push = nn.Parameter(torch.tensor(options.push))
        self.worth = nn.Parameter(torch.zeros(options.width))
        self.register_buffer("seen", torch.zeros(()))

    def distribution(self, observations: Mapping[str, Tensor]) -> Certain:
        (observed,) = observations.values()
        return Certain(self.push.expand(*observed.shape[:-1], 1))

    def value(self, observations: Mapping[str, Tensor]) -> Tensor:
        (observed,) = observations.values()
        return observed[..., 0] + self.worth.sum()

    def actor_parameters(self) -> Iterator[nn.Parameter]:
        yield self.push

    def critic_parameters(self) -> Iterator[nn.Parameter]:
        yield self.worth

    def observe(self, observations: Mapping[str, Tensor]) -> None:
        self.seen += 1


class Nudge(Learner):
    """Raises the push by `rate` at every update."""

    @dataclass(frozen=True)
    class Options:
        rollout_steps: int = 2
        rate: float = 1.0

    def __init__(self, options: Options, context: Context, policy: Policy) -> None:
        self.rollout_steps, self._rate = options.rollout_steps, options.rate
        self._policy: Any = policy
        self.updates = 0

    def update(self, rollout: Rollout) -> dict[str, float]:
        rollout.returns = rollout.values = rollout.episode_returns
        with torch.no_grad():
            self._policy.push += self._rate
        self.updates += 1
        return {"push": float(self._policy.push.detach())}

    def state_dict(self) -> State:
        return {"updates": self.updates}

    def load_state_dict(self, state: State) -> None:
        self.updates = state["updates"]


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.component("scene", "line", LineScene)
    register.component("simulator", "line", Line)
    register.component("encoder", "line/where", Where)
    register.component("actuation", "line/push", Push)
    register.component("initial_states", "line/starts", Starts)
    for kind in ("reward", "measure"):
        register.component(kind, "line/value", value)
    for kind in ("termination", "measure"):
        register.component(kind, "line/beyond", beyond)
    register.component("policy", "line/steady", Steady)
    register.component("learner", "line/nudge", Nudge)


#: Overrides that make a complete task: decisions of one second, of one physics step each.
LINE_TASK = (
    "+scene={name: line}",
    "+simulator={name: line}",
    "+encoder.state={name: line/where}",
    "+actuation={name: line/push}",
    "+reward.terms.at={name: line/value}",
    "+initial_states={name: line/starts}",
    "+policy={name: line/steady}",
    "+learner={name: line/nudge}",
    "num_worlds=4",
    "control.frequency=1",
    "control.substeps=1",
    "episode.seconds=5",
    "evaluation.seconds=4",
    "evaluation.episodes=4",
    "evaluation.final_episodes=4",
)


def line_plugins(**components: Mapping[str, Any] | Callable[..., Any]) -> Plugins:
    """The plugins of this environment, the fake task's, the line's, and a plugin ``mine`` with
    `components`, each ``kind={name: factory}``."""
    mine = ModuleType("mine")

    def register(register: Registrar) -> None:
        for kind, named in components.items():
            for name, factory in dict(named).items():  # type: ignore[call-overload]
                register.component(kind, name, factory)

    mine.understudy_register = hookimpl(register)  # type: ignore[attr-defined]
    this = sys.modules[__name__]
    return load(
        only=["sweeps", "inspect", "judging", "reinforcement", "training"],
        extra=[("fake", fake), ("line", this), ("mine", mine)],
    )


def bound(part: Any, where: str = "part", **names: Mapping[str, str]) -> Wired[Any]:
    """`part` with the fields it reads and provides under their own names, or as `names` say."""
    given = getattr(part, "keeps", getattr(part, "provides", {}))
    return Wired(
        where,
        part,
        renamed(where, "reads", part.reads, names.get("reads", {})),
        renamed(where, "provides", tuple(given), names.get("provides", {})),
    )


def term(function: Callable[..., Any], name: str = "", **counts: Any) -> Term:
    """`function` as a term of the name `name`, else its own; `counts` may say where it stands."""
    name = name or function.__name__
    where = counts.pop("where", f"terms.{name}")
    reads, options = counts.pop("reads", {}), counts.pop("options", {})
    return make_term(where, name, function, options, reads=reads, **counts)


def line(
    *,
    worlds: int = 4,
    seconds: float = 5.0,
    substeps: int = 1,
    actuation: Actuation | None = None,
    encoders: Mapping[str, Any] | None = None,
    initial_states: InitialStates | None = None,
    simulator: Simulator | None = None,
    rewards: Sequence[Term] | None = None,
    **more: Any,
) -> Environment:
    """An environment of these parts, else of the line's; `more` are further parts, or of its
    context."""
    made = simulator or Line(None, SimpleNamespace(num_worlds=worlds, substeps=substeps))
    kinds = ("terminations", "measures", "fields", "memories", "curriculum", "combine")
    parts = Parts(
        made,
        bound(actuation or Push(), "actuation"),
        initial_states or Starts(),
        {k: bound(v, f"encoder.{k}") for k, v in (encoders or {"state": Where()}).items()},
        [term(value)] if rewards is None else rewards,
        **{kind: more.pop(kind) for kind in kinds if kind in more},
    )
    rates = {"control_dt": 1.0, "substeps": substeps, **more}
    context = Context(0, torch.device("cpu"), worlds, **rates)
    return Environment(parts, context, episode_seconds=seconds)


def push(environment: Environment, *forces: float) -> Step:
    """A decision: each world's force, or the same for all."""
    action = torch.tensor(forces or (0.0,)).view(-1, 1).expand(environment.num_worlds, 1)
    return environment.step(action)


def install(monkeypatch: Any, plugins: Plugins) -> None:
    """Make `plugins` those that commands find installed."""
    for module in (setup_plugins, composition, commands, origins, sweep, workflow):
        monkeypatch.setattr(module, "installed", lambda: plugins)
