"""Tasks as Gymnasium environments: one world and many, their wrappers, and what Gymnasium's checker says."""

from __future__ import annotations

import contextlib
import copy
import functools
import pickle
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

pytest.importorskip("gymnasium", reason="Gymnasium is not installed (extra gym)")

import gymnasium
from commands import forked
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import FlattenObservation, NormalizeObservation, RecordEpisodeStatistics
from gymnasium.wrappers import vector as vector_wrappers

from understudy.errors import ConfigError
from understudy.setup.composition import load_experiment
from understudy.setup.registry import Component
from understudy.task import ActionSpace, Actuation, Choice
from understudy.task import Box as BoxPart
from understudy.testing.fake import FAKE_TASK, fake_plugins
from understudy_gym import envs, worlds

#: Episodes of three steps that are cut.
SHORT = {"overrides": ["episode.seconds=0.3"]}
WALK, TOY = "spacetime/walk", "miniature/go"


def many(task: str = TOY, num_envs: int = 3, **settings: Any) -> Any:
    return gymnasium.make_vec(
        task, num_envs=num_envs, **{**(SHORT if task == TOY else {}), **settings}
    )


def idle(environments: Any) -> np.ndarray:
    return np.zeros(environments.action_space.shape, np.float32)


@pytest.mark.filterwarnings("ignore:.*Box observation space:UserWarning")
@pytest.mark.parametrize(("task", "flat"), [(WALK, False), (TOY, True)])
def test_gymnasiums_own_check_passes(task: str, flat: bool) -> None:
    env = gymnasium.make(task, flat=flat, render_mode="rgb_array", width=64, height=64)
    check_env(env.unwrapped)
    env.close()


def test_no_import_is_needed_where_the_module_is_named(tmp_path: Path) -> None:
    code = (
        "import sys; assert 'understudy_gym.envs' not in sys.modules; "
        "import gymnasium; env = gymnasium.make('understudy_gym.envs:miniature/go'); "
        "env.reset(seed=0); print(env.spec.id)"
    )
    done = forked(code, cwd=tmp_path)
    assert (done.stdout, done.returncode) == ("miniature/go\n", 0), done.stderr


def test_zero_is_the_reference_of_the_walk() -> None:
    """Actions in [-1, 1] span 0.3 rad around it; raw ones are joint targets in rad."""
    scaled, raw = gymnasium.make(WALK), gymnasium.make(WALK, actions="raw")
    assert scaled.action_space == gymnasium.spaces.Box(-1, 1, (28,), np.float32)
    assert np.isinf(raw.action_space.high).all()
    (seen, _), (same, _) = scaled.reset(seed=4), raw.reset(seed=4)
    action = np.random.default_rng(0).uniform(-1, 1, 28).astype(np.float32)
    for _ in range(3):
        targets = seen["feedforward"] + 0.3 * action
        seen, *_ = scaled.step(action)
        same, *_ = raw.step(targets)
        np.testing.assert_allclose(seen["state"], same["state"], rtol=1e-4, atol=1e-4)


def test_the_scale_can_be_inverted_and_replaced() -> None:
    env = gymnasium.make(WALK, action_scale=0.1).unwrapped
    env.reset(seed=1)
    action = env.worlds.environment.action.uniform_(-1, 1).clone()
    target = env.worlds.to_task(action)
    np.testing.assert_allclose(target - env.worlds.to_task(0 * action), 0.1 * action, atol=1e-6)
    np.testing.assert_allclose(env.worlds.from_task(target), action, atol=1e-5)
    uneven = gymnasium.make(TOY, action_scale=[2.0, 0.5]).unwrapped.worlds
    assert uneven.to_task(uneven.environment.action + 1.0).tolist() == [[2.0, 0.5]]


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"actions": "scald"}, "write 'scaled' or 'raw'"),
        ({"actions": "raw", "action_scale": 2.0}, "Leave one of them out"),
        ({"action_scale": [1.0, 1.0, 1.0]}, "2, one for each column"),
        ({"action_scale": 0.0}, "above 0"),
        ({"render_mode": "human_array"}, "there is rgb_array"),
        ({"overrides": "seed=3"}, "must be a list"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*not in the possible render_modes:UserWarning")
def test_what_is_not_possible_is_said(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        gymnasium.make(TOY, **settings)
    with pytest.raises(ConfigError, match=said):
        gymnasium.make_vec(TOY, num_envs=2, **settings)


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("num_worlds=3", "num_envs=3"),
        ("++num_worlds=3", "num_envs=3"),
        ("num_worlds='3'", "num_envs=3"),
        ("task=miniature/stop", "Make miniature/stop with"),
        ("experiment=miniature/stop", "Make miniature/stop with"),
        ("experiment=spacetime/walk", "Make spacetime/walk with"),
    ],
)
def test_what_is_said_beside_the_overrides_is_not_overruled_in_silence(
    override: str, said: str
) -> None:
    """It was: of the experiment of another task nothing came but some of its options."""
    for make in (gymnasium.make, partial(gymnasium.make_vec, num_envs=2)):
        with pytest.raises(ConfigError, match=said):
            make("miniature/go", overrides=[override])


