"""Any task as a Gymnasium environment, one world or many::

    import understudy_gym.envs  # registers the tasks
    env = gymnasium.make("spacetime/walk")
    envs = gymnasium.make_vec("spacetime/walk", num_envs=64)

Without the import, ``gymnasium.make("understudy_gym.envs:spacetime/walk")``. Observations are float32,
by name, or with ``flat=True`` in one row. Actions are in [-1, 1], or with ``actions="raw"`` the task's.

``info["rewards"]`` has by term what each gave (added to the reward, or multiplied it with), and
``info["ended_by"]``, where an episode ended, the names of the terminations that ended it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, iterate
from torch import Tensor

from understudy.errors import ConfigError
from understudy.running.soundness import rows
from understudy.running.step import Step
from understudy.setup.plugins import installed
from understudy_gym.worlds import RENDER_MODES, Worlds, check_reset, columns, flattened, undisturbed


def register_envs() -> None:
    """Register every task under its own name; importing this module does it."""
    for name in installed().registry.tasks:
        gymnasium.register(
            id=name,
            entry_point="understudy_gym.envs:UnderstudyEnv",
            vector_entry_point="understudy_gym.envs:UnderstudyVectorEnv",
            kwargs={"task": name},
        )


class UnderstudyEnv(gymnasium.Env):
    """One world of the task `task`.

    Parameters
    ----------
    task, overrides, settings
        as :class:`~understudy_gym.worlds.Worlds` has them, with its errors.
    flat
        observations side by side in one row, in the order of the configuration.
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": 30}

    def __init__(
        self,
        task: str,
        overrides: Sequence[str] = (),
        *,
        flat: bool = False,
        **settings: Any,
    ) -> None:
        self.worlds = Worlds(task, 1, overrides, **settings)
        self.render_mode = self.worlds.render_mode
        self.metadata = _metadata(self.worlds)
        self._flat = _is_flat(flat)
        self.observation_space = self.worlds.observation_space(flat)
        self.action_space = self.worlds.action_space()
        self._seeded = False

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """A seed makes what follows repeat exactly; without one, ever, here or in the overrides, the episodes
        are other ones in every process."""
        check_reset(seed, options)
        super().reset(seed=seed)
        if seed is None and not self._seeded:
            seed = _first_seed(self)
        self._seeded = True
        return self._observed(self.worlds.reset(seed)), {}

    def step(self, action: Any):
        _check_begun(self._seeded)
        one = isinstance(action, Mapping)
        batch = {k: _row(v) for k, v in action.items()} if one else _row(action)
        step = self.worlds.advance(columns(self.worlds.space, batch, 1, self.worlds.device))
        rewards, ended = self.worlds.account(step)
        info: dict[str, Any] = {"rewards": {n: float(value[0]) for n, value in rewards.items()}}
        if ended[0]:
            info["ended_by"] = ended[0]
        return (
            self._observed(step.observations),
            float(step.rewards[0]),
            bool(step.terminated[0]),
            bool(step.truncated[0]),
            info,
        )

    def __repr__(self) -> str:
        return f"<{self.worlds!r}>"

    def render(self) -> Any:
        """(height, width, 3) uint8, or None without a render mode."""
        _check_begun(self._seeded or self.render_mode is None)
        pictures = self.worlds.pictures()
        return pictures[0] if pictures else None

    def close(self) -> None:
        self.worlds.environment.close()

    def _observed(self, observations: Mapping[str, Tensor]) -> Any:
        arrays = _arrays(observations, self._flat)
        return arrays[0] if self._flat else {name: value[0] for name, value in arrays.items()}


