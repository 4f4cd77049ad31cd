"""Building what a validated experiment describes: sections, scene, simulator, then the rest."""

from __future__ import annotations

import contextlib
import copy
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch

from understudy.errors import ConfigError, PluginError
from understudy.running.environment import Environment
from understudy.running.promises import Parts
from understudy.setup.config import Chosen, Experiment
from understudy.setup.registry import Registry
from understudy.task import Context, Scene
from understudy.task.terms import Term, Wired, make_term, renamed

__all__ = ["Built", "build_environment", "build_scene", "build_sections", "device_of"]


@dataclass
class Built:
    """What was built of an experiment."""

    environment: Environment
    context: Context
    scene: Scene


def device_of(name: str) -> torch.device:
    """The torch device `name`; or a ConfigError that says why it cannot be used."""
    if not re.fullmatch(r"cpu(:0)?|cuda(:[0-9]+)?", name):
        raise ConfigError(f"device={name} is no device. Use cpu, cuda, or cuda:1.")
    device = torch.device(name)
    if device.type == "cuda":
        count = torch.cuda.device_count() if torch.cuda.is_available() else 0
        if (device.index or 0) >= count:
            sees = f"{count} of those" if count else "no CUDA GPU"
            raise ConfigError(f"device={name}, but torch sees {sees} here. Use device=cpu.")
        if device.index is None:
            device = torch.device("cuda", torch.cuda.current_device())
    return device


def build_sections(experiment: Experiment) -> dict[str, Any]:
    """By name, the object built from each config section."""
    registry, built = experiment.registry, copy.copy(experiment.sections)  # a dict, or alike
    for name, options in experiment.sections.items():
        build = registry.sections[name].build
        built[name] = build.make(object, options, registry, experiment.inputs)
    return built


def _context(
    experiment: Experiment, device: torch.device, sections: Mapping[str, Any] | None
) -> Context:
    """The context of `experiment` for one world; `sections` are built unless they are given."""
    root = experiment.root
    return Context(
        seed=root.seed,
        device=device,
        num_worlds=1,
        control_dt=1.0 / root.control.frequency,
        substeps=root.control.substeps,
        decision=root.control.decision,
        own_substeps=root.control.substeps,
        registry=experiment.registry,
        sections=build_sections(experiment) if sections is None else sections,
        chosen=experiment.choices,
        inputs=experiment.inputs,
    )


def build_scene(experiment: Experiment, sections: Mapping[str, Any] | None = None) -> Context:
    """A context of one world on the CPU with the scene of `experiment`, to be shown or measured,
    and no simulator; `sections` are those that the scene needs, if not all."""
    context = _context(experiment, torch.device("cpu"), sections)
    context.scene = experiment.need("scene").build(context)
    return context


def build_environment(
    experiment: Experiment,
    *,
    num_worlds: int | None = None,
    episode_seconds: float | None = None,
    scene: Scene | None = None,
    sections: dict[str, Any] | None = None,
    evaluating: bool = False,
    substeps: int | None = None,
) -> Built:
    """Build the environment of `experiment`; keyword arguments replace its own values.

    When `evaluating`, the curriculum is at the target difficulty, and failure terms that
    ``evaluation.failures`` does not name only report.
    """
    root = experiment.root
    context = _context(experiment, device_of(root.device), sections)
    context.num_worlds = root.num_worlds if num_worlds is None else num_worlds
    context.substeps = context.substeps if substeps is None else substeps
    context.difficulty, context.evaluating = root.difficulty, evaluating
    context.scene = scene or experiment.need("scene").build(context)
    simulator = context.simulator = experiment.need("simulator").build(context)

    def wired(chosen: Chosen) -> Wired[Any]:
        part = chosen.build(context)
        given = getattr(part, "keeps" if chosen.component.kind != "fields" else "provides", {})
        return Wired(
            chosen.where,
            part,
            renamed(chosen.where, "reads", part.reads, chosen.extras["reads"]),
            renamed(chosen.where, "provides", tuple(given), chosen.extras.get("provides", {})),
        )

    def terms(slot: str) -> list[Term]:
        return [build_term(chosen, context) for chosen in experiment.many(slot)]

    for slot, what in (("reward.terms", "reward term"), ("encoder", "encoder")):
        if not experiment.many(slot):
            raise ConfigError(f"{slot} is empty: a task needs at least one {what}.")
    terminations = terms("termination.terms")
    if evaluating:
        reported = {t.name for t in terminations if t.outcome == "failure"} - {*experiment.failures}
        terminations = [
            replace(t, outcome="report") if t.name in reported else t for t in terminations
        ]
    curriculum = experiment.one("curriculum")
    parts = Parts(
        simulator=simulator,
        actuation=wired(experiment.need("actuation")),
        initial_states=experiment.need("initial_states").build(context),
        encoders={c.name: wired(c) for c in experiment.many("encoder")},
        rewards=terms("reward.terms"),
        terminations=terminations,
        measures=terms("measure"),
        fields=[wired(c) for c in experiment.many("fields")],
        memories={c.name: wired(c) for c in experiment.many("memory")},
        curriculum=curriculum.build(context) if curriculum else None,
        combine=root.reward.combine,
    )
    environment = Environment(
        parts,
        context,
        episode_seconds=root.episode.seconds if episode_seconds is None else episode_seconds,
        known_fields=lambda name: list(providers_of(name, experiment.registry)),
    )
    context.action_space = parts.actuation.part.action_space
    context.observation_shapes = environment.observation_shapes
    context.parts = parts
    assert context.scene is not None
    return Built(environment, context, context.scene)


def build_term(chosen: Chosen, context: Context) -> Term:
    """The term: a function with its options, or an instance of a class, which is called alike."""
    function, options = chosen.component.factory, chosen.options
    if isinstance(function, type):
        function, options = chosen.build(context), None
        if not callable(function):
            raise chosen.component.fault("makes what cannot be called, and a term is")
    return make_term(chosen.where, chosen.name, function, options or {}, **chosen.extras)


#: By kind: the attribute in which its components' classes declare the fields that they provide.
_GIVES = {
    "fields": "provides", "curriculum": "provides", "memory": "keeps", "actuation": "keeps",
    "initial_states": "episode_fields", "simulator": "fields",
}  # fmt: skip


def providers_of(field: str, registry: Registry) -> Iterator[str]:
    """The registered components that declare that they provide the state field `field`."""
    for (kind, name), component in registry.components.items():
        if kind in _GIVES:
            with contextlib.suppress(PluginError, TypeError):  # what cannot be used is no advice
                if field in (getattr(component.factory, _GIVES[kind], None) or {}):
                    yield f"{kind} '{name}'"