@pytest.mark.parametrize(
    "override", ["num_worlds=2", "task=miniature/go", "experiment=miniature/go"]
)
def test_what_is_said_twice_may_be(override: str) -> None:
    worlds = gymnasium.make_vec("miniature/go", num_envs=2, overrides=[override])
    assert worlds.num_envs == 2
    worlds.close()


def test_an_argument_that_nothing_takes_is_refused() -> None:
    with pytest.raises(TypeError, match="flatt"):
        gymnasium.make_vec(TOY, num_envs=2, flatt=True)
    with pytest.raises(ConfigError, match="NEXT_STEP, SAME_STEP, DISABLED"):
        many(autoreset_mode="later")


def test_actions_of_another_shape_are_refused() -> None:
    """Also by 1 row of several, which would be every world's."""
    one, three = gymnasium.make(TOY, disable_env_checker=True).unwrapped, many()
    one.reset(seed=0)
    three.reset(seed=0)
    for wrong in ([0.1], [0.1] * 3, 0.1, [[0.1, 0.2]]):
        with pytest.raises(ConfigError, match=r"do not fit: \(1, 2\) is needed"):
            one.step(wrong)
    for wrong in (np.zeros((1, 2)), np.zeros((2, 2)), np.zeros(2), np.zeros((3, 1))):
        with pytest.raises(
            ConfigError, match=r"do not fit: \(3, 2\) is needed, a row for each of 3"
        ):
            three.step(wrong)


def test_a_reset_uses_what_it_is_given_or_says_so() -> None:
    one, three = gymnasium.make(TOY), many()
    for env, there in ((one, "there are none"), (three, "there is reset_mask")):
        with pytest.raises(ConfigError, match=f"no option 'dificulty'; {there}"):
            env.reset(options={"dificulty": 1.0})
        env.reset(seed=0, options={})
    with pytest.raises(ConfigError, match="All worlds have one seed"):
        three.reset(seed=[1, 2, 3])


def test_flat_observations_are_those_by_name_side_by_side() -> None:
    named, flat = many(WALK), many(WALK, flat=True)
    (by_name, _), (row, _) = named.reset(seed=2), flat.reset(seed=2)
    np.testing.assert_array_equal(np.concatenate(list(by_name.values()), axis=1), row)
    assert named.observation_space.contains(by_name)
    assert flat.observation_space.contains(row)


def test_seeds_repeat_and_episodes_without_one_differ() -> None:
    first, second = many(flat=True), many(flat=True)
    assert (first.reset(seed=8)[0] == second.reset(seed=8)[0]).all()
    again = first.step(idle(first))[0], first.reset()[0]
    same = second.step(idle(second))[0], second.reset()[0]
    for one, other in zip(again, same, strict=True):
        np.testing.assert_array_equal(one, other)
    assert (many(flat=True).reset()[0] != many(flat=True).reset()[0]).any()
    apart = gymnasium.make_vec(TOY, num_envs=3, vectorization_mode="sync", flat=True)
    assert len(np.unique(apart.reset()[0], axis=0)) == 3


def test_autoreset_in_the_next_step() -> None:
    environments = many(flat=True)
    assert environments.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    environments.reset(seed=3)
    rows = [environments.step(idle(environments)) for _ in range(8)]
    assert [bool(cut.all()) for _, _, _, cut, _ in rows] == [0, 0, 1, 0, 0, 0, 1, 0]
    assert not any(ended.any() for _, _, ended, _, _ in rows)
    assert (rows[3][1] == 0).all()
    assert (rows[2][1] > 0).all()
    assert not any("final_obs" in info for *_, info in rows)
    assert ["ended_by" in info for *_, info in rows] == [0, 0, 1, 0, 0, 0, 1, 0]
    np.testing.assert_array_equal(rows[2][0], rows[1][0])  # at rest, without a force …
    assert (rows[3][0] != rows[2][0]).any(axis=1).all()  # … until the next episode begins


