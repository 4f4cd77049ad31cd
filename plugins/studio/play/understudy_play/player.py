"""A trained policy acting in one world, which can be pushed."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import mujoco
import numpy as np
import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.setup.building import build_environment
from understudy.setup.config import Experiment
from understudy.task import Shape
from understudy_mujoco.scene import MujocoScene
from understudy_reinforcement.policy import build_policy
from understudy_skills.skill import Skill

__all__ = ["Leads", "World"]

#: Seconds: no episode is cut.
_ENDLESS = 86400.0
#: m: so far from its character the reference stays where it is; pushed farther, it goes along.
_LEASH = 0.08
#: Of the height at which its root began: lower, a character is down.
_DOWN = 0.35


@runtime_checkable
class Leads(Protocol):
    """A memory by which the visitor leads a body of the scene to a place; from then on, an episode continues where it would
    have ended in success."""

    target: tuple[float, float] | None  #: m: where it should go; None before anybody leads
    refused: str  #: why it cannot, in a sentence; empty where it can
    keeps: Mapping[str, Shape]  #: a memory's

    @property
    def body(self) -> str:
        """Its name, of a body with a free joint of that name."""
        ...

    def send(self, x: float, y: float) -> None:
        """Bring it there next, m."""
        ...

    def way(self, kept: Mapping[str, Tensor]) -> np.ndarray:
        """(T, 3) m: as it is planned."""
        ...


class World(ABC):
    """One world of a task, judged as evaluations are: what they only report ends nothing."""

    def __init__(self, name: str, experiment: Experiment, seed: int = 0) -> None:
        self.name = name  #: for people
        built = build_environment(
            experiment, num_worlds=1, episode_seconds=_ENDLESS, evaluating=True
        )
        self.context = built.context
        self.environment, self.scene = built.environment, built.scene
        self.dt = self.environment.control_dt  #: s, between what :meth:`step` shows
        self.falls = 0
        #: m, in the world: where the visitor wants the character, and a click on the floor sends it; None
        #: where nothing can be sent anywhere.
        self.target: tuple[float, float] | None = None
        self._seed = seed
        memories = (wired.part for wired in self.environment.parts.memories.values())
        #: By what its body is led; None where nothing is.
        self.leads: Leads | None = next((m for m in memories if isinstance(m, Leads)), None)
        self._tracks = [n for n in self.scene.recorded if n in self.environment.table.shapes]
        self._mass, self._alone = 0.0, False
        if isinstance(self.scene, MujocoScene):
            model = self.scene.spec().compile()
            if model.njnt and model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE:  # not a hand's arm
                self._mass, self._alone = float(model.body_mass.sum()), _alone(model)
        self.restart()

    @property
    def fallen(self) -> str:
        """How often, in words; and whether it is down now. What has no character with a free root fails instead."""
        if not self._mass:
            return f"{self.falls or 'no'} failure{'s' if self.falls > 1 else ''}"
        if self.falls:
            return f"{self.falls} fall{'s' if self.falls > 1 else ''}"
        if (height := self._root_height()) < _DOWN * self._height:
            return f"down: its root is at {height:.2f} m, and was at {self._height:.2f} m; its task ends no fall"
        return "no fall"

    def _root_height(self) -> float:
        """m; 0 where there is no character with a free root."""
        has = self._mass > 0 and "qpos" in self._tracks
        return float(self.environment.table["qpos"][0, 2]) if has else 0.0

    def restart(self) -> None:
        """Begin a new episode."""
        self._observations = self.environment.reset(self._seed, f"play/{self._seed}")
        self._seed += 1
        self._moved = torch.zeros(2)
        self._height = self._root_height()

    @abstractmethod
    def act(self, observations: Mapping[str, Tensor]) -> Tensor:
        """The action (1, A)."""

    @torch.no_grad()
    def step(self) -> list[dict[str, Tensor]]:
        """One decision, and what is :meth:`shown` after each of its control periods; after a fall the
        next episode begins."""
        self._take_reference_along()
        environment, seen = self.environment, []
        if environment.decision > 1:
            environment.on_period = lambda: seen.append(self.shown())
        action = self.act(self._observations)
        if self.leads is None or self.leads.target is None:
            step = environment.step(action)
        else:
            step = environment.advance(action)
            if bool(step.failed.any()):
                step.observations = environment.begin(step.failed)
        self.falls += int(step.failed.sum())
        if bool(step.ended.any()):
            self._moved.zero_()
        self._observations = step.observations
        return [*seen[1:], self.shown()]

    def _take_reference_along(self) -> None:
        """A policy that follows a clip through space knows no way back from where pushes take it. Where
        there is nothing but floor, which is the same everywhere, the character is moved back under its
        clip, and what is shown is both of them where it really is."""
        if not self._alone or not {"qpos", "reference_qpos"} <= set(self._tracks):
            return
        table = self.environment.table
        away = (table["qpos"] - table["reference_qpos"])[0, :2]
        beyond = away * (1.0 - _LEASH / away.norm().clamp(min=_LEASH))
        if bool((beyond != 0.0).any()):
            state = self._state()
            state["qpos"][:, :2] -= beyond
            self._set(state)
            self._moved += beyond

    def shown(self) -> dict[str, Tensor]:
        """The fields of the world that its scene draws, each (…)."""
        fields = {name: self.environment.table[name][0].clone() for name in self._tracks}
        for name in ("qpos", "reference_qpos"):
            if name in fields:
                fields[name][:2] += self._moved
        return fields

    def push(self, impulse: tuple[float, float, float]) -> None:
        """Change the velocity of all of the character by `impulse` over its mass, N s, world frame.

        Raises
        ------
        ConfigError
            if the task has no character with a free root.
        """
        simulator = self.environment.parts.simulator
        if not self._mass or not {"qpos", "qvel"} <= simulator.fields.keys():
            raise ConfigError(f"{self.name} has no character that can be pushed.")
        state = self._state()
        state["qvel"][:, :3] += torch.tensor(impulse) / self._mass
        self._set(state)

    def nudge(self, x: float, y: float) -> None:
        """Change the velocity of the body that is led by so much, m/s."""
        assert self.leads is not None
        assert isinstance(self.scene, MujocoScene)
        at, state = int(self.scene.model.joint(self.leads.body).dofadr[0]), self._state()
        state["qvel"][:, at : at + 2] += torch.tensor([x, y])
        self._set(state)

    def way(self) -> np.ndarray:
        """(T, 3) m: where the body that is led is planned to be."""
        assert self.leads is not None
        return self.leads.way({name: self.environment.table[name] for name in self.leads.keeps})

    def _state(self) -> dict[str, Tensor]:
        """Of an episode that goes on: with what its servos were last told."""
        simulator = self.environment.parts.simulator
        told = {"ctrl"} & simulator.fields.keys()
        return {name: simulator.read(name).clone() for name in (*simulator.state_fields, *told)}

    def _set(self, state: dict[str, Tensor]) -> None:
        self.environment.parts.simulator.set_state(torch.ones(1, dtype=torch.bool), state)
        self.environment.refresh()

    def close(self) -> None:
        self.environment.close()


def _alone(model: mujoco.MjModel) -> bool:
    """Whether the first joint's character has nothing but planes around it."""
    if not model.njnt:
        return False
    roots = model.body_rootid[model.geom_bodyid]
    others = model.geom_type[roots != model.body_rootid[model.jnt_bodyid[0]]]
    return bool((others == mujoco.mjtGeom.mjGEOM_PLANE).all())


class Player(World):
    """The policy of `skill` in one world of its task."""

    def __init__(self, skill: Skill, seed: int = 0) -> None:
        super().__init__(skill.name, skill.experiment, seed)
        self.policy = build_policy(skill.experiment, self.context)
        self.take(skill)

    def take(self, skill: Skill) -> None:
        """Go on with the policy of `skill`, one of the same task.

        Raises
        ------
        RunError
            if it does not fit; what acted goes on acting.
        """
        skill.give(self.policy)
        self.skill = skill

    def act(self, observations: Mapping[str, Tensor]) -> Tensor:
        return self.policy.distribution(observations).mode()
