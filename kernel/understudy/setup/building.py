"""From a validated experiment to running parts: sections, scene, simulator, then the rest."""

from __future__ import annotations

import contextlib
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

import torch

from understudy.errors import ConfigError, PluginError
from understudy.random import private_rng
from understudy.running.environment import Environment, Parts, Term
from understudy.setup.config import Experiment, TermChoice
from understudy.setup.registry import Registry
from understudy.task.interfaces import Context, Learner, Policy, Scene, Simulator


@dataclass
class Built:
    """What was built of an experiment."""

    environment: Environment
    context: Context
    scene: Scene


def device_of(name: str) -> torch.device:
    """The torch device `name`, or an error that says why it cannot be used."""
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise ConfigError(f"device={name} is no device. Use cpu, cuda, or cuda:1.") from error
    if device.type == "cuda":
        if not torch.cuda.is_available():
            raise ConfigError(f"device={name}, but torch sees no CUDA GPU here. Use device=cpu.")
        if device.index is None:
            device = torch.device("cuda", torch.cuda.current_device())
    return device


def build_environment(
    experiment: Experiment,
    *,
    num_worlds: int | None = None,
    episode_seconds: float | None = None,
    seed: int | None = None,
    scene: Scene | None = None,
    sections: dict[str, Any] | None = None,
    ending: Collection[str] | None = None,
) -> Built:
    """Build the environment of `experiment`; the keyword arguments replace its own values.

    With `ending`, only the termination terms named in it, and those that truncate, end an episode;
    others are reported.
    """
    root = experiment.root
    device = device_of(root.device)
    context = Context(
        seed=root.seed if seed is None else seed,
        device=device,
        num_worlds=root.num_worlds if num_worlds is None else num_worlds,
        control_dt=1.0 / root.control.frequency,
        substeps=root.control.substeps,
    )
    registry = experiment.registry
    context.sections = sections or {
        name: registry.sections[name].make(options, registry)
        for name, options in experiment.sections.items()
    }
    context.scene = scene or experiment.scene.build(context)
    simulator: Simulator = experiment.simulator.build(context)
    context.simulator = simulator
    parts = Parts(
        simulator=simulator,
        fields=[(name, choice.build(context)) for name, choice in experiment.fields.items()],
        encoders={name: choice.build(context) for name, choice in experiment.encoders.items()},
        actuation=experiment.actuation.build(context),
        initial_states=experiment.initial_states.build(context),
        rewards=[build_term(t, context) for t in experiment.rewards],
        terminations=[
            build_term(
                t
                if ending is None or t.name in ending or t.outcome == "truncation"
                else replace(t, outcome="report"),
                context,
            )
            for t in experiment.terminations
        ],
        combine=root.reward.combine,
    )
    environment = Environment(
        parts,
        num_worlds=context.num_worlds,
        device=device,
        seed=context.seed,
        control_dt=context.control_dt,
        episode_seconds=root.episode.seconds if episode_seconds is None else episode_seconds,
        known_fields=lambda name: providers_of(name, registry),
    )
    context = replace(
        context,
        action_size=environment.action_size,
        observation_shapes=environment.observation_shapes,
    )
    assert context.scene is not None
    return Built(environment, context, context.scene)


def build_term(choice: TermChoice, context: Context) -> Term:
    """The term's function with its options bound; a class is built first and then called."""
    function: Any = choice.component.factory
    options = choice.options
    if isinstance(choice.component.factory, type):
        schema = getattr(function, "Options", None)
        function, options = function(schema(**options) if schema else None, context), {}
    return Term(choice.name, function, options, choice.weight, choice.outcome)


def providers_of(field: str, registry: Registry) -> list[str]:
    """The registered components that say they provide the state field `field`."""
    found = []
    for (kind, name), component in registry.components.items():
        if kind in ("fields", "initial_states", "simulator"):
            attribute = {
                "fields": "provides",
                "initial_states": "episode_fields",
                "simulator": "fields",
            }
            with contextlib.suppress(PluginError):  # one that cannot be used here is no advice
                if field in (getattr(component.factory, attribute[kind], None) or {}):
                    found.append(f"{kind} '{name}'")
    return found


def build_policy(experiment: Experiment, context: Context) -> Policy:
    """The policy, its weights drawn from the seed alone."""
    if experiment.policy is None:
        raise ConfigError("policy is not set. Choose one (policy=…).")
    with private_rng(context.seed, "policy"):
        return experiment.policy.build(context).to(context.device)


def build_learner(experiment: Experiment, context: Context, policy: Policy) -> Learner:
    if experiment.learner is None:
        raise ConfigError("learner is not set. Choose one (learner=…).")
    choice = experiment.learner
    return choice.component.factory(choice.options, context, policy)
