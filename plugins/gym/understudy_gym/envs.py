"""Any task as a Gymnasium vector environment::

    import understudy_gym.envs  # registers the tasks
    envs = gymnasium.make_vec("spacetime/walk", num_envs=64)

For users of other learners. Observations are a dict of float32 arrays; ended worlds reset in the
same step (Gymnasium's ``AutoresetMode.SAME_STEP``), with the last observation of a truncated
episode under ``info["final_obs"]``.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import installed


def register_envs() -> None:
    """Register every task under its own name; importing this module does it."""
    for name in installed().registry.tasks:
        gymnasium.register(
            id=name,
            vector_entry_point="understudy_gym.envs:UnderstudyVectorEnv",
            kwargs={"task": name},
        )


class UnderstudyVectorEnv(VectorEnv):
    """N worlds of the task `task`; `overrides` are Hydra's, as on the command line."""

    def __init__(
        self, task: str, num_envs: int = 1, overrides: tuple[str, ...] = (), **_: Any
    ) -> None:
        experiment = load_experiment([f"task={task}", *overrides, f"num_worlds={num_envs}"])
        self._environment = build_environment(experiment).environment
        self._seed = experiment.root.seed
        self.num_envs = num_envs
        self.metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}
        self.single_observation_space = gymnasium.spaces.Dict(
            {
                name: gymnasium.spaces.Box(-np.inf, np.inf, shape, np.float32)
                for name, shape in self._environment.observation_shapes.items()
            }
        )
        self.single_action_space = gymnasium.spaces.Box(
            -np.inf, np.inf, (self._environment.action_size,), np.float32
        )
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):  # pyright: ignore[reportIncompatibleMethodOverride]
        """A seed makes what follows repeat exactly."""
        return _arrays(self._environment.reset(seed)), {}

    def step(self, actions: np.ndarray):  # pyright: ignore[reportIncompatibleMethodOverride]
        step = self._environment.step(
            torch.as_tensor(np.asarray(actions, dtype=np.float32)).to(self._environment.device)
        )
        info: dict[str, Any] = {}
        if step.final_observations is not None:
            ended = step.ended.cpu().numpy()
            info = {"final_obs": _arrays(step.final_observations), "_final_obs": ended}
        return (
            _arrays(step.observations),
            step.rewards.cpu().numpy(),
            step.terminated.cpu().numpy(),
            step.truncated.cpu().numpy(),
            info,
        )

    def close_extras(self, **kwargs: Any) -> None:
        self._environment.close()


def _arrays(observations: dict[str, Any]) -> dict[str, np.ndarray]:
    return {name: value.cpu().numpy() for name, value in observations.items()}


register_envs()
