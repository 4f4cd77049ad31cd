"""Any task for Stable-Baselines3, many worlds stepped together::

from understudy_gym.stable_baselines3 import UnderstudyVecEnv
model = PPO("MlpPolicy", VecMonitor(UnderstudyVecEnv("spacetime/walk", 64)))
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import gymnasium
import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from understudy_gym.worlds import Worlds, check_reset, columns, flattened

__all__ = ["UnderstudyVecEnv"]


class UnderstudyVecEnv(VecEnv):
    """`num_envs` worlds of the task `task`, with flat observations.

    An ended world begins its next episode in the same step. Its ``info`` has the last observation as
    ``terminal_observation``, and ``TimeLimit.truncated`` says whether the episode was only cut, so that
    Stable-Baselines3 adds the value of that observation.

    Parameters
    ----------
    task, overrides, settings
        as :class:`~understudy_gym.worlds.Worlds` has them, with its errors.
    """

    def __init__(
        self, task: str, num_envs: int = 1, overrides: Sequence[str] = (), **settings: Any
    ) -> None:
        self.worlds = Worlds(task, num_envs, overrides, **settings)
        space = self.worlds.action_space()
        super().__init__(num_envs, self.worlds.observation_space(flat=True), space)

    def reset(self) -> np.ndarray:
        """The first observations, (N, D); after :meth:`seed`, those that the seed stands for."""
        seed = self._seeds[0]
        for options in self._options:
            check_reset(seed, options)
        self._reset_seeds()
        self._reset_options()
        return _array(flattened(self.worlds.reset(seed)))

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = columns(self.worlds.space, actions, self.num_envs, self.worlds.device)

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        step = self.worlds.step(self._actions)
        ended, truncated = _array(step.ended), _array(step.truncated)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if step.final_observations is not None and ended.any():
            final = _array(flattened(step.final_observations))
            for world in ended.nonzero()[0]:
                infos[world] = {
                    "TimeLimit.truncated": bool(truncated[world]),
                    "terminal_observation": final[world],
                }
        return _array(flattened(step.observations)), _array(step.rewards), ended, infos

    def close(self) -> None:
        self.worlds.environment.close()

    def get_images(self) -> Sequence[np.ndarray | None]:
        return self.worlds.pictures() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        value = getattr(self.worlds if attr_name == "render_mode" else self, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Of all worlds, which are one object: `indices` must be all of them."""
        self._all(indices, f"set_attr('{attr_name}')")
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call this object's method once, for all worlds."""
        self._all(indices, f"env_method('{method_name}')")
        return [getattr(self, method_name)(*method_args, **method_kwargs)] * self.num_envs

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper], indices: Any = None
    ) -> list[bool]:
        return [False for _ in self._get_indices(indices)]

    def _all(self, indices: int | Iterable[int] | None, what: str) -> None:
        if sorted(self._get_indices(indices)) != list(range(self.num_envs)):
            raise ValueError(f"{what}: the worlds are one object. Leave indices out.")


def _array(value: Any) -> np.ndarray:
    """A copy, which nothing overwrites."""
    return np.array(value.cpu().numpy())
