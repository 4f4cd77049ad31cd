"""Trust region policy optimisation (Schulman et al. 2015)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.random import generator
from understudy.task import Context, Rollout, State
from understudy_networks import averages, optimisers
from understudy_networks.nn import set_precision
from understudy_networks.returns import digest, explained_variance, observations_of
from understudy_reinforcement.learner import Learner
from understudy_reinforcement.policy import Distribution, Policy
from understudy_trpo.natural_gradient import (
    Product,
    conjugate_gradient,
    gradient,
    hessian_product,
    line_search,
)

#: Samples of a critic's step at least, and its steps of an epoch at most, unless said otherwise: with more, thousands of
#: worlds spend the time of an iteration on steps that a GPU does in no less than a small one's time.
_VALUE_BATCH, _VALUE_STEPS = 128, 64


class TRPO(Learner):
    """One natural-gradient step of the policy an iteration, within a KL limit; a critic by Adam.

    maximise E[π/π_old A] subject to E[KL(π_old, π)] ≤ δ (eq. 14): the direction s solves F s = g by
    conjugate gradient, the full step is sqrt(2 δ / sᵀF s) s (appendix C), and a line search shortens
    it until the surrogate improves within the limit.
    """

    @dataclass(frozen=True)
    class Options:
        rollout_steps: int = 64  #: T, steps per world and iteration
        gamma: float = 0.99  #: discount of a decision, in [0, 1]
        gae_lambda: float = 0.95  #: λ of the advantages, in [0, 1]
        td_lambda: float = 0.95  #: λ of the critic's targets, in [0, 1]
        #: δ, the greatest mean KL divergence of an update (Schulman et al. 2015, section 8)
        kl_limit: float = 0.01
        #: iterations of the solver of a step's direction (appendix C)
        conjugate_gradient_steps: int = 10
        damping: float = 0.1  #: number that is added to the diagonal of the Fisher matrix
        #: Share of the samples, evenly taken, that the Fisher matrix is estimated from (appendix C.1).
        fisher_share: float = 1.0
        line_search_steps: int = 10  #: most tries of the line search, from 1
        line_search_shrink: float = 0.8  #: factor by which each try shortens the step, in (0, 0.99]
        value_epochs: int = 10  #: passes over the iteration's samples to fit the critic
        #: samples of an optimiser step of the critic, in each process; null: 128, or a 64th of an
        #: iteration's if that is more
        value_batch_size: int | None = None
        critic_learning_rate: float = 1e-3  #: learning rate of the critic, by Adam, above 0
        #: Updates in a row with a non-finite step after which the training stops.
        patience: int = 3

        def __post_init__(self) -> None:
            check_range(self, "rollout_steps", least=1, most=100_000)
            check_range(self, "conjugate_gradient_steps", least=1)
            check_range(self, "line_search_steps", "value_epochs", least=1)
            if self.value_batch_size is not None:
                check_range(self, "value_batch_size", least=1)
            check_range(self, "patience", least=1)
            check_range(self, "gamma", "gae_lambda", "td_lambda", least=0, most=1)
            check_range(self, "kl_limit", "critic_learning_rate", above=0)
            check_range(self, "damping", least=0)
            check_range(self, "fisher_share", above=0, most=1)
            check_range(self, "line_search_shrink", above=0, most=0.99)

    def __init__(self, options: Options, context: Context, policy: Policy) -> None:
        samples = options.rollout_steps * context.num_worlds
        if samples < 2:
            raise ConfigError(
                "One sample an iteration is too few: raise num_worlds or learner.rollout_steps."
            )
        batch = options.value_batch_size or min(samples, max(_VALUE_BATCH, samples // _VALUE_STEPS))
        if batch > samples:
            raise ConfigError(
                f"learner.value_batch_size={batch} is more than the samples of an "
                f"iteration: num_worlds × learner.rollout_steps = {samples}."
            )
        set_precision(policy, "float32", twice=True)
        self.options, self.policy = options, policy
        self.rollout_steps, self._value_batch = options.rollout_steps, batch
        self._actor = list(policy.actor_parameters())
        self._critic = list(policy.critic_parameters())
        rate = torch.tensor(options.critic_learning_rate, device=context.device)
        self._optimiser = optimisers.adam(self._critic, rate)
        self._generator = generator(context.seed, "trpo", context.device)
        self._bad_updates = 0  # in a row

    def update(self, rollout: Rollout) -> dict[str, float]:
        options = self.options
        batch = digest(rollout, self.policy, options.gamma, options.gae_lambda, options.td_lambda)
        metrics = self._improve_policy(batch) | self._fit_values(batch)
        skipped = metrics.pop("skipped_policy_steps") + metrics.pop("skipped_value_steps")
        self._note_faults(batch, skipped)
        return metrics | {
            "explained_variance": explained_variance(rollout),
            "skipped_steps": skipped,
        }

    def surrogate(self, batch: Mapping[str, Tensor], distribution: Distribution) -> Tensor:
        """() E[π(a|s) / π_old(a|s) A]."""
        ratio = torch.exp(distribution.log_prob(batch["actions"]) - batch["log_probs"])
        return (ratio * batch["advantages"]).mean()

    def _fisher(self, seen: Mapping[str, Tensor]) -> Product:
        """v ↦ (F + damping I) v, F the mean Fisher matrix over the observations `seen`."""
        distribution = self.policy.distribution(seen)
        kl = distribution.map(Tensor.detach).divergence(distribution).mean()
        product = hessian_product(kl, self._actor)
        return lambda v: averages.mean(product(v)) + self.options.damping * v

    def _improve_policy(self, batch: Mapping[str, Tensor]) -> dict[str, float]:
        """The step within the trust region; returns metrics."""
        options, seen = self.options, observations_of(batch)
        distribution = self.policy.distribution(seen)
        before = self.surrogate(batch, distribution)
        g = averages.mean(gradient(before, self._actor))
        every = max(1, round(1 / options.fisher_share))
        fisher = self._fisher({name: value[::every] for name, value in seen.items()})
        s = conjugate_gradient(fisher, g, options.conjugate_gradient_steps)
        full_step = torch.sqrt(2 * options.kl_limit / (s @ fisher(s))) * s

        old = distribution.map(Tensor.detach)
        values = {"gain": 0.0, "kl": 0.0, "entropy": float(old.entropy().mean())}
        metrics = {**values, "step_share": 0.0, "skipped_policy_steps": 0.0}
        if not torch.isfinite(full_step).all():
            at_rest = bool((g == 0).all())  # nothing to do, which is no fault
            return metrics | {"skipped_policy_steps": 0.0 if at_rest else 1.0}

        @torch.no_grad()
        def accepts() -> bool:
            new = self.policy.distribution(seen)
            gain = self.surrogate(batch, new) - before
            found = torch.stack([gain, old.divergence(new).mean(), new.entropy().mean()])
            values.update(zip(values, averages.mean(found).tolist(), strict=True))
            return values["gain"] > 0 and values["kl"] <= options.kl_limit  # false for NaN

        share = line_search(
            self._actor,
            full_step,
            accepts,
            shrink=options.line_search_shrink,
            attempts=options.line_search_steps,
        )
        return {**metrics, **values, "step_share": share} if share else metrics

    def _fit_values(self, batch: Mapping[str, Tensor]) -> dict[str, float]:
        """Regress the values on the returns; returns metrics."""
        seen, returns = observations_of(batch), batch["returns"]
        losses, sound_steps, steps = torch.zeros_like(returns[0]), 0.0, 0
        for _ in range(self.options.value_epochs):
            for rows in self._minibatches(returns):
                values = self.policy.value({name: value[rows] for name, value in seen.items()})
                loss = (values - returns[rows]).square().mean()
                self._optimiser.zero_grad(set_to_none=True)
                loss.backward()
                loss = averages.average_gradients(self._critic, loss.detach().view(1))
                sound = self._sound(loss)
                optimisers.step(self._optimiser, (~sound).float())
                losses = losses + torch.where(sound, loss[0], 0.0)
                sound_steps = sound_steps + sound.to(losses.dtype)
                steps += 1
        taken = float(sound_steps)
        loss = float(losses) / max(1.0, taken)
        return {"value_loss": loss, "skipped_value_steps": steps - taken}

    def _sound(self, loss: Tensor) -> Tensor:
        gradients = [p.grad for p in self._critic if p.grad is not None]
        return torch.isfinite(torch.cat([nn.utils.get_total_norm(gradients).view(1), loss])).all()

    def _minibatches(self, like: Tensor) -> Iterator[Tensor]:
        """One epoch's rows in a random order, in parts; the last one may be smaller."""
        order = torch.randperm(like.shape[0], generator=self._generator, device=like.device)
        return iter(order.split(self._value_batch))

    def _note_faults(self, batch: Mapping[str, Tensor], skipped: float) -> None:
        """Hand out the first batch that had a non-finite step; refuse too many in a row."""
        self._bad_updates = self._bad_updates + 1 if skipped else 0
        if skipped and self.on_fault is not None:
            self.on_fault(batch)
            self.on_fault = None
        optimisers.refuse_hopeless(self._bad_updates, self.options.patience, "updates")

    def state_dict(self) -> State:
        return {
            "critic": optimisers.state_of(self._optimiser),
            "generator": self._generator.get_state(),
            "bad_updates": self._bad_updates,
        }

    def load_state_dict(self, state: State) -> None:
        optimisers.load_state(self._optimiser, state["critic"])
        self._generator.set_state(state["generator"].cpu())
        self._bad_updates = int(state["bad_updates"])
        if self._bad_updates < 0:
            raise ValueError(f"'bad_updates' cannot be {self._bad_updates}")
