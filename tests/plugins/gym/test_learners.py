"""Stable-Baselines3, rsl_rl and skrl on a task: what each is told at the end of an episode, and that they
train."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Iterator
from typing import Any

import pytest
import torch
from torch import Tensor

from understudy.errors import ConfigError

pytest.importorskip("gymnasium", reason="Gymnasium is not installed (extra learners)")
from understudy_gym.worlds import Worlds, flattened

#: Toy physics; episodes of three steps that are cut.
TASK = "miniature/go"
CUT = ["episode.seconds=0.3"]


@pytest.fixture
def on_the_device(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Fetching a tensor to the host is an error."""

    def fetched(*_: Any, **__: Any) -> None:
        raise AssertionError("a tensor was fetched to the host")

    for name in ("cpu", "numpy", "tolist", "__array__"):
        monkeypatch.setattr(torch.Tensor, name, fetched)
    yield
    monkeypatch.undo()


def last_observations(actions: list[Tensor], seed: int | None = None) -> Tensor:
    """Where cut episodes end, (N, D), after `actions`, before the next ones begin."""
    worlds = Worlds(TASK, len(actions[0]), CUT)
    worlds.environment.reset(seed)
    for action in actions:
        step = worlds.advance(action)
    assert step.truncated.all()
    return flattened(step.observations)


# ------------------------------------------------------------------ Stable-Baselines3


@pytest.fixture
def sb3() -> Any:
    pytest.importorskip("stable_baselines3", reason="Stable-Baselines3 is not installed")
    import understudy_gym.stable_baselines3

    return understudy_gym.stable_baselines3.UnderstudyVecEnv


def test_sb3_is_told_what_was_cut(sb3: Any) -> None:
    env = sb3(TASK, 4, CUT)
    env.seed(3)
    first = env.reset()
    assert env.observation_space.contains(first[0])
    action = torch.full((4, 2), 0.5)
    for _ in range(3):
        observations, rewards, ended, infos = env.step(action.numpy())
    assert ended.all()
    assert rewards.shape == (4,)
    final = torch.stack([torch.tensor(info["terminal_observation"]) for info in infos])
    torch.testing.assert_close(final, last_observations([action] * 3, seed=3))
    assert all(info["TimeLimit.truncated"] for info in infos)
    assert (observations != final.numpy()).any(axis=1).all()
    assert env.step(action.numpy())[3] == [{}, {}, {}, {}]
    assert env.get_attr("render_mode") == [None] * 4
    with pytest.raises(ValueError, match="Leave indices out"):
        env.env_method("reset", indices=[0])


def test_sb3_is_told_what_failed(sb3: Any) -> None:
    env = sb3("spacetime/walk", 4)
    env.reset()
    for _ in range(20):
        _, _, ended, infos = env.step(torch.ones(4, 28).numpy())
        if ended.any():
            break
    assert ended.any()
    for info in (infos[world] for world in ended.nonzero()[0]):
        assert info["TimeLimit.truncated"] is False
        assert info["terminal_observation"].shape == env.observation_space.shape


def test_sb3_adds_the_value_of_the_observation_that_was_cut(sb3: Any) -> None:
    from stable_baselines3 import PPO

    env = sb3(TASK, 4, CUT)
    model = PPO("MlpPolicy", env, n_steps=3, batch_size=12, learning_rate=0.0, gamma=0.5, seed=0)
    seen: list[Any] = []
    step = env.step_wait

    def noted() -> Any:
        observations, rewards, *rest = step()
        seen.append((observations, rewards.copy(), *rest))  # it adds to them in place
        return observations, rewards, *rest

    env.step_wait = noted
    model.learn(12)
    final = torch.stack([torch.tensor(info["terminal_observation"]) for info in seen[-1][3]])
    with torch.no_grad():
        value = model.policy.predict_values(final).squeeze(1)
    assert (value != 0).all()
    given = torch.tensor(model.rollout_buffer.rewards[-1])
    torch.testing.assert_close(given, torch.tensor(seen[-1][1]) + 0.5 * value)


def test_sb3_is_told_of_options_that_nothing_takes(sb3: Any) -> None:
    env = sb3(TASK, 2, CUT)
    env.set_options({"difficulty": 1.0})
    with pytest.raises(ConfigError, match="no option 'difficulty'"):
        env.reset()


def test_sb3s_own_check_passes(sb3: Any) -> None:
    import gymnasium
    from stable_baselines3.common.env_checker import check_env

    import understudy_gym.envs  # noqa: F401

    check_env(gymnasium.make(TASK, flat=True).unwrapped)


