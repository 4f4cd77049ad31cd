"""Our PPO against Stable-Baselines3's on one Gymnasium task: return at the same number of samples.

Both get the same hyper-parameters, networks, number of environments and evaluation. Prints each
seed's mean return and both means with standard errors, and appends them to
``docs/benchmarks/ppo_vs_sb3.jsonl``.
"""

from __future__ import annotations

from peers import ENVIRONMENTS, RESULTS, STEPS, compare

from understudy_ppo.learner import PPO

EPOCHS, MINIBATCHES = 10, 32
GAMMA, LAMBDA, RATE, CLIP = 0.99, 0.95, 3e-4, 0.2

OURS = PPO.Options(
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
)
#: The same, by the peer's names.
THEIRS = {
    "batch_size": ENVIRONMENTS * STEPS // MINIBATCHES,
    "n_epochs": EPOCHS,
    "gamma": GAMMA,
    "gae_lambda": LAMBDA,
    "learning_rate": RATE,
    "clip_range": CLIP,
}


if __name__ == "__main__":
    compare(__doc__ or "", PPO, OURS, "stable_baselines3:PPO", THEIRS, RESULTS / "ppo_vs_sb3.jsonl")
