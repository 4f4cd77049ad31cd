"""What the comparisons with Stable-Baselines3 share: Gymnasium tasks for our learners, the same
evaluation for both sides, and the record of a comparison."""

from __future__ import annotations

import argparse
import pkgutil
import statistics
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from rows import append
from torch import Tensor

from understudy.random import WorldStreams, private_rng
from understudy.records.runs import versions
from understudy.task import Context, Rollout, box
from understudy_networks.nn import Schedule
from understudy_networks.policies import MLPPolicy
from understudy_reinforcement.learner import Learner
from understudy_reinforcement.policy import Policy

RESULTS = Path(__file__).resolve().parents[1] / "docs" / "benchmarks"
ENVIRONMENTS, STEPS, HIDDEN = 8, 256, (64, 64)


class Collector:
    """Rollouts of Gymnasium environments with a box of observations and one of actions."""

    def __init__(self, task: str, seed: int) -> None:
        self.environments = SyncVectorEnv(
            [lambda: gymnasium.make(task)] * ENVIRONMENTS, autoreset_mode=AutoresetMode.SAME_STEP
        )
        space = self.environments.single_action_space
        assert isinstance(space, gymnasium.spaces.Box)
        self.space = space
        self.size = int(np.prod(self.environments.single_observation_space.shape or ()))
        self.streams = WorldStreams(seed, "actions", ENVIRONMENTS, "cpu")
        self.observation, _ = self.environments.reset(seed=seed)
        self.context = Context(
            seed=seed,
            device=torch.device("cpu"),
            num_worlds=ENVIRONMENTS,
            control_dt=1.0,
            substeps=1,
            action_space=box(space.shape[0]),
            observation_shapes={"state": (self.size,)},
        )

    @torch.no_grad()
    def collect(self, policy: Policy) -> Rollout:
        shape = (STEPS, ENVIRONMENTS)
        seen = torch.zeros(*shape, self.size)
        actions, log_probs = torch.zeros(*shape, self.space.shape[0]), torch.zeros(shape)
        rewards, final = torch.zeros(shape), torch.zeros(shape)
        terminated, truncated = torch.zeros(2, *shape, dtype=torch.bool)
        for t in range(STEPS):
            seen[t] = _tensor(self.observation)
            distribution = policy.distribution({"state": seen[t]})
            actions[t] = distribution.sample(self.streams)
            log_probs[t] = distribution.log_prob(actions[t])
            clipped = np.clip(actions[t].numpy(), self.space.low, self.space.high)
            self.observation, reward, ended, cut, info = self.environments.step(clipped)
            rewards[t] = _tensor(reward)
            terminated[t], truncated[t] = torch.as_tensor(ended), torch.as_tensor(cut & ~ended)
            if truncated[t].any():
                none = np.zeros(self.size, np.float32)
                last = np.stack([x if x is not None else none for x in info["final_obs"]])
                final[t] = torch.where(truncated[t], policy.value({"state": _tensor(last)}), 0.0)
        return Rollout(
            observations={"state": seen},
            last_observations={"state": _tensor(self.observation)},
            actions=actions,
            log_probs=log_probs,
            rewards=rewards,
            terminated=terminated,
            truncated=truncated,
            failed=terminated,
            final_values=final,
            episode_returns=torch.zeros(shape),
            fields={},
        )


def _tensor(value: np.ndarray) -> Tensor:
    return torch.as_tensor(value, dtype=torch.float32)


def train_ours(task: str, samples: int, seed: int, kind: Any, options: Any) -> float:
    """Mean return of the deterministic policy that a learner of this `kind` makes with its `options` of `samples`."""
    collector = Collector(task, seed)
    with private_rng(seed, "policy"):
        networks = MLPPolicy.Options(
            hidden=HIDDEN, activation="tanh", noise=Schedule(1.0, 1.0), learn_noise=True
        )
        policy = MLPPolicy(networks, collector.context)
    learner: Learner = kind(options, collector.context, policy)
    for _ in range(samples // (ENVIRONMENTS * STEPS)):
        rollout = collector.collect(policy)
        learner.update(rollout)
        policy.observe(rollout.observations)
    collector.environments.close()

    def act(value: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return policy.distribution({"state": _tensor(value[None])}).mode()[0].numpy()

    return evaluate(task, act, seed)


def train_peer(task: str, samples: int, seed: int, algorithm: Any, **hyperparameters: Any) -> float:
    """Mean return of a Stable-Baselines3 algorithm's deterministic policy after `samples`."""
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import VecNormalize

    environments = VecNormalize(
        make_vec_env(task, ENVIRONMENTS, seed=seed), norm_obs=True, norm_reward=False, clip_obs=5.0
    )
    peer = algorithm(
        "MlpPolicy",
        environments,
        n_steps=STEPS,
        policy_kwargs={"net_arch": list(HIDDEN)},
        seed=seed,
        device="cpu",
        **hyperparameters,
    )
    peer.learn(samples)

    def act(value: np.ndarray) -> np.ndarray:
        return peer.predict(environments.normalize_obs(value), deterministic=True)[0]

    return evaluate(task, act, seed)


def evaluate(task: str, act: Callable[[np.ndarray], Any], seed: int, episodes: int = 20) -> float:
    """Mean return of `episodes` whose starts depend on `seed`."""
    environment = gymnasium.make(task)
    space = environment.action_space
    assert isinstance(space, gymnasium.spaces.Box)
    returns = []
    for episode in range(episodes):
        observation, _ = environment.reset(seed=10_000 * (seed + 1) + episode)
        total, over = 0.0, False
        while not over:
            action = np.clip(act(observation), space.low, space.high)
            observation, reward, ended, cut, _ = environment.step(action)
            total += float(reward)
            over = ended or cut
        returns.append(total)
    environment.close()
    return statistics.fmean(returns)


def compare(
    description: str,
    kind: Any,
    own_options: Any,
    peer: str,
    hyperparameters: Mapping[str, Any],
    out: Path,
) -> None:
    """Train a learner of this `kind` with `own_options`, and the algorithm `peer` (``module:name``) with its `hyperparameters`, with every seed;
    print returns and means, append them to `out`."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--task", default="Hopper-v5")
    parser.add_argument("--samples", type=int, default=200_000)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3])
    parser.add_argument("--only", choices=("ours", "sb3"))
    parser.add_argument("--out", type=Path, default=out)
    options = parser.parse_args()

    def ours(seed: int) -> float:
        return train_ours(options.task, options.samples, seed, kind, own_options)

    def theirs(seed: int) -> float:
        algorithm = pkgutil.resolve_name(peer)
        return train_peer(options.task, options.samples, seed, algorithm, **hyperparameters)

    found: dict[str, list[float]] = {}
    for name, train in (("ours", ours), ("sb3", theirs)):
        if options.only not in (None, name):
            continue
        for seed in options.seeds:
            began = time.perf_counter()
            found.setdefault(name, []).append(train(seed))
            took = time.perf_counter() - began
            print(f"{name} seed {seed}: {found[name][-1]:.1f} ({took:.0f} s)", flush=True)
    for name, values in found.items():
        error = statistics.stdev(values) / len(values) ** 0.5 if len(values) > 1 else float("nan")
        print(
            f"{name}: {statistics.fmean(values):.1f} ± {error:.1f} (standard error, {len(values)} seeds)"
        )
    record = {
        "when": time.strftime("%Y-%m-%d"),
        "task": options.task,
        "samples": options.samples,
        "seeds": options.seeds,
        "returns": found,
        "versions": versions(),
    }
    append(options.out, record)