class UnderstudyVectorEnv(VectorEnv):
    """`num_envs` worlds of the task `task`, stepped together.

    Parameters
    ----------
    task, overrides, settings, flat
        as :class:`UnderstudyEnv` has them.
    autoreset_mode
        when an ended world begins its next episode, Gymnasium's. ``NEXT_STEP``, its
        default: in the step after, whose action it ignores and whose reward is 0. ``SAME_STEP``:
        at once, with the last observation under ``info["final_obs"]``, an array of one object a
        world; the fastest on a GPU, where only this step is captured and replayed.
        ``DISABLED``: when ``reset(options={"reset_mask": mask})`` says so.

    Raises
    ------
    ConfigError
        for another ``autoreset_mode``, and for ``max_episode_steps`` of ``make_vec``.
    """

    @undisturbed
    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        overrides: Sequence[str] = (),
        *,
        flat: bool = False,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **settings: Any,
    ) -> None:
        self._mode = _mode(autoreset_mode)
        if "max_episode_steps" in settings:
            raise ConfigError(
                "max_episode_steps is not possible for worlds that are stepped together. Say how long an episode is: "
                "overrides=['episode.seconds=5']."
            )
        self.worlds = Worlds(task, num_envs, overrides, **settings)
        self.render_mode = self.worlds.render_mode
        self.num_envs, self._flat = self.worlds.num_worlds, _is_flat(flat)
        self.metadata = {**_metadata(self.worlds), "autoreset_mode": self._mode}
        self.single_observation_space = self.worlds.observation_space(flat)
        self.single_action_space = self.worlds.action_space()
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._ended = torch.zeros(self.num_envs, dtype=torch.bool, device=self.worlds.device)
        self._seeded = False

    @undisturbed
    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """Begin new episodes everywhere, or where ``options["reset_mask"]`` (N,) bool is true.

        A seed makes what follows repeat exactly; without one, ever, here or in the overrides, the episodes are
        other ones in every process.

        Raises
        ------
        ValueError
            for a mask of the wrong shape or type, one before any whole reset, or one with
            a seed, since a seed begins the random numbers of all worlds anew.
        """
        check_reset(seed, options, ("reset_mask",))
        super().reset(seed=seed)
        mask = (options or {}).get("reset_mask")
        if mask is not None:
            return self._begin(_mask(mask), seed), {}
        if seed is None and not self._seeded:
            seed = _first_seed(self)
        self._seeded = True
        self._ended.zero_()
        return _arrays(self.worlds.reset(seed), self._flat), {}

    def _begin(self, mask: np.ndarray, seed: int | None) -> Any:
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(
                f"reset_mask must be bool of shape ({self.num_envs},), true somewhere; it is "
                f"{mask.dtype} of shape {mask.shape}, true {np.count_nonzero(mask)} times."
            )
        if seed is not None or not self._seeded:
            raise ValueError(
                "A reset_mask goes without a seed, after a reset of all worlds. Call reset(seed=…) "
                "first."
            )
        worlds = torch.as_tensor(mask, device=self.worlds.device)
        self._ended &= ~worlds
        return _arrays(self.worlds.environment.begin(worlds), self._flat)

    @undisturbed
    def step(self, actions: Any):
        _check_begun(self._seeded)
        batch = columns(self.worlds.space, actions, self.num_envs, self.worlds.device)
        if self._mode is AutoresetMode.SAME_STEP:
            step = self.worlds.step(batch)
            info = self._account(step)
            if step.final_observations is not None and bool(step.ended.any()):
                info |= self._final(step.final_observations, step.ended.cpu().numpy())
            return *self._given(step.observations, step), info
        resting = self._ended
        if self._mode is AutoresetMode.DISABLED and bool(resting.any()):
            numbers = ", ".join(map(str, resting.nonzero().flatten().tolist()))
            raise gymnasium.error.ResetNeeded(
                f"The worlds {numbers} have ended. Reset them with options={{'reset_mask': mask}}."
            )
        step = self.worlds.advance(batch)
        info = self._account(step, ~resting)
        observations = step.observations
        if bool(resting.any()):  # they were stepped beside the others, to no effect
            observations = {
                name: torch.where(rows(resting, value), value, observations[name])
                for name, value in self.worlds.environment.begin(resting).items()
            }
            step.rewards = torch.where(resting, 0.0, step.rewards)
            step.terminated, step.truncated = step.terminated & ~resting, step.truncated & ~resting
        self._ended = step.ended
        return *self._given(observations, step), info

    def _account(self, step: Step, judged: Tensor | None = None) -> dict[str, Any]:
        """As Gymnasium's own vector environments give it: arrays, and which worlds have the value."""
        rewards, ended = self.worlds.account(step)
        has = np.ones(self.num_envs, bool) if judged is None else judged.cpu().numpy()
        given = {
            name: np.where(has, value, 0.0).astype(np.float32) for name, value in rewards.items()
        }
        info: dict[str, Any] = {"rewards": given | {f"_{n}": has for n in given}, "_rewards": has}
        over = has & np.array([bool(names) for names in ended])
        if over.any():
            info["ended_by"] = np.full(self.num_envs, None, dtype=object)
            for world in over.nonzero()[0]:
                info["ended_by"][world] = ended[world]
            info["_ended_by"] = over
        return info

    def _given(self, observations: Mapping[str, Tensor], step: Any) -> tuple[Any, ...]:
        return (
            _arrays(observations, self._flat),
            _array(step.rewards),
            _array(step.terminated),
            _array(step.truncated),
        )

    def _final(self, observations: Mapping[str, Tensor], ended: np.ndarray) -> dict[str, Any]:
        """As Gymnasium's own vector environments give them: an object for each world, or None."""
        arrays = _arrays(observations, self._flat)
        final = np.full(self.num_envs, None, dtype=object)
        for world, value in enumerate(iterate(self.observation_space, arrays)):
            if ended[world]:
                final[world] = value
        return {"final_obs": final, "_final_obs": ended}

    def __repr__(self) -> str:
        return f"<{self.worlds!r}; autoreset {self._mode.value}>"

    def render(self) -> tuple[np.ndarray, ...] | None:
        """One picture a world, (height, width, 3) uint8, or None without a render mode."""
        _check_begun(self._seeded or self.render_mode is None)
        return self.worlds.pictures()

    def close_extras(self, **kwargs: Any) -> None:
        self.worlds.environment.close()


