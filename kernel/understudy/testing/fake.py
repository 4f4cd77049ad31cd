"""A task without physics: points on a line that a control pushes. Fast, exact, deterministic."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from understudy.random import WorldStreams
from understudy.setup.plugins import Plugins, hookimpl, load
from understudy.setup.registry import Registrar
from understudy.task import Actuation, Context, Encoder, InitialStates, Scene, Simulator, box


class FakeScene(Scene):
    """A point of one kilogram on a frictionless line."""

    def __init__(self, options: None = None, context: Context | None = None) -> None:
        pass

    def describe(self) -> dict[str, Any]:
        return {"mass_kg": 1.0}


class FakeSimulator(Simulator):
    """Semi-implicit Euler of a unit mass; ``qpos`` and ``qvel`` are (N, 1), control is a force."""

    fields = {"qpos": (1,), "qvel": (1,)}
    state_fields = ("qpos", "qvel")
    control_size = 1

    def __init__(self, options: None, context: Context) -> None:
        context.need_scene(FakeScene, "simulator 'fake'")
        self._dt, self._substeps = context.control_dt / context.substeps, context.substeps
        self._state = torch.zeros(context.num_worlds, 2, dtype=torch.float64, device=context.device)

    def read(self, name: str) -> Tensor:
        column = self.state_fields.index(name)
        return self._state[:, column : column + 1].float()

    def set_state(self, worlds: Tensor, state: Mapping[str, Tensor]) -> None:
        new = torch.cat([state["qpos"], state["qvel"]], dim=1).double()
        self._state = torch.where(worlds.unsqueeze(1), new, self._state)

    def step(self, control: Tensor, substeps: int | None = None) -> None:
        for _ in range(substeps or self._substeps):
            velocity = self._state[:, 1] + self._dt * control[:, 0].double()
            self._state = torch.stack([self._state[:, 0] + self._dt * velocity, velocity], dim=1)

    def failed(self) -> Tensor:
        return ~(self._state.abs() < 1e10).all(dim=1)

    def snapshot(self) -> dict[str, Tensor]:
        return {"state": self._state.clone()}

    def restore(self, snapshot: Mapping[str, Tensor], worlds: Tensor | None = None) -> None:
        keep = (
            torch.zeros(len(self._state), 1, dtype=torch.bool)
            if worlds is None
            else ~worlds[:, None]
        )
        self._state = torch.where(keep, self._state, snapshot["state"])


class PointEncoder(Encoder):
    """Position and velocity, (N, 2)."""

    reads = ("qpos", "qvel")
    shape = (2,)

    def __init__(self, options: None, context: Context) -> None:
        pass

    def encode(self, qpos: Tensor, qvel: Tensor) -> Tensor:
        return torch.cat([qpos, qvel], dim=1)


class Force(Actuation):
    """The action is the force."""

    action_space = box(1)

    def __init__(self, options: None, context: Context) -> None:
        pass

    def control(self, action: Tensor) -> Tensor:
        return action


class Somewhere(InitialStates):
    """At rest, within `spread` metres of the origin."""

    @dataclass(frozen=True)
    class Options:
        spread: float = 1.0

    def __init__(self, options: Options, context: Context) -> None:
        self._spread = options.spread

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        qpos = (streams.uniform(1) * 2 - 1) * self._spread
        return {"qpos": qpos, "qvel": torch.zeros_like(qpos)}


def near_origin(qpos: Tensor, *, scale: float = 1.0) -> Tensor:
    """exp(-|x| / scale)."""
    return torch.exp(-qpos.abs().squeeze(1) / scale)


def far_away(qpos: Tensor, *, limit: float = 3.0) -> Tensor:
    """Further than `limit` metres from the origin."""
    return qpos.abs().squeeze(1) > limit


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.component("scene", "fake", FakeScene)
    register.component("simulator", "fake", FakeSimulator)
    register.component("encoder", "fake.point", PointEncoder)
    register.component("actuation", "fake.force", Force)
    register.component("initial_states", "fake.somewhere", Somewhere)
    register.component("reward", "fake.near_origin", near_origin)
    register.component("termination", "fake.far_away", far_away)


#: Overrides that make a complete task of the fake parts.
FAKE_TASK = (
    "+scene={name: fake}",
    "+simulator={name: fake}",
    "+encoder.state={name: fake.point}",
    "+actuation={name: fake.force}",
    "+reward.terms.near={name: fake.near_origin}",
    "+termination.terms.far={name: fake.far_away}",
    "+initial_states={name: fake.somewhere}",
)


def fake_plugins() -> Plugins:
    """The installed plugins and this module's fake parts."""
    return load(extra=[("fake", sys.modules[__name__])])