def test_autoreset_in_the_same_step() -> None:
    same, later = many(flat=True, autoreset_mode="SAME_STEP"), many(flat=True)
    for environments in (same, later):
        environments.reset(seed=3)
    for _ in range(3):
        given = same.step(idle(same))
        reached = later.step(idle(later))
    observations, _, _, cut, info = given
    assert cut.all()
    assert info["_final_obs"].all()
    assert info["final_obs"].dtype == object
    np.testing.assert_array_equal(np.stack(info["final_obs"]), reached[0])
    assert (observations != reached[0]).any(axis=1).all()


def test_a_world_that_rests_disturbs_no_other() -> None:
    """Worlds that fall at different times: what each goes through is what it does alone."""
    environments = gymnasium.make_vec(WALK, num_envs=3, flat=True)
    observations, _ = environments.reset(seed=5)
    kept = [[row] for row in observations]
    ended = np.zeros(3, bool)
    for _ in range(16):
        observations, rewards, terminated, truncated, _ = environments.step(idle(environments))
        assert (rewards[ended] == 0).all()
        ended = terminated | truncated
        for row, rows in zip(observations, kept, strict=True):
            rows.append(row)
    same = gymnasium.make_vec(WALK, num_envs=3, flat=True, autoreset_mode="SAME_STEP")
    observations, _ = same.reset(seed=5)
    others = [[row] for row in observations]
    for _ in range(16):
        observations, _, terminated, truncated, info = same.step(idle(same))
        for world in range(3):
            if (terminated | truncated)[world]:
                others[world].append(info["final_obs"][world])
            others[world].append(observations[world])
    ends = [len(other) > 17 for other in others]
    assert any(ends)
    for rows, other in zip(kept, others, strict=True):
        np.testing.assert_allclose(rows, other[: len(rows)], rtol=1e-4, atol=1e-4)


def test_no_autoreset_waits_for_the_mask() -> None:
    environments = many(flat=True, autoreset_mode=AutoresetMode.DISABLED)
    environments.reset(seed=3)
    for _ in range(3):
        reached, _, _, cut, _ = environments.step(idle(environments))
    assert cut.all()
    with pytest.raises(gymnasium.error.ResetNeeded, match="worlds 0, 1, 2"):
        environments.step(idle(environments))
    mask = np.array([True, False, True])
    begun, _ = environments.reset(options={"reset_mask": mask})
    np.testing.assert_array_equal(begun[1], reached[1])
    assert (begun[mask] != reached[mask]).any(axis=1).all()
    with pytest.raises(gymnasium.error.ResetNeeded, match="worlds 1 "):
        environments.step(idle(environments))
    environments.reset(options={"reset_mask": ~mask})
    assert not environments.step(idle(environments))[3].any()
    for options, seed in (({"reset_mask": mask}, 3), ({"reset_mask": mask[:2]}, None)):
        with pytest.raises(ValueError, match="reset_mask"):
            environments.reset(seed=seed, options=options)


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_gymnasiums_wrappers_of_many_worlds(mode: AutoresetMode) -> None:
    """Its wrappers of observations do not take SAME_STEP, and its normalisation NEXT_STEP alone."""
    same = mode is AutoresetMode.SAME_STEP
    wrapped: Any = many(autoreset_mode=mode, flat=same)
    wrapped = vector_wrappers.RecordEpisodeStatistics(wrapped)
    if not same:
        wrapped = vector_wrappers.FlattenObservation(wrapped)
    if mode is AutoresetMode.NEXT_STEP:
        wrapped = vector_wrappers.NormalizeObservation(wrapped)
    observations, _ = wrapped.reset(seed=0)
    assert observations.shape == wrapped.observation_space.shape
    lengths = []
    for _ in range(7):
        observations, _, _, cut, info = wrapped.step(idle(wrapped))
        assert wrapped.observation_space.contains(observations.astype(np.float32))
        if "episode" in info:
            lengths += info["episode"]["l"].tolist()
        if cut.any() and mode is AutoresetMode.DISABLED:
            wrapped.reset(options={"reset_mask": cut})
    assert lengths == [3] * 6


def test_gymnasiums_wrappers_of_one_world() -> None:
    env = gymnasium.make(TOY, **SHORT)
    env = RecordEpisodeStatistics(NormalizeObservation(FlattenObservation(env)))
    env.reset(seed=0)
    for _ in range(3):
        _, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert isinstance(reward, float)
    assert (terminated, truncated) == (False, True)
    assert info["episode"]["l"] == 3


