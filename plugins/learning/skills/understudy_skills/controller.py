"""The encoders, policy and actuation of a skill or a finished run, inside another task."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Iterator, Mapping
from contextvars import ContextVar
from dataclasses import replace
from pathlib import Path
from typing import Any

from torch import Tensor, nn

from understudy.errors import ConfigError
from understudy.setup.building import build_sections
from understudy.setup.config import Chosen
from understudy.task import Actuation, Context, Encoder
from understudy.task.terms import Wired, renamed
from understudy_reinforcement.policy import build_policy
from understudy_skills.as_run import copy_run
from understudy_skills.own_physics import tell_of_other_physics
from understudy_skills.pack_inputs import PACKED, PackInputs
from understudy_skills.skill import Skill, open_skill

__all__ = ["Controller"]

#: Controllers within one, whose parts may be controllers: how deep, and how many in all.
_DEPTH, _MOST = 4, 100
#: How deep a controller is being built, and the names of those within the outermost so far.
_BUILDING: ContextVar[tuple[int, list[str]] | None] = ContextVar("building", default=None)


@contextlib.contextmanager
def _within(source: str) -> Iterator[None]:
    """Build `source`; a ConfigError if it contains itself, or is nested too deep."""
    depth, names = _BUILDING.get() or (0, [])
    names.append(source)
    if depth > _DEPTH or len(names) > _MOST:
        raise ConfigError(
            f"{source} is a controller within others, more than {_DEPTH} deep or {_MOST} in all; perhaps it "
            "stands in itself. Choose another run."
        )
    token = _BUILDING.set((depth + 1, names))
    try:
        yield
    finally:
        _BUILDING.reset(token)


def _place(source: str, asked: str, context: Context) -> str:
    """What to open for the controller `source`: a name, or the run's copy."""
    assert context.registry is not None
    path, inputs = Path(source), context.inputs
    if path.suffix == ".json":
        return str(inputs.file(asked, lambda: [path, path.with_suffix(".safetensors")]))
    if any(Path(name).name == f"{PACKED}.json" for name in inputs.kept.get(asked, ())):
        return str(inputs.file(asked, list))
    if source in context.registry.names("skill"):
        return source
    return str(inputs.folder_of(asked, path, functools.partial(copy_run, source)))


class Controller(nn.Module):
    """What another run learned, as a function of this task's state: fields in, controls out.

    A controller is built for this task's scene and simulator, with the run's own config sections (its clip).
    The weights are frozen; to train them further, ask for gradients (``requires_grad_``) and give them to a
    policy.
    """

    def __init__(
        self, encoders: Mapping[str, Wired[Encoder]], actuation: Wired[Actuation], policy: nn.Module,
        decision: int = 1, holds: int = 1,
    ) -> None:  # fmt: skip
        super().__init__()
        self.decision = decision  #: control periods for which what it decides holds
        self.holds = holds  #: and those for which a control of it does, after which it is asked for the next one
        self.action_size = actuation.part.action_space.size
        self.encoders, self.actuation = dict(encoders), actuation
        self.policy: Any = policy.requires_grad_(False)

    @classmethod
    def load(
        cls, source: str, context: Context, *, any_rate: bool = False, slower: bool = False
    ) -> Controller:
        """The controller of `source`: a run folder, of which the newest checkpoint counts, the name of a skill that comes
        with a plugin, or a packed file. A run of this task keeps a copy of the folder or file. With `any_rate` it may
        decide every n-th control period (``decision``), which is up to the caller of :meth:`decide` and :meth:`control`; if
        it may be `slower`, its own control periods may be several of this task's (``holds``), too.

        Raises
        ------
        ConfigError
            if there is no such run or skill, its parts do not fit this task's scene or simulator, or it is
            within itself.
        RunError
            if it is damaged, or its checkpoint does not fit its configuration.
        """
        with _within(source):
            return cls._load(source, context, any_rate, slower)

    @classmethod
    def _load(cls, source: str, context: Context, any_rate: bool, slower: bool) -> Controller:
        assert context.registry is not None
        inputs, asked = context.inputs, f"controller {source}"

        def find() -> Skill:
            return open_skill(
                _place(source, asked, context), registry=context.registry, without=("simulator",)
            )

        # It acts on this task's simulator.
        skill = inputs.policy(asked, find) if isinstance(inputs, PackInputs) else find()
        experiment = skill.experiment
        control = experiment.root.control
        periods = max(1, round(1.0 / (control.frequency * context.control_dt))) if slower else 1
        if abs(1.0 / control.frequency - periods * context.control_dt) > 1e-9:
            raise ConfigError(
                f"{source} decides {control.frequency / control.decision:g} times a second, and this "
                f"task's control periods are {1.0 / context.control_dt:g} a second. Set "
                f"control.frequency={control.frequency:g}, or train that run for this task's rate."
            )
        if control.decision != 1 and not any_rate:
            raise ConfigError(
                f"{source} decides in every {control.decision}. control period, and is asked in each one here. Train that "
                "run with control.decision=1."
            )
        tell_of_other_physics(source, experiment, context)
        own = replace(
            context, sections=build_sections(experiment), inputs=experiment.inputs, _shared={}
        )

        def wired(chosen: Chosen) -> Wired[Any]:
            part = chosen.build(own)
            where = f"{chosen.where} of {source}"
            return Wired(where, part, renamed(where, "reads", part.reads, chosen.extras["reads"]))

        encoders = {c.name: wired(c) for c in experiment.many("encoder")}
        actuation = wired(experiment.need("actuation"))
        # what it keeps for others alone, such as rewards, is not needed to act
        if own_state := sorted(actuation.part.keeps.keys() & set(actuation.part.reads)):
            raise ConfigError(
                f"{source} cannot be a controller inside another task: its actuation goes on from a state of its own, "
                f"{own_state[0]}."
            )
        own.action_space = actuation.part.action_space
        own.observation_shapes = {name: e.part.shape for name, e in encoders.items()}
        policy = build_policy(experiment, own)
        replace(skill, name=source).give(policy)
        once = control.decision if actuation.part.every == "decision" else 1
        holds = periods * once if periods > 1 else 1
        return cls(encoders, actuation, policy, periods * control.decision, holds)

    @property
    def reads(self) -> tuple[str, ...]:
        """The fields of this task that it takes."""
        parts = (*self.encoders.values(), self.actuation)
        return tuple(dict.fromkeys(name for part in parts for name in part.reads.values()))

    def forward(self, fields: Mapping[str, Tensor]) -> Tensor:
        """The control (N, U) that its deterministic policy chooses, from `fields` (N, …) by name."""
        return self.control(self.decide(fields), fields)

    def decide(self, fields: Mapping[str, Tensor]) -> Tensor:
        """The action (N, A) that its deterministic policy chooses."""
        observations = {
            name: encoder.part.encode(**{own: fields[f] for own, f in encoder.reads.items()})
            for name, encoder in self.encoders.items()
        }
        action: Tensor = self.policy.distribution(observations).mode()
        return action

    def control(self, action: Tensor, fields: Mapping[str, Tensor]) -> Tensor:
        """The control (N, U) for an action (N, A) of its policy."""
        taken = {own: fields[f] for own, f in self.actuation.reads.items()}
        return self.actuation.part.control(action, **taken)