# ------------------------------------------------------------------ rsl_rl


@pytest.fixture
def rsl_rl() -> Any:
    pytest.importorskip("rsl_rl.runners", reason="rsl_rl is not installed", exc_type=ImportError)
    import understudy_gym.rsl_rl

    return understudy_gym.rsl_rl.UnderstudyVecEnv


def test_rsl_rl_is_told_what_was_cut(rsl_rl: Any) -> None:
    env = rsl_rl(TASK, 4, CUT)
    assert (env.num_envs, env.num_actions, env.max_episode_length) == (4, 2, 3)
    assert env.get_observations()["state"].shape == (4, 4)
    for age in (1, 2, 0):
        _, _, dones, extras = env.step(torch.zeros(4, 2))
        assert env.episode_length_buf.tolist() == [age] * 4
    assert dones.all()
    assert extras["time_outs"].all()
    walk = rsl_rl("spacetime/walk", 4)
    for _ in range(20):
        observations, _, dones, extras = walk.step(torch.ones(4, 28))
        if dones.any():
            break
    assert dones.any()
    assert not extras["time_outs"].any()
    assert set(observations.keys()) == {"state", "feedforward"}


@pytest.mark.usefixtures("on_the_device")
def test_rsl_rl_gets_the_environments_own_tensors(rsl_rl: Any) -> None:
    env = rsl_rl(TASK, 4, CUT)
    before = env.get_observations()["state"]
    kept = before.clone()
    taken: list[Any] = []
    step = env.worlds.environment.step
    env.worlds.environment.step = lambda action: taken.append(step(action)) or taken[-1]
    _, rewards, _, extras = env.step(torch.ones(4, 2))
    assert rewards.data_ptr() == taken[0].rewards.data_ptr()
    assert extras["time_outs"].data_ptr() == taken[0].truncated.data_ptr()
    for _ in range(3):
        env.step(torch.ones(4, 2))
    assert torch.equal(before, kept)  # rsl_rl stores it only after the next step


def test_rsl_rl_trains(rsl_rl: Any) -> None:
    from rsl_rl.runners import OnPolicyRunner

    model = {"class_name": "MLPModel", "hidden_dims": [16]}
    noise = {"class_name": "GaussianDistribution", "init_std": 1.0}
    config = {
        "num_steps_per_env": 4, "save_interval": 100, "obs_groups": {"actor": ["state"], "critic": ["state"]},
        "algorithm": {"class_name": "PPO"}, "actor": {**model, "distribution_cfg": noise}, "critic": model,
    }  # fmt: skip
    env = rsl_rl(TASK, 4, CUT)
    runner = OnPolicyRunner(env, config)
    before = [p.clone() for p in runner.alg.actor.parameters()]
    runner.learn(2)
    assert any((a != b).any() for a, b in zip(before, runner.alg.actor.parameters(), strict=True))
    with torch.inference_mode():  # in which the runner collects
        assert not env.step(torch.zeros(4, 2))[1].is_inference()
    env.worlds.one_episode(runner.get_inference_policy())
    with pytest.raises(ConfigError, match="init_at_random_ep_len=False"):
        runner.learn(1, init_at_random_ep_len=True)


# ------------------------------------------------------------------ skrl


@pytest.fixture
def skrl() -> Any:
    pytest.importorskip("skrl", reason="skrl is not installed")
    import understudy_gym.skrl

    return understudy_gym.skrl


@pytest.mark.usefixtures("on_the_device")
def test_skrl_gets_the_environments_own_tensors(skrl: Any) -> None:
    env = skrl.UnderstudyWrapper(TASK, 4, CUT)
    before, _ = env.reset()
    kept = before.clone()
    taken: list[Any] = []
    step = env.worlds.environment.step
    env.worlds.environment.step = lambda action: taken.append(step(action)) or taken[-1]
    for _ in range(3):
        observations, rewards, terminated, truncated, infos = env.step(torch.ones(4, 2))
    assert rewards.shape == terminated.shape == truncated.shape == (4, 1)
    assert rewards.data_ptr() == taken[-1].rewards.data_ptr()
    assert truncated.all()
    assert not terminated.any()
    final = infos["final_observations"]
    assert (final != observations).any(dim=1).all()
    torch.testing.assert_close(final, last_observations([torch.ones(4, 2)] * 3))
    assert env.reset()[0] is observations
    assert torch.equal(before, kept)