def test_numbers_that_went_wrong_reach_nobody() -> None:
    environments = many(flat=True, actions="raw")
    environments.reset(seed=0)
    actions = idle(environments)
    actions[1] = np.nan
    observations, rewards, terminated, _, _ = environments.step(actions)
    assert terminated.tolist() == [False, True, False]
    assert np.isfinite(observations).all()
    assert rewards[1] == 0


def test_pictures() -> None:
    env = gymnasium.make(WALK, render_mode="rgb_array", width=96, height=64)
    assert env.metadata["render_fps"] == 30
    env.reset(seed=0)
    picture = env.render()
    assert (picture.shape, picture.dtype) == ((64, 96, 3), np.uint8)
    blue, orange = (picture.astype(int) @ np.array(way) > 150 for way in ([-1, 0, 1], [1, 0, -1]))
    assert blue.sum() > 50  # the character
    assert orange.sum() > 50  # its reference
    both = many(WALK, 2, render_mode="rgb_array", width=48, height=32)
    both.reset(seed=0)
    pictures = both.render()
    assert [p.shape for p in pictures] == [(32, 48, 3)] * 2
    assert many(TOY).render() is None


def test_actions_of_numbers_and_choices(monkeypatch: pytest.MonkeyPatch) -> None:
    """Boxes and choices by name; a choice is not scaled."""

    class Sided(Actuation):
        action_space = ActionSpace(
            {"side": Choice(2), "step": BoxPart(1, reach=5.0, around=(2.0,))}
        )

        def __init__(self, options: None, context: Any) -> None:
            pass

        def control(self, action: Any) -> Any:
            return (2 * action[:, :1] - 1) * action[:, 1:]

    task = [o for o in FAKE_TASK if "actuation" not in o]
    plugins = fake_plugins()
    plugins.registry.components["actuation", "fake/sided"] = Component(
        "actuation", "fake/sided", Sided, "fake"
    )
    chosen = functools.partial(load_experiment, plugins=plugins)
    monkeypatch.setattr(
        worlds, "load_experiment", lambda o: chosen([x for x in o if not x.startswith("task=")])
    )
    environments = envs.UnderstudyVectorEnv("", 3, [*task, "+actuation={name: fake/sided}"])
    space = environments.single_action_space
    assert space == spaces.Dict({"side": spaces.Discrete(2), "step": spaces.Box(-1, 1, (1,))})
    environments.reset(seed=0)
    environments.action_space.seed(0)
    sample = environments.action_space.sample()
    assert environments.action_space.contains(sample)
    with pytest.raises(ConfigError, match="An action needs 'side', too"):
        environments.step({"step": sample["step"]})
    environments.step(sample)
    taken = environments.worlds.environment.action.numpy()
    np.testing.assert_array_equal(taken[:, 0], sample["side"])
    # Two and five of float32 nearly cancel where the step is near -0.4.
    np.testing.assert_allclose(taken[:, 1:], 2 + 5 * sample["step"], rtol=1e-6, atol=1e-6)


# ---------------------------------------------------------------- processes and copies

FORKED = """
import multiprocessing
import gymnasium, torch
import understudy_gym.envs

multiprocessing.set_start_method("fork", force=True)  # as of a program's own
torch.set_num_threads(4)
one = gymnasium.make("{task}")
one.reset(seed=0)
one.step(one.action_space.sample())  # torch's threads are there before the fork
(torch.rand(500, 500) @ torch.rand(500, 500)).exp()
envs = gymnasium.make_vec("{task}", num_envs=2, vectorization_mode="async")
envs.reset(seed=0)
print(envs.step(envs.action_space.sample())[1].shape)
envs.close()
"""


@pytest.mark.parametrize("task", [WALK, "deepmimic/walk"])
def test_forked_environments_step(task: str, tmp_path: Path) -> None:
    """Gymnasium's ``async`` forks by default; a child that waited for torch's threads would hang."""
    done = forked(FORKED.format(task=task), cwd=tmp_path, seconds=240)
    assert (done.stdout, done.returncode) == ("(2,)\n", 0), done.stderr


COPIES = {"deepcopy": copy.deepcopy, "pickle": lambda env: pickle.loads(pickle.dumps(env))}


