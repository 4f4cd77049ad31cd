"""A skill's or finished run's encoders, policy and actuation, at work inside another task."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from torch import Tensor, nn

from understudy.errors import ConfigError
from understudy.setup.building import build_policy, build_sections
from understudy.setup.config import Chosen
from understudy.task import Actuation, Context, Encoder
from understudy.task.terms import Wired, renamed
from understudy_skills.skill import copy_run, open_skill

__all__ = ["Controller"]


class Controller(nn.Module):
    """What another run learned, as a function of this task's state: fields in, controls out.

    It is built for this task's scene and simulator, with the run's own config sections (its clip).
    The weights are frozen; to learn on, ask for their gradients (``requires_grad_``) and give them to
    a policy.
    """

    def __init__(
        self, encoders: Mapping[str, Wired[Encoder]], actuation: Wired[Actuation], policy: nn.Module
    ) -> None:
        super().__init__()
        self.encoders, self.actuation = dict(encoders), actuation
        self.policy: Any = policy.requires_grad_(False)

    @classmethod
    def load(cls, source: str, context: Context) -> Controller:
        """The controller of the run folder `source`, with the weights of its newest checkpoint, of the skill
        of this name that comes with a plugin, or of the packed file `source`. A run that this task is
        trained in keeps a copy of folder or file.

        Raises
        ------
        ConfigError
            if there is no such run or skill, or its parts do not fit this task's scene or simulator.
        RunError
            if it is damaged, or its checkpoint does not fit its configuration.
        """
        assert context.registry is not None
        asked, place, path = f"controller {source}", source, Path(source)
        if path.suffix == ".json":
            place = str(
                context.inputs.file(asked, lambda: [path, path.with_suffix(".safetensors")])
            )
        elif source not in context.registry.names("skill"):
            fill = functools.partial(copy_run, source)
            place = str(context.inputs.folder_of(asked, path, fill))
        # It acts on this task's simulator.
        skill = open_skill(place, registry=context.registry, without=("simulator",))
        experiment = skill.experiment
        control = experiment.root.control
        if abs(1.0 / control.frequency - context.control_dt) > 1e-9 or control.decision != 1:
            raise ConfigError(
                f"{source} decides {control.frequency / control.decision:g} times a second, and this "
                f"task's control periods are {1.0 / context.control_dt:g} a second. Set "
                f"control.frequency={control.frequency:g}, or train that run for this task's rate."
            )
        own = replace(
            context, sections=build_sections(experiment), inputs=experiment.inputs, _shared={}
        )

        def wired(chosen: Chosen) -> Wired[Any]:
            part = chosen.build(own)
            where = f"{chosen.where} of {source}"
            return Wired(where, part, renamed(where, "reads", part.reads, chosen.extras["reads"]))

        encoders = {c.name: wired(c) for c in experiment.many("encoder")}
        actuation = wired(experiment.need("actuation"))
        if actuation.part.keeps:
            raise ConfigError(
                f"{source} cannot be a controller inside another task: its actuation keeps a state."
            )
        own.action_space = actuation.part.action_space
        own.observation_shapes = {name: e.part.shape for name, e in encoders.items()}
        policy = build_policy(experiment, own)
        replace(skill, name=source).give(policy)
        return cls(encoders, actuation, policy)

    @property
    def reads(self) -> tuple[str, ...]:
        """The fields of this task that it takes."""
        parts = (*self.encoders.values(), self.actuation)
        return tuple(dict.fromkeys(name for part in parts for name in part.reads.values()))

    def forward(self, fields: Mapping[str, Tensor]) -> Tensor:
        """The control (N, U) that its deterministic policy chooses, from `fields` (N, …) by name."""
        observations = {
            name: encoder.part.encode(**{own: fields[f] for own, f in encoder.reads.items()})
            for name, encoder in self.encoders.items()
        }
        action = self.policy.distribution(observations).mode()
        taken = {own: fields[f] for own, f in self.actuation.reads.items()}
        return self.actuation.part.control(action, **taken)
