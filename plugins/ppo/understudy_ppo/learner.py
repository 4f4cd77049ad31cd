"""Clipped proximal policy optimisation (Schulman et al. 2017)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn

from understudy import distributed
from understudy.errors import ConfigError, TrainingError
from understudy.options import check_range
from understudy.random import generator
from understudy.task import Context, Learner, Policy, Rollout, State
from understudy_ppo.graphs import Captured
from understudy_ppo.returns import lambda_advantages

#: By what an adaptive learning rate changes in an update, and its limits.
RATE_STEP, RATE_RANGE = 1.5, (1e-6, 1e-2)


class PPO(Learner):
    """Clipped surrogate, TD(lambda) value targets, GAE(lambda) advantages.

    Defaults are the thesis' (section 3.5) where they carry over: gamma, lambda, 4096 samples an
    iteration with 256 worlds. Its learning rates are for plain gradient descent; with Adam the
    actor's is 1e-4 or so.
    """

    @dataclass(frozen=True)
    class Options:
        rollout_steps: int = 16  #: T, steps per world and iteration
        epochs: int = 4
        #: Optimiser steps per epoch; each sees its share of the iteration's samples.
        minibatches: int = 8
        gamma: float = 0.95
        gae_lambda: float = 0.95
        td_lambda: float = 0.95
        clip: float = 0.2
        actor_learning_rate: float = 1e-4
        critic_learning_rate: float = 1e-3
        entropy_weight: float = 0.0
        max_gradient_norm: float = 1.0
        #: Adapt the actor's learning rate so that an update's mean KL divergence from the policy that
        #: collected stays within a factor of two of this; null keeps the rate. The rule is the one
        #: of Schulman et al. (section 4) for the penalty, applied to the rate.
        target_kl: float | None = None
        #: Number format of the networks' matrix products during updates.
        precision: Literal["float32", "tf32"] = "float32"
        #: Non-finite optimiser steps in a row after which the training stops.
        patience: int = 20

        def __post_init__(self) -> None:
            check_range(self, "rollout_steps", "epochs", "minibatches", "patience", least=1)
            check_range(self, "gamma", "gae_lambda", "td_lambda", least=0, most=1)
            check_range(self, "clip", "actor_learning_rate", "critic_learning_rate", above=0)
            check_range(self, "max_gradient_norm", "target_kl", above=0)
            check_range(self, "entropy_weight", least=0)

    def __init__(self, options: Options, context: Context, policy: Policy) -> None:
        samples = options.rollout_steps * context.num_worlds
        if samples < 2:
            raise ConfigError(
                "One sample an iteration is too few: raise num_worlds or learner.rollout_steps."
            )
        if options.minibatches > samples:
            raise ConfigError(
                f"learner.minibatches={options.minibatches} are more than the samples of an iteration: "
                f"num_worlds × learner.rollout_steps = {samples}."
            )
        # The process's setting, so that acting and learning compute alike.
        torch.backends.cuda.matmul.allow_tf32 = options.precision == "tf32"
        self.options, self.policy = options, policy
        self.rollout_steps = options.rollout_steps
        self._actor = list(policy.actor_parameters())
        self._critic = list(policy.critic_parameters())
        on_gpu = context.device.type == "cuda"
        self._rate = options.actor_learning_rate
        self._rate_on_device = torch.tensor(self._rate, device=context.device)
        self._actor_optimiser = torch.optim.Adam(
            self._actor, self._rate_on_device, fused=True, capturable=on_gpu
        )
        self._critic_optimiser = torch.optim.Adam(
            self._critic, options.critic_learning_rate, fused=True, capturable=on_gpu
        )
        self._generator = generator(context.seed, "ppo", context.device)
        #: () optimiser steps in a row that were not finite.
        self._bad_steps = torch.zeros((), dtype=torch.int64, device=context.device)
        #: (6,) a minibatch's losses, entropy, KL divergence, clipped share, and 1; sums of sound ones.
        self._row, self._sums = torch.zeros(2, 6, device=context.device)
        self._capture()

    def _capture(self) -> None:
        """Forget recorded steps: they hold the addresses of the optimisers' state."""
        device = self._row.device
        self._captured_differentiate = Captured(self._differentiate, device)
        self._captured_apply = Captured(lambda _: self._apply(), device)

    def update(self, rollout: Rollout) -> dict[str, float]:
        advantages = self._digest(rollout)
        assert rollout.returns is not None
        returns = rollout.returns.flatten()
        _, mean, variance = distributed.moments(advantages.view(-1, 1))
        flat = {
            f"observations/{name}": value.flatten(0, 1)
            for name, value in rollout.observations.items()
        }
        flat |= {
            "actions": rollout.actions.flatten(0, 1),
            "log_probs": rollout.log_probs.flatten(),
            "returns": returns,
            "advantages": (advantages.flatten() - mean) / (variance.sqrt() + 1e-5),
        }
        options, device = self.options, returns.device
        self._sums.zero_()
        used = returns.shape[0] // options.minibatches * options.minibatches
        for _ in range(options.epochs):
            order = torch.randperm(returns.shape[0], generator=self._generator, device=device)
            for rows in order[:used].view(options.minibatches, -1):
                self._captured_differentiate(flat, rows)
                if distributed.size() > 1:
                    parameters = [*self._actor, *self._critic]
                    self._row.copy_(distributed.average_gradients(parameters, self._row))
                self._captured_apply({}, rows)
                self._report_fault(flat, rows)
        *totals, taken = self._sums.tolist()  # the update's one wait for the device
        actor_loss, value_loss, entropy, kl, outside = (x / max(1.0, taken) for x in totals)
        self._refuse_hopeless()
        variance = returns.var() + 1e-8
        explained = (
            1 - (returns - rollout.values.flatten()).var() / variance
            if rollout.values is not None
            else 0.0
        )
        return {
            "actor_loss": actor_loss,
            "value_loss": value_loss,
            "entropy": entropy,
            "kl": kl,
            "clipped": outside,
            "explained_variance": float(explained),
            "actor_learning_rate": self._adapt_rate(kl),
            "skipped_steps": options.epochs * options.minibatches - taken,
        }

    def losses(self, minibatch: Mapping[str, Tensor]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Actor loss, value loss, entropy, and the probability ratios (B,), of a minibatch such as
        a fault dump holds: ``observations/…``, ``actions``, ``log_probs``, ``returns``,
        ``advantages``."""
        prefix, options, advantages = "observations/", self.options, minibatch["advantages"]
        seen = {k.removeprefix(prefix): v for k, v in minibatch.items() if k.startswith(prefix)}
        distribution, values = self.policy.distribution(seen), self.policy.value(seen)
        ratio = torch.exp(distribution.log_prob(minibatch["actions"]) - minibatch["log_probs"])
        clipped = ratio.clamp(1 - options.clip, 1 + options.clip)
        gain = torch.minimum(ratio * advantages, clipped * advantages).mean()
        entropy = distribution.entropy().mean()
        value_loss = (values - minibatch["returns"]).square().mean()
        return -gain - options.entropy_weight * entropy, value_loss, entropy, ratio

    @torch.no_grad()
    def _digest(self, rollout: Rollout) -> Tensor:
        """Set the rollout's values and TD(lambda) returns; return the advantages, all (T, N)."""
        last = {k: v.unsqueeze(0) for k, v in rollout.last_observations.items()}
        values = self.policy.value(
            {k: torch.cat([v, last[k]]) for k, v in rollout.observations.items()}
        )
        values, following = values[:-1], values[1:]
        ended = rollout.terminated | rollout.truncated
        next_values = torch.where(ended, rollout.final_values, following)
        continues = (~ended).float()
        options = self.options

        def estimate(lam: float) -> Tensor:
            return lambda_advantages(
                rollout.rewards, values, next_values, continues, gamma=options.gamma, lam=lam
            )

        advantages = estimate(options.gae_lambda)
        same = options.td_lambda == options.gae_lambda
        rollout.values = values
        rollout.returns = values + (advantages if same else estimate(options.td_lambda))
        return advantages

    def _differentiate(self, minibatch: Mapping[str, Tensor]) -> None:
        """Set the gradients and the statistics of `minibatch`."""
        for optimiser in (self._actor_optimiser, self._critic_optimiser):
            optimiser.zero_grad(set_to_none=True)
        actor_loss, value_loss, entropy, ratio = self.losses(minibatch)
        (actor_loss + value_loss).backward()
        with torch.no_grad():
            kl = (ratio - 1 - ratio.log()).mean()  # Schulman's k3 estimator
            outside = ((ratio - 1).abs() > self.options.clip).float().mean()
            row = [actor_loss, value_loss, entropy, kl, outside, torch.ones_like(kl)]
            self._row.copy_(torch.stack(row))

    @torch.no_grad()
    def _apply(self) -> None:
        """One optimiser step; if losses or gradients are not finite, nothing changes but the count.

        The optimisers skip on the device by ``found_inf``, so a GPU is not waited for.
        """
        norm = self.options.max_gradient_norm
        norms = [nn.utils.clip_grad_norm_(group, norm) for group in (self._actor, self._critic)]
        sound = torch.isfinite(torch.cat([torch.stack(norms), self._row[:2]])).all()
        for optimiser in (self._actor_optimiser, self._critic_optimiser):
            optimiser.found_inf = (~sound).float()  # pyright: ignore[reportAttributeAccessIssue]
            optimiser.step()
        self._bad_steps.copy_(torch.where(sound, 0, self._bad_steps + 1))
        self._sums += torch.where(sound, self._row, 0.0)

    def _report_fault(self, batch: Mapping[str, Tensor], rows: Tensor) -> None:
        """Hand out the first minibatch that went wrong; on a GPU that would cost a wait in each step."""
        if rows.device.type == "cpu" and self.on_fault is not None and int(self._bad_steps):
            self.on_fault({name: value[rows] for name, value in batch.items()})
            self.on_fault = None

    def _adapt_rate(self, kl: float) -> float:
        """Bring the actor's learning rate a step towards ``target_kl``; returns the rate."""
        target = self.options.target_kl
        if target is not None:
            if not kl <= 2 * target:  # also where it is not finite
                self._rate /= RATE_STEP
            elif kl < target / 2:
                self._rate *= RATE_STEP
            self._rate = min(max(self._rate, RATE_RANGE[0]), RATE_RANGE[1])
            self._rate_on_device.fill_(self._rate)
        return self._rate

    def _refuse_hopeless(self) -> None:
        bad = int(self._bad_steps)
        if bad >= self.options.patience:
            raise TrainingError(
                f"{bad} optimiser steps in a row had a non-finite loss or gradient. The usual causes "
                "are too high a learning rate, or rewards that are huge; the weights are those before "
                "the first of them."
            )

    def state_dict(self) -> State:
        return {
            "actor": _optimiser_state(self._actor_optimiser),
            "critic": _optimiser_state(self._critic_optimiser),
            "actor_rate": self._rate,
            "generator": self._generator.get_state(),
        }

    def load_state_dict(self, state: State) -> None:
        _load_optimiser(self._actor_optimiser, state["actor"])
        _load_optimiser(self._critic_optimiser, state["critic"])
        self._rate = state["actor_rate"]
        self._rate_on_device.fill_(self._rate)
        self._generator.set_state(state["generator"].cpu())
        self._capture()


def _parameters(optimiser: torch.optim.Optimizer) -> Iterable[nn.Parameter]:
    return optimiser.param_groups[0]["params"]


def _optimiser_state(optimiser: torch.optim.Optimizer) -> State:
    """Adam's moments by parameter position; empty before the first step."""
    return {
        str(i): {k: v.clone() for k, v in optimiser.state[p].items()}
        for i, p in enumerate(_parameters(optimiser))
        if p in optimiser.state
    }


def _load_optimiser(optimiser: torch.optim.Optimizer, state: State) -> None:
    for i, p in enumerate(_parameters(optimiser)):
        if str(i) in state:
            optimiser.state[p] = {k: v.clone().to(p.device) for k, v in state[str(i)].items()}
