"""A trained policy acting in one world, which can be pushed."""

from __future__ import annotations

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.setup.building import build_environment, build_policy
from understudy_mujoco.scene import MujocoScene
from understudy_play.skill import Skill

#: Seconds: no episode is cut.
_ENDLESS = 86400.0


class Player:
    """One world of the task of `skill`, judged as evaluations are: what they only report ends nothing."""

    def __init__(self, skill: Skill, seed: int = 0) -> None:
        self.skill = skill
        built = build_environment(
            skill.experiment, num_worlds=1, episode_seconds=_ENDLESS, evaluating=True
        )
        self.environment, self.scene = built.environment, built.scene
        self.dt = self.environment.decision * self.environment.control_dt  #: s, of a step
        self.policy = build_policy(skill.experiment, built.context)
        skill.give(self.policy)
        self.falls = 0
        self._seed = seed
        self._tracks = [n for n in self.scene.recorded if n in self.environment.table.shapes]
        self._mass = 0.0
        if isinstance(self.scene, MujocoScene):
            self._mass = float(self.scene.spec().compile().body_mass.sum())
        self.restart()

    def restart(self) -> None:
        """Begin a new episode."""
        self._observations = self.environment.reset(self._seed, f"play/{self._seed}")
        self._seed += 1

    @torch.no_grad()
    def step(self) -> None:
        """One decision; after a fall the next episode begins."""
        action = self.policy.distribution(self._observations).mode()
        step = self.environment.step(action)
        self.falls += int(step.failed.sum())
        self._observations = step.observations

    def shown(self) -> dict[str, Tensor]:
        """The fields of the world that its scene draws, each (…)."""
        return {name: self.environment.table[name][0].clone() for name in self._tracks}

    def push(self, impulse: tuple[float, float, float]) -> None:
        """Change the velocity of all of the character by `impulse` over its mass, N s, world frame.

        Raises
        ------
        ConfigError
            if the task has no character with a free root.
        """
        simulator = self.environment.parts.simulator
        if not self._mass or not {"qpos", "qvel"} <= simulator.fields.keys():
            raise ConfigError(f"{self.skill.name} has no character that can be pushed.")
        state = {name: simulator.read(name).clone() for name in simulator.state_fields}
        state["qvel"][:, :3] += torch.tensor(impulse) / self._mass
        simulator.set_state(torch.ones(1, dtype=torch.bool), state)
        self.environment.refresh()

    def close(self) -> None:
        self.environment.close()