@pytest.mark.parametrize("how", COPIES)
@pytest.mark.parametrize("make", [gymnasium.make, many], ids=["one", "many"])
def test_copies_go_on_alike(make: Any, how: str) -> None:
    original = make(WALK, flat=True)
    unbegun = COPIES[how](original)
    seen, same = original.reset(seed=3)[0], unbegun.reset(seed=3)[0]
    np.testing.assert_array_equal(seen, same)
    action = 0.2 * np.ones(original.action_space.shape, np.float32)
    original.step(action)
    begun = COPIES[how](original)
    for _ in range(12):
        for mine, its in zip(original.step(action)[:4], begun.step(action)[:4], strict=True):
            np.testing.assert_array_equal(mine, its)
    np.testing.assert_array_equal(original.reset()[0], begun.reset()[0])
    assert begun.unwrapped.worlds is not original.unwrapped.worlds


@pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.name)
def test_episodes_of_a_copy_begin_alike(mode: AutoresetMode) -> None:
    """They drew the numbers of another seed: of the one that no reset had been given."""
    original = many(autoreset_mode=mode)
    original.reset(seed=3)
    copied, again = copy.deepcopy(original), pickle.loads(pickle.dumps(copy.deepcopy(original)))
    action, began = idle(original), 0
    for _ in range(10):
        seen = [env.step(action)[:4] for env in (original, copied, again)]
        if mode is AutoresetMode.DISABLED and seen[0][3].any():
            mask = {"reset_mask": seen[0][3]}
            seen = [env.reset(options=mask)[:1] for env in (original, copied, again)]
        began += seen[0][-1].any() if len(seen[0]) == 4 else 1
        for mine, its, third in zip(*seen, strict=True):
            np.testing.assert_equal(its, mine)
            np.testing.assert_equal(third, mine)
    assert began > 1
    first = original.reset()[0]
    np.testing.assert_equal([copied.reset()[0], again.reset()[0]], [first, first])


def test_a_copy_keeps_what_it_was_made_with() -> None:
    original = gymnasium.make(
        WALK, overrides=["episode.seconds=0.5"], action_scale=0.1, width=32, height=16,
        render_mode="rgb_array",
    )  # fmt: skip
    other = copy.deepcopy(original)
    assert other.unwrapped.worlds.episode_steps == original.unwrapped.worlds.episode_steps
    assert float(other.unwrapped.worlds.scale.reach[0]) == pytest.approx(0.1)
    other.reset(seed=0)
    assert other.render().shape == (16, 32, 3)


@pytest.mark.parametrize("make", [envs.UnderstudyEnv, envs.UnderstudyVectorEnv])
def test_nothing_happens_before_a_reset(make: Callable[..., Any]) -> None:
    """Also without Gymnasium's wrappers, of which vector environments have none."""
    env = make(TOY, render_mode="rgb_array", width=32, height=32)
    for use in (lambda: env.step(idle(env)), env.render):
        with pytest.raises(gymnasium.error.ResetNeeded, match=r"Call reset\(\) first"):
            use()
    env.reset(seed=0)
    env.step(idle(env))
    assert env.render() is not None
    assert make(TOY).render() is None


@pytest.mark.parametrize(
    "wrong", [None, [None, None], "ab", ["a", "b"], [0.0, 1j], [[0.0], [0.0, 1.0]]], ids=repr
)
def test_actions_that_are_no_numbers_are_refused(wrong: Any) -> None:
    """None would be not a number, and the world fail by it."""
    one, three = gymnasium.make(TOY, disable_env_checker=True).unwrapped, many()
    for env in (one, three):
        env.reset(seed=0)
        with pytest.raises(ConfigError, match="An action is made of numbers"):
            env.step(wrong)


def test_actions_may_be_tensors_with_gradients() -> None:
    """As a policy gives them."""
    one, three = gymnasium.make(TOY, disable_env_checker=True).unwrapped, many()
    for env in (one, three):
        env.reset(seed=0)
        known = env.step(idle(env) + np.float32(0.5))[0]["state"]
        for kind in (torch.float32, torch.float64, torch.bfloat16):
            env.reset(seed=0)
            action = torch.full(env.action_space.shape, 0.5, dtype=kind, requires_grad=True)
            np.testing.assert_array_equal(env.step(action)[0]["state"], known)
    with pytest.raises(ConfigError, match="An action is made of numbers"):
        one.step(list(action[0]))


