"""What Gymnasium's ``info`` says: what each reward term gave, and what ended an episode."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="Gymnasium is not installed (extra gym)")

import gymnasium

import understudy_gym.envs  # noqa: F401 - registers the tasks

WALK = "spacetime/walk"


def test_what_each_term_gave_is_the_reward() -> None:
    env = gymnasium.make("miniature/go", overrides=["episode.seconds=0.3"])
    env.reset(seed=0)
    for number in range(3):
        _, reward, _, truncated, info = env.step(np.zeros(env.action_space.shape, np.float32))
        combine = env.unwrapped.worlds.environment.parts.combine  # pyright: ignore
        values = list(info["rewards"].values())
        assert reward == pytest.approx(sum(values) if combine == "sum" else math.prod(values))
        assert ("ended_by" in info) == truncated == (number == 2)
    assert info["ended_by"] == ["time limit"]


def test_a_fall_is_named() -> None:
    env = gymnasium.make(WALK)
    env.reset(seed=0)
    action = np.ones(env.action_space.shape, np.float32)
    for _ in range(100):
        *_, terminated, _, info = env.step(action)
        if terminated:
            break
    assert terminated
    known = {t.name for t in env.unwrapped.worlds.environment.parts.terminations}  # pyright: ignore
    assert info["ended_by"]
    assert set(info["ended_by"]) <= known
    assert info["rewards"].keys() == env.unwrapped.worlds.environment.rewarded.keys()  # pyright: ignore


@pytest.mark.parametrize("mode", ["NEXT_STEP", "SAME_STEP"])
def test_many_worlds_as_gymnasium_has_it(mode: str) -> None:
    envs = gymnasium.make_vec(WALK, num_envs=3, autoreset_mode=mode)
    envs.reset(seed=0)
    actions = np.zeros(envs.action_space.shape, np.float32)
    actions[0] = 1.0  # the first falls before the others
    ended = np.zeros(3, int)
    for _ in range(60):
        _, rewards, terminated, truncated, info = envs.step(actions)
        over = terminated | truncated
        assert np.array_equal(info.get("_ended_by", np.zeros(3, bool)), over)
        given = [v for n, v in info["rewards"].items() if not n.startswith("_")]
        sound = info["_rewards"]
        np.testing.assert_allclose(np.prod(given, axis=0)[sound], rewards[sound], atol=1e-6)
        for world in over.nonzero()[0]:
            assert info["ended_by"][world]
        ended += over
    assert ended[0] >= 1
    envs.close()


def test_a_repr_fits_a_screen() -> None:
    for made in (gymnasium.make(WALK).unwrapped, gymnasium.make_vec(WALK, num_envs=2)):
        assert WALK in repr(made)
        assert len(repr(made)) < 240
        assert "\n" not in repr(made)
        made.close()