def test_skrl_adds_the_value_of_the_observation_that_was_cut(skrl: Any, tmp_path: Any) -> None:
    from skrl.agents.torch.ppo import PPO, PPO_CFG
    from skrl.memories.torch import RandomMemory
    from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
    from skrl.trainers.torch import SequentialTrainer

    class Actor(GaussianMixin, Model):
        def __init__(self, observations: Any, actions: Any) -> None:
            Model.__init__(self, observation_space=observations, action_space=actions)
            GaussianMixin.__init__(self)
            self.mean, self.spread = torch.nn.Linear(4, 2), torch.nn.Parameter(torch.zeros(2))

        def compute(self, inputs: Any, role: str = "") -> Any:
            return self.mean(inputs["observations"]), {"log_std": self.spread}

    class First(DeterministicMixin, Model):
        """The value is an observation's first number."""

        def __init__(self, observations: Any, actions: Any) -> None:
            Model.__init__(self, observation_space=observations, action_space=actions)
            DeterministicMixin.__init__(self)
            self.one = torch.nn.Parameter(torch.ones(1))

        def compute(self, inputs: Any, role: str = "") -> Any:
            return self.one * inputs["observations"][:, :1], {}

    env = skrl.UnderstudyWrapper(TASK, 4, CUT)
    spaces = env.observation_space, env.action_space
    config = PPO_CFG(rollouts=3, learning_epochs=1, mini_batches=1, learning_rate=0.0)
    config.discount_factor, config.time_limit_bootstrap = 0.5, True
    config.experiment.directory = str(tmp_path)
    config.experiment.write_interval = config.experiment.checkpoint_interval = 0
    memory = RandomMemory(memory_size=3, num_envs=4)
    models = {"policy": Actor(*spaces), "value": First(*spaces)}
    agent = PPO(models=models, memory=memory, cfg=config,
                observation_space=spaces[0], action_space=spaces[1])  # fmt: skip
    agent = skrl.use_final_observations(agent)
    given: list[Tensor] = []
    step = env.worlds.environment.step

    def noted(action: Tensor) -> Any:
        taken = step(action)
        given.append(taken.rewards.clone())
        return taken

    env.worlds.environment.step = noted
    timing = {"timesteps": 3, "disable_progressbar": True, "close_environment_at_exit": False}
    SequentialTrainer(env=env, agents=agent, cfg=timing).train()
    actions = memory.get_tensor_by_name("actions")
    final = last_observations(list(actions))
    stored = memory.get_tensor_by_name("rewards").squeeze(-1)
    torch.testing.assert_close(stored[:2], torch.stack(given[:2]))
    torch.testing.assert_close(stored[2], given[2] + 0.5 * final[:, 0])


# ------------------------------------------------------------------ scores


def test_one_episode_in_each_world() -> None:
    worlds = Worlds(TASK, 3, CUT)
    length, returns = worlds.one_episode(lambda seen: torch.zeros(3, 2), seed=1)
    assert length.tolist() == [3.0] * 3
    worlds.environment.reset(1, "trial")
    rewards = [worlds.step(torch.zeros(3, 2)).rewards.clone() for _ in range(3)]
    torch.testing.assert_close(returns, torch.stack(rewards).sum(dim=0))


# ------------------------------------------------------------------ all of them


@pytest.mark.parametrize("library", ["sb3", "rsl_rl", "skrl"])
def test_copies_of_adapters_go_on_alike(library: str, request: pytest.FixtureRequest) -> None:
    """Over the ends of episodes. skrl's own wrapper looked for itself until Python gave up."""
    make = request.getfixturevalue(library)
    env = getattr(make, "UnderstudyWrapper", make)(TASK, 3, CUT)
    if library == "sb3":
        env.seed(4)
    env.reset()
    actions = torch.full((3, 2), 0.3)
    given: Any = actions.numpy() if library == "sb3" else actions
    env.step(given)
    copies = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    for _ in range(7):
        seen, *same = (one.step(given)[0] for one in (env, *copies))
        if library == "rsl_rl":
            seen, *same = (observations["state"] for observations in (seen, *same))
        for its in same:
            torch.testing.assert_close(torch.as_tensor(its), torch.as_tensor(seen), atol=0, rtol=0)


@pytest.mark.parametrize("library", ["rsl_rl", "skrl"])
def test_actions_of_another_shape_are_refused_by_adapters(
    library: str, request: pytest.FixtureRequest
) -> None:
    make = request.getfixturevalue(library)
    env = getattr(make, "UnderstudyWrapper", make)(TASK, 3, CUT)
    env.reset()
    for shape in ((3, 3), (1, 2), (2,)):
        with pytest.raises(ConfigError, match=r"do not fit: \(3, 2\) is needed"):
            env.step(torch.zeros(shape))