@contextlib.contextmanager
def torch_set_otherwise(how: str) -> Iterator[None]:
    """As the program around may have it."""
    with torch.inference_mode() if how == "inference" else contextlib.nullcontext():
        if how == "meta":
            torch.set_default_device("meta")
        elif how == "float64":
            torch.set_default_dtype(torch.float64)
        try:
            yield
        finally:
            torch.set_default_device(None)
            torch.set_default_dtype(torch.float32)


@pytest.mark.parametrize("how", ["float64", "inference", "meta"])
@pytest.mark.parametrize("task", [WALK, TOY])
def test_what_a_program_sets_in_torch_changes_nothing(task: str, how: str) -> None:
    def seen(env: Any) -> list[Any]:
        return [env.reset(seed=0)[0], *env.step(idle(env))[:4]]

    known = seen(gymnasium.make_vec(task, num_envs=2))
    with torch_set_otherwise(how):
        set_so = torch.get_default_dtype(), torch.get_default_device()
        other = gymnasium.make_vec(task, num_envs=2)
        np.testing.assert_equal(seen(other), known)
        assert all(value.dtype == np.float32 for value in other.reset()[0].values())
        copy.deepcopy(other).step(idle(other))
        assert (torch.get_default_dtype(), torch.get_default_device()) == set_so
    np.testing.assert_equal(seen(other), known)


@pytest.mark.parametrize("size", [0, -3, 10.5, "a", 100_000, None, True])
def test_pictures_of_no_possible_size_are_refused(size: Any) -> None:
    with pytest.raises(ConfigError, match=r"height=.* is not possible: give a whole number from 1"):
        gymnasium.make(TOY, render_mode="rgb_array", height=size)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"overrides": None}, "must be a list of texts"),
        ({"overrides": [3]}, "must be a list of texts"),
        ({"action_scale": "a"}, "action_scale=a is not possible"),
        ({"action_scale": [1, "a"]}, "is not possible"),
        ({"action_scale": np.inf}, "action_scale=inf is not possible"),
        ({"action_scale": True}, "action_scale=True is not possible"),
        ({"flat": "no"}, "flat='no' is not possible: write True or False"),
    ],
)
def test_settings_of_other_types_are_refused(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        gymnasium.make_vec(TOY, num_envs=2, **settings)


@pytest.mark.parametrize("make", [partial(gymnasium.make, TOY), many])
def test_a_seed_among_the_overrides_is_where_episodes_begin(make: Callable[..., Any]) -> None:
    """As a reset with this seed; with another seed the reset decides, and later episodes go on from there."""

    def first(seed: int | None, *overrides: str) -> tuple[np.ndarray, np.ndarray]:
        env = make(overrides=[*SHORT["overrides"], *overrides])
        return env.reset(seed=seed)[0]["state"], env.reset()[0]["state"]

    for known, found in zip(first(3), first(None, "seed=3"), strict=True):
        np.testing.assert_array_equal(known, found)
    for known, found in zip(first(3), first(3, "++seed=4"), strict=True):
        np.testing.assert_array_equal(known, found)
    assert not np.array_equal(first(None, "seed=3")[0], first(None, "seed=4")[0])


@pytest.mark.parametrize("count", [2.0, "2", None, True, float("nan"), 0, -1])
def test_a_number_of_worlds_that_is_none_is_refused(count: Any) -> None:
    with pytest.raises(ConfigError, match=r"num_envs=.* is not possible: give a whole number"):
        many(num_envs=count)


def test_a_number_of_worlds_may_be_numpys() -> None:
    assert many(num_envs=np.int64(2)).reset(seed=0)[0]["state"].shape[0] == 2


def test_a_pictures_size_may_be_numpys() -> None:
    env = gymnasium.make(TOY, render_mode="rgb_array", width=np.int64(32), height=np.uint8(16))
    env.reset(seed=0)
    assert env.render().shape == (16, 32, 3)


def test_what_gymnasium_gives_single_environments_alone_is_answered() -> None:
    with pytest.raises(ConfigError, match=r"max_episode_steps .*'episode\.seconds=5'"):
        many(max_episode_steps=3)
    with pytest.raises(ConfigError, match=r"autoreset_mode=7 is not possible"):
        many(autoreset_mode=7)


def test_a_mask_of_rows_of_several_lengths_is_refused() -> None:
    envs = many()
    envs.reset(seed=0)
    for mask in ([[True], [True, False]], "abc", [0, 1, 1], [None, True, True]):
        with pytest.raises(ValueError, match="reset_mask must be bool of shape"):
            envs.reset(options={"reset_mask": mask})