def _first_seed(env: UnderstudyEnv | UnderstudyVectorEnv) -> int:
    """Where episodes begin as long as no reset was given a seed."""
    chosen = env.worlds.seed
    return int(env.np_random.integers(2**31)) if chosen is None else chosen


def _is_flat(flat: Any) -> bool:
    if flat not in (True, False):
        raise ConfigError(f"flat={flat!r} is not possible: write True or False.")
    return bool(flat)


def _row(action: Any) -> Any:
    """A batch of one world; rows of several lengths, which no array has, are refused later."""
    if isinstance(action, Tensor):
        return action[None]
    return [action] if isinstance(action, list | tuple) else np.asarray(action)[None]


def _mask(mask: Any) -> np.ndarray:
    """As an array; rows of several lengths, which none has, are refused later, as None is."""
    try:
        return np.asarray(mask)
    except ValueError:
        return np.asarray(None)


def _check_begun(begun: bool) -> None:
    """Gymnasium's error where nothing has begun, as its wrappers raise it where there are some."""
    if not begun:
        raise gymnasium.error.ResetNeeded("The worlds have not begun. Call reset() first.")


def _mode(mode: AutoresetMode | str) -> AutoresetMode:
    """By its name or value, in any case."""
    if isinstance(mode, AutoresetMode):
        return mode
    for known in AutoresetMode:
        if str(mode).upper() in (known.name, known.value.upper()):
            return known
    names = ", ".join(known.name for known in AutoresetMode)
    raise ConfigError(f"autoreset_mode={mode!r} is not possible: there is {names}.")


def _metadata(worlds: Worlds) -> dict[str, Any]:
    return {"render_modes": list(RENDER_MODES), "render_fps": round(worlds.steps_per_second)}


def _array(value: Tensor) -> np.ndarray:
    """A copy, which nothing overwrites."""
    return np.array(value.cpu().numpy())


def _arrays(observations: Mapping[str, Tensor], flat: bool) -> Any:
    if flat:
        return _array(flattened(observations))
    return {name: _array(value) for name, value in observations.items()}


register_envs()
