"""Any task for rsl_rl (``rsl-rl-lib``), on torch tensors::

from understudy_gym.rsl_rl import UnderstudyVecEnv
runner = OnPolicyRunner(UnderstudyVecEnv("spacetime/walk", 4096, ["device=cuda"]), config)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict
from torch import Tensor

from understudy.errors import ConfigError
from understudy.task import Box
from understudy_gym.worlds import Worlds

__all__ = ["UnderstudyVecEnv"]


class UnderstudyVecEnv(VecEnv):
    """`num_envs` worlds of the task `task`; groups of observations are the task's, by name.

    Nothing leaves the device. Actions, rewards and ends of episodes are the environment's own tensors;
    observations are written once, on the device, since rsl_rl keeps them until after the next step,
    which overwrites the environment's.

    An ended world begins its next episode in the same step. ``extras["time_outs"]`` (N,) bool are the
    worlds whose episode was only cut, to whose reward rsl_rl adds a value, that of the observation
    before: it has no place for the last one. It clips no actions by itself, nor does this.

    Parameters
    ----------
    task, overrides, settings
        as :class:`~understudy_gym.worlds.Worlds` has them.

    Raises
    ------
    ConfigError
        for a task, an override or a value that is not possible, and for tasks with
        choices among their actions, which rsl_rl does not learn.
    """

    def __init__(
        self, task: str, num_envs: int = 1, overrides: Sequence[str] = (), **settings: Any
    ) -> None:
        self.worlds = Worlds(task, num_envs, overrides, **settings)
        choices = [n for n, p in self.worlds.space.parts.items() if not isinstance(p, Box)]
        if choices:
            raise ConfigError(
                f"The action '{choices[0]}' of task {task} is a choice, and rsl_rl learns numbers "
                "only. Use Gymnasium's interface (understudy_gym.envs) with another learner."
            )
        self.num_envs, self.num_actions = num_envs, self.worlds.space.size
        self.device = str(self.worlds.device)
        self.max_episode_length = self.worlds.episode_steps
        self.cfg = {"task": task, "num_envs": num_envs, "overrides": list(overrides), **settings}
        self._observations = _kept(self.worlds.reset())

    @property
    def episode_length_buf(self) -> Tensor:
        """(N,) int64: steps of the episodes so far."""
        environment = self.worlds.environment
        return environment.episode_step // environment.decision

    @episode_length_buf.setter
    def episode_length_buf(self, value: Tensor) -> None:  # pyright: ignore[reportIncompatibleVariableOverride]
        raise ConfigError(
            "The ages of episodes cannot be set: the reference runs with them. Call learn(…) with "
            "init_at_random_ep_len=False; episodes begin at times drawn along the clip already."
        )

    def get_observations(self) -> TensorDict:
        return self._given()

    def reset(self) -> tuple[TensorDict, dict[str, Any]]:
        """Begin new episodes everywhere."""
        self._observations = _kept(self.worlds.reset())
        return self._given(), {}

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict[str, Any]]:
        # The runner is in inference mode: what is made in it could not be changed in place outside.
        with torch.inference_mode(False), torch.no_grad():
            step = self.worlds.step(actions)
            self._observations = _kept(step.observations)
        return self._given(), step.rewards, step.ended, {"time_outs": step.truncated}

    def close(self) -> None:
        self.worlds.environment.close()

    def _given(self) -> TensorDict:
        return TensorDict(self._observations, batch_size=[self.num_envs], device=self.device)


def _kept(observations: Mapping[str, Tensor]) -> dict[str, Any]:
    return {name: value.clone() for name, value in observations.items()}
