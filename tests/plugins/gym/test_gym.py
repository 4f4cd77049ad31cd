"""Tasks as Gymnasium vector environments."""

from __future__ import annotations

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason="Gymnasium is not installed")
pytest.importorskip("understudy_gym.envs")  # registers the tasks


def test_a_task_by_its_name() -> None:
    environments = gymnasium.make_vec("spacetime/walk", num_envs=5)
    observations, _ = environments.reset(seed=3)
    assert environments.observation_space.contains(observations)
    assert environments.single_action_space.shape == (28,)
    seen_end = False
    for _ in range(25):
        actions = observations["feedforward"]
        observations, rewards, terminated, truncated, info = environments.step(actions)
        assert rewards.shape == terminated.shape == truncated.shape == (5,)
        assert np.isfinite(observations["state"]).all()
        if (terminated | truncated).any():
            seen_end = True
            assert (info["_final_obs"] == (terminated | truncated)).all()
    assert seen_end
    environments.close()


def test_the_same_seed_repeats() -> None:
    environments = gymnasium.make_vec("spacetime/walk", num_envs=3)
    first, _ = environments.reset(seed=8)
    first = {k: v.copy() for k, v in first.items()}
    environments.step(first["feedforward"])
    again, _ = environments.reset(seed=8)
    for name, value in first.items():
        np.testing.assert_array_equal(value, again[name])
    environments.close()
