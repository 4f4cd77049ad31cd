"""Any task for skrl, on torch tensors::

from understudy_gym.skrl import UnderstudyWrapper, use_final_observations
env = UnderstudyWrapper("spacetime/walk", 4096, ["device=cuda"])
agent = use_final_observations(PPO(…))
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import gymnasium
import torch
from gymnasium import spaces
from skrl.agents.torch import Agent
from skrl.envs.wrappers.torch import Wrapper
from torch import Tensor

from understudy.errors import ConfigError
from understudy_gym.worlds import Worlds, flattened

__all__ = ["UnderstudyWrapper", "use_final_observations"]

A = TypeVar("A", bound=Agent)


class UnderstudyWrapper(Wrapper):
    """`num_envs` worlds of the task `task`, with flat observations.

    Nothing leaves the device. Actions, rewards and ends of episodes are the environment's own tensors;
    observations are written once, into the row that skrl wants.

    An ended world begins its next episode in the same step. ``infos["final_observations"]`` (N, D) are
    the observations reached, before that: pass the agent through :func:`use_final_observations`.

    Parameters
    ----------
    task, overrides, settings
        as :class:`~understudy_gym.worlds.Worlds` has them.

    Raises
    ------
    ConfigError
        for a task, an override or a value that is not possible, and for tasks whose
        actions are numbers and choices at once, which skrl does not learn.
    """

    _env = _unwrapped = (
        None  # where skrl looks for what it lacks, also before it is initialised, as a copy is
    )

    def __init__(
        self, task: str, num_envs: int = 1, overrides: Sequence[str] = (), **settings: Any
    ) -> None:
        self.worlds = Worlds(task, num_envs, overrides, **settings)
        self._action_space = self.worlds.action_space()
        if isinstance(self._action_space, spaces.Dict):
            raise ConfigError(
                f"Actions of task {task} are numbers and choices at once, which skrl does not learn. "
                "Use Gymnasium's interface (understudy_gym.envs) with another learner."
            )
        self._observation_space = self.worlds.observation_space(flat=True)
        self._observations: Tensor | None = None
        super().__init__(self.worlds)

    @property
    def num_envs(self) -> int:
        return self.worlds.num_worlds

    @property
    def state_space(self) -> gymnasium.Space | None:
        return None

    @property
    def observation_space(self) -> gymnasium.Space:
        return self._observation_space

    @property
    def action_space(self) -> gymnasium.Space:
        return self._action_space

    def reset(self) -> tuple[Tensor, dict[str, Any]]:
        """Begin new episodes everywhere the first time; later, where the worlds are: those that ended
        have begun anew already."""
        if self._observations is None:
            self._observations = flattened(self.worlds.reset())
        return self._observations, {}

    @torch.no_grad()
    def step(self, actions: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any]]:
        step = self.worlds.step(actions)
        self._observations = reached = flattened(step.observations)
        if step.final_observations is not None:
            reached = torch.where(
                step.ended.unsqueeze(1), flattened(step.final_observations), reached
            )
        return (
            self._observations,
            step.rewards.unsqueeze(1),
            step.terminated.unsqueeze(1),
            step.truncated.unsqueeze(1),
            {"final_observations": reached},
        )

    def state(self) -> None:
        return None

    def render(self, *args: Any, **kwargs: Any) -> Any:
        """(height, width, 3) uint8: the first world."""
        return self.worlds.draw(0)

    def close(self) -> None:
        self.worlds.environment.close()


def use_final_observations(agent: A) -> A:
    """Have `agent` take the observation that an episode ended with, not the next one's first, for the
    one that follows a step; returns `agent`.

    With it, ``time_limit_bootstrap`` adds the value of where a cut episode was, and learners from
    replayed transitions see where they led.
    """
    record = agent.record_transition

    def recorded(*, next_observations: Tensor, infos: Any, **rest: Any) -> None:
        reached = infos.get("final_observations", next_observations)
        record(next_observations=reached, infos=infos, **rest)

    agent.record_transition = recorded  # type: ignore[method-assign]
    return agent
