"""Our PPO against Stable-Baselines3's on one Gymnasium task: return at the same number of samples.

Both get the same hyper-parameters, networks, number of environments and evaluation. Prints each
seed's mean return and both means with standard errors, and appends them to
``docs/benchmarks/ppo_vs_sb3.jsonl``.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from understudy.nn import Schedule
from understudy.random import WorldStreams, private_rng
from understudy.records.runs import versions
from understudy.task import Context, Rollout
from understudy_ppo.learner import PPO
from understudy_ppo.policy import MLPPolicy

RESULTS = Path(__file__).resolve().parents[1] / "docs" / "benchmarks" / "ppo_vs_sb3.jsonl"
ENVIRONMENTS, STEPS, EPOCHS, MINIBATCHES = 8, 256, 10, 32
GAMMA, LAMBDA, RATE, CLIP = 0.99, 0.95, 3e-4, 0.2
HIDDEN = (64, 64)


def train_ours(task: str, samples: int, seed: int) -> float:
    """Mean return of the deterministic policy after `samples`."""
    environments = SyncVectorEnv(
        [lambda: gymnasium.make(task)] * ENVIRONMENTS, autoreset_mode=AutoresetMode.SAME_STEP
    )
    space = environments.single_action_space
    assert isinstance(space, gymnasium.spaces.Box)
    size = int(np.prod(environments.single_observation_space.shape or ()))
    context = Context(
        seed=seed,
        device=torch.device("cpu"),
        num_worlds=ENVIRONMENTS,
        control_dt=1.0,
        substeps=1,
        action_size=space.shape[0],
        observation_shapes={"state": (size,)},
    )
    with private_rng(seed, "policy"):
        policy = MLPPolicy(
            MLPPolicy.Options(
                hidden=HIDDEN, activation="tanh", noise=Schedule(1.0, 1.0), learn_noise=True
            ),
            context,
        )
    learner = PPO(
        PPO.Options(
            rollout_steps=STEPS,
            epochs=EPOCHS,
            minibatches=MINIBATCHES,
            gamma=GAMMA,
            gae_lambda=LAMBDA,
            td_lambda=LAMBDA,
            clip=CLIP,
            actor_learning_rate=RATE,
            critic_learning_rate=RATE,
            max_gradient_norm=0.5,
        ),
        context,
        policy,
    )
    streams = WorldStreams(seed, "actions", ENVIRONMENTS, "cpu")
    observation, _ = environments.reset(seed=seed)
    for _ in range(samples // (ENVIRONMENTS * STEPS)):
        rollout, observation = _collect(environments, policy, streams, observation, space, size)
        learner.update(rollout)
        policy.observe(rollout.observations)
    environments.close()

    def act(value: np.ndarray) -> np.ndarray:
        seen = {"state": torch.as_tensor(value[None], dtype=torch.float32)}
        with torch.no_grad():
            return policy.distribution(seen).mode()[0].numpy()

    return evaluate(task, act, seed)


def _collect(
    environments: SyncVectorEnv,
    policy: MLPPolicy,
    streams: WorldStreams,
    observation: np.ndarray,
    space: gymnasium.spaces.Box,
    size: int,
) -> tuple[Rollout, np.ndarray]:
    shape = (STEPS, ENVIRONMENTS)
    seen = torch.zeros(*shape, size)
    actions, log_probs = torch.zeros(*shape, space.shape[0]), torch.zeros(shape)
    rewards, final = torch.zeros(shape), torch.zeros(shape)
    terminated = torch.zeros(shape, dtype=torch.bool)
    truncated = torch.zeros(shape, dtype=torch.bool)
    with torch.no_grad():
        for t in range(STEPS):
            seen[t] = torch.as_tensor(observation, dtype=torch.float32)
            distribution = policy.distribution({"state": seen[t]})
            actions[t] = distribution.sample(streams)
            log_probs[t] = distribution.log_prob(actions[t])
            clipped = np.clip(actions[t].numpy(), space.low, space.high)
            observation, reward, ended, cut, info = environments.step(clipped)
            rewards[t] = torch.as_tensor(reward, dtype=torch.float32)
            terminated[t], truncated[t] = torch.as_tensor(ended), torch.as_tensor(cut & ~ended)
            if truncated[t].any():
                last = np.stack(
                    [x if x is not None else np.zeros(size, np.float32) for x in info["final_obs"]]
                )
                values = policy.value({"state": torch.as_tensor(last, dtype=torch.float32)})
                final[t] = torch.where(truncated[t], values, 0.0)
    after = {"state": torch.as_tensor(observation, dtype=torch.float32)}
    return (
        Rollout(
            {"state": seen}, after, actions, log_probs, rewards, terminated, truncated, final, {}
        ),
        observation,
    )


def train_sb3(task: str, samples: int, seed: int) -> float:
    from stable_baselines3 import PPO as PeerPPO
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import VecNormalize

    environments = VecNormalize(
        make_vec_env(task, ENVIRONMENTS, seed=seed), norm_obs=True, norm_reward=False, clip_obs=5.0
    )
    peer = PeerPPO(
        "MlpPolicy",
        environments,
        n_steps=STEPS,
        batch_size=ENVIRONMENTS * STEPS // MINIBATCHES,
        n_epochs=EPOCHS,
        gamma=GAMMA,
        gae_lambda=LAMBDA,
        learning_rate=RATE,
        clip_range=CLIP,
        policy_kwargs={"net_arch": list(HIDDEN)},
        seed=seed,
        device="cpu",
    )
    peer.learn(samples)

    def act(value: np.ndarray) -> np.ndarray:
        return peer.predict(environments.normalize_obs(value), deterministic=True)[0]

    return evaluate(task, act, seed)


def evaluate(task: str, act: Any, seed: int, episodes: int = 20) -> float:
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


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--task", default="Hopper-v5")
    parser.add_argument("--samples", type=int, default=200_000)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3])
    parser.add_argument("--only", choices=("ours", "sb3"))
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    found: dict[str, list[float]] = {}
    for name, train in (("ours", train_ours), ("sb3", train_sb3)):
        if options.only not in (None, name):
            continue
        for seed in options.seeds:
            began = time.perf_counter()
            found.setdefault(name, []).append(train(options.task, options.samples, seed))
            print(
                f"{name} seed {seed}: {found[name][-1]:.1f} ({time.perf_counter() - began:.0f} s)",
                flush=True,
            )
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
    with open(options.out, "a", encoding="utf-8") as file:
        file.write(json.dumps(record) + "\n")


if __name__ == "__main__":
    main()
