"""Our TRPO against sb3-contrib's on one Gymnasium task: return at the same number of samples.

Both get the same hyper-parameters (sb3-contrib's defaults), networks, number of environments and
evaluation. Prints each seed's mean return and both means with standard errors, and appends them to
``docs/benchmarks/trpo_vs_sb3.jsonl``.
"""

from __future__ import annotations

from peers import RESULTS, STEPS, compare

from understudy_trpo.learner import TRPO

GAMMA, LAMBDA, KL_LIMIT, RATE = 0.99, 0.95, 0.01, 1e-3
CG_STEPS, DAMPING, SEARCH_STEPS, SHRINK = 15, 0.1, 10, 0.8
VALUE_EPOCHS, VALUE_BATCH = 10, 128

OURS = TRPO.Options(
    rollout_steps=STEPS,
    gamma=GAMMA,
    gae_lambda=LAMBDA,
    td_lambda=LAMBDA,
    kl_limit=KL_LIMIT,
    conjugate_gradient_steps=CG_STEPS,
    damping=DAMPING,
    line_search_steps=SEARCH_STEPS,
    line_search_shrink=SHRINK,
    value_epochs=VALUE_EPOCHS,
    value_batch_size=VALUE_BATCH,
    critic_learning_rate=RATE,
)
#: The same, by the peer's names.
THEIRS = {
    "batch_size": VALUE_BATCH,
    "gamma": GAMMA,
    "gae_lambda": LAMBDA,
    "target_kl": KL_LIMIT,
    "learning_rate": RATE,
    "cg_max_steps": CG_STEPS,
    "cg_damping": DAMPING,
    "line_search_max_iter": SEARCH_STEPS,
    "line_search_shrinking_factor": SHRINK,
    "n_critic_updates": VALUE_EPOCHS,
}


if __name__ == "__main__":
    compare(__doc__ or "", TRPO, OURS, "sb3_contrib:TRPO", THEIRS, RESULTS / "trpo_vs_sb3.jsonl")
