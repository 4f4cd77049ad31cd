"""Proximal policy optimisation (Schulman et al. 2017)."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn

from understudy import distributed
from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.random import generator
from understudy.task import Context, Rollout, State
from understudy_networks import averages, optimisers
from understudy_networks.graphs import Captured
from understudy_networks.nn import Precision, set_precision
from understudy_networks.returns import digest, explained_variance, observations_of
from understudy_ppo.losses import KLPenalty, clipped_surrogate
from understudy_ppo.threads import SideBySide
from understudy_reinforcement.learner import Learner
from understudy_reinforcement.policy import Distribution, Policy

#: By what an adaptive learning rate changes in an update, and its limits.
RATE_STEP, RATE_RANGE = 1.5, (1e-6, 1e-2)
#: Limits of the KL penalty's coefficient, so that a long stay on one side can be undone.
COEFFICIENT_RANGE = (1e-4, 1e4)
#: Most optimiser steps that one CUDA graph holds: beyond, capturing costs more than launching saves.
STEPS_A_GRAPH = 32

#: The row of a minibatch: entropy, KL divergence, clipped share, the losses of actor and critic, the
#: norms of their gradients, and 1.
LOSSES_AND_NORMS, NORMS, COUNT = slice(3, 7), slice(5, 7), 7

_OLD = "old/"


class Losses(NamedTuple):
    """Of a minibatch of B samples."""

    actor: Tensor  #: ()
    value: Tensor  #: ()
    entropy: Tensor  #: ()
    ratio: Tensor  #: (B,) π(a|s) / π_old(a|s)


class PPO(Learner):
    """Clipped surrogate, KL penalty, or both; TD(lambda) value targets, GAE(lambda) advantages.

    Defaults are the thesis' (section 3.5) where they carry over: gamma, lambda, 4096 samples an
    iteration with 256 worlds. Its learning rates are for plain gradient descent; with Adam the
    actor's is 1e-4 or so.
    """

    @dataclass(frozen=True)
    class Options:
        rollout_steps: int = 16  #: T, steps per world and iteration
        epochs: int = 4  #: passes over each iteration's samples, from 1
        #: Optimiser steps per epoch; each sees its share of the iteration's samples.
        minibatches: int | None = 8
        #: Samples of an optimiser step, over all processes, in place of ``minibatches``.
        batch_size: int | None = None
        gamma: float = 0.95  #: discount of a decision, in [0, 1] (the thesis, section 3.5)
        gae_lambda: float = 0.95  #: λ of the advantages, in [0, 1] (the thesis, section 3.5)
        td_lambda: float = 0.95  #: λ of the critic's targets, in [0, 1] (the thesis, section 3.5)
        clip: float | None = 0.2  #: ε of the clipping; null leaves it to ``kl_penalty``
        #: a penalty on the divergence from the old policy; null has none
        kl_penalty: KLPenalty | None = None
        optimiser: Literal["adam", "sgd"] = "adam"  #: the optimiser of both networks
        momentum: float = 0.0  #: momentum of sgd, from 0; Adam has its own
        weight_decay: float = 0.0  #: L2: factor of the weights that are added to their gradient
        #: learning rate of the actor's optimiser, above 0; 1e-4 suits Adam (the thesis has plain
        #: gradient descent)
        actor_learning_rate: float = 1e-4
        critic_learning_rate: float = 1e-3  #: learning rate of the critic's optimiser, above 0
        #: The first iterations, in which the critic learns alone. For an actor that comes from another run without its
        #: critic (``start.parts``): advantages mean nothing until the critic has learned its values.
        critic_first: int = 0
        #: weight of the mean entropy, which is added to the objective; from 0
        entropy_weight: float = 0.0
        #: Factor of the critic's mean squared error. It counts for sgd alone; Adam's steps have no
        #: scale.
        value_weight: float = 1.0
        #: Largest size of a normalised advantage; null sets no limit.
        advantage_clip: float | None = None
        max_gradient_norm: float = 1.0  #: largest norm of the gradient of actor and critic, each
        #: Adapt the actor's learning rate so that an update's mean KL divergence from the policy that
        #: collected stays within a factor of two of this; null keeps the rate. The rule is the one
        #: of Schulman et al. (section 4) for the penalty, applied to the rate.
        target_kl: float | None = None
        #: Number format of the networks' matrix products, acting and learning. tf32 is float32 on
        #: CPUs; bfloat16 leaves weights, optimiser and each network's last layer in float32.
        precision: Precision = "float32"
        #: Non-finite optimiser steps in a row after which the training stops.
        patience: int = 20

        def __post_init__(self) -> None:
            check_range(self, "epochs", "minibatches", "patience", least=1)
            check_range(self, "rollout_steps", least=1, most=100_000)
            check_range(self, "batch_size", least=2)
            check_range(self, "critic_first", least=0)
            check_range(self, "gamma", "gae_lambda", "td_lambda", least=0, most=1)
            check_range(self, "clip", "actor_learning_rate", "critic_learning_rate", above=0)
            check_range(self, "max_gradient_norm", "target_kl", "value_weight", above=0)
            check_range(self, "advantage_clip", above=0)
            check_range(self, "entropy_weight", "weight_decay", "momentum", least=0)
            if (self.minibatches is None) == (self.batch_size is None):
                raise ValueError(
                    f"minibatches={self.minibatches} with batch_size={self.batch_size} is not possible: "
                    "give exactly one of them and set the other to null."
                )
            if self.momentum and self.optimiser != "sgd":
                raise ValueError(
                    f"momentum={self.momentum} is not possible: it needs optimiser=sgd."
                )
            if self.clip is None and self.kl_penalty is None:
                raise ValueError(
                    "clip=null is not possible without kl_penalty: nothing would hold the policy near "
                    "the one that collected."
                )

    def __init__(self, options: Options, context: Context, policy: Policy) -> None:
        self.options, self.policy = options, policy
        self.rollout_steps = options.rollout_steps
        samples = options.rollout_steps * context.num_worlds
        self._steps, self._batch_size = _minibatches(options, samples)
        set_precision(policy, options.precision)
        device = context.device
        self._actor = list(policy.actor_parameters())
        self._critic = list(policy.critic_parameters())
        self._rate = options.actor_learning_rate
        self._updates = 0
        self._rate_on_device = torch.tensor(self._rate, device=device)
        critic_rate = torch.tensor(options.critic_learning_rate, device=device)
        self._actor_optimiser = _optimiser(options, self._actor, self._rate_on_device)
        self._critic_optimiser = _optimiser(options, self._critic, critic_rate)
        penalty = options.kl_penalty
        self._coefficient = penalty.coefficient if penalty is not None else 0.0
        self._coefficient_on_device = torch.tensor(self._coefficient, device=device)
        self._generator = generator(context.seed, "ppo", device)
        #: () optimiser steps in a row that were not finite.
        self._bad_steps = torch.zeros((), dtype=torch.int64, device=device)
        sizes = [sum(p.numel() for p in network) for network in (self._actor, self._critic)]
        room = [-(-size // 4) * 4 for size in sizes]  # 16 bytes: what kernels load at once
        #: What a minibatch makes: the gradients of actor and critic, and its row of statistics.
        self._made = torch.zeros(sum(room) + 8, device=device)
        actor, critic, self._row = self._made.split([*room, 8])
        self._actor_gradient, self._critic_gradient = actor[: sizes[0]], critic[: sizes[1]]
        optimisers.gradient_views(self._actor, self._actor_gradient)
        optimisers.gradient_views(self._critic, self._critic_gradient)
        self._row[COUNT] = 1.0
        self._sums, self._nothing = torch.zeros_like(self._row), torch.zeros((), device=device)
        #: Actor and critic; within the actor's, gradients and statistics.
        self._beside, self._aside = SideBySide(device), SideBySide(device)
        self._capture()

    def _capture(self) -> None:
        """Forget captured steps: they hold the addresses of the optimisers' state.

        A graph holds as much as lies between two averages over processes: half a step, or, in one
        process, a run of whole steps.
        """
        device, alone = self._row.device, distributed.size() == 1
        most = min(self._steps, STEPS_A_GRAPH)
        self._run_length = next(n for n in range(most, 0, -1) if self._steps % n == 0)
        self._steps_of = Captured(self._run, device) if alone else self._run
        self._gradients_of = self._differentiate if alone else Captured(self._differentiate, device)
        self._optimise = self._apply if alone else Captured(self._apply, device)

    def update(self, rollout: Rollout) -> dict[str, float]:
        options = self.options
        batch = digest(rollout, self.policy, options.gamma, options.gae_lambda, options.td_lambda)
        if options.advantage_clip is not None:
            batch["advantages"].clamp_(-options.advantage_clip, options.advantage_clip)
        if options.kl_penalty is not None:
            batch |= self._parameters(batch)
        self._rate_on_device.fill_(0.0 if self._critic_alone else self._rate)
        self._sums.zero_()
        with self._beside.sharing():
            for _ in range(options.epochs):
                for run in self._shuffled(batch):
                    self._steps_of(run)
        totals = self._sums.tolist()  # the update's one wait for the device
        taken = totals[COUNT]
        entropy, kl, outside, actor_loss, value_loss, *_ = (x / max(1.0, taken) for x in totals)
        optimisers.refuse_hopeless(int(self._bad_steps), options.patience)
        row = {
            "actor_loss": actor_loss,
            "value_loss": value_loss,
            "entropy": entropy,
            "kl": kl,
            "clipped": outside,
            "explained_variance": explained_variance(rollout),
            "actor_learning_rate": self._adapt_rate(kl),
            "skipped_steps": options.epochs * self._steps - taken,
        } | self._adapt_penalty(batch)
        self._updates += taken > 0
        return row

    @property
    def _critic_alone(self) -> bool:
        """Whether the actor stays as it is in this update."""
        return self._updates < self.options.critic_first

    @torch.no_grad()
    def _parameters(self, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Of the distributions that the policy collected with: ``old/0`` (B, K), ``old/1``, …"""
        found: list[Tensor] = []
        self.policy.distribution(observations_of(batch)).map(lambda p: found.append(p) or p)
        samples = batch["returns"].shape[0]
        return {f"{_OLD}{i}": p.expand(samples, p.shape[-1]) for i, p in enumerate(found)}

    def _shuffled(self, batch: Mapping[str, Tensor]) -> Iterator[dict[str, Tensor]]:
        """One epoch's runs of minibatches: the batch in a random order, what is left over left out."""
        samples, device = batch["returns"].shape[0], batch["returns"].device
        order = torch.randperm(samples, generator=self._generator, device=device)
        order = order[: self._steps * self._batch_size]
        shuffled = {name: value.index_select(0, order) for name, value in batch.items()}
        return _parts(shuffled, self._run_length * self._batch_size)

    def _run(self, run: Mapping[str, Tensor]) -> None:
        for minibatch in _parts(run, self._batch_size):
            self._step(minibatch)

    def _step(self, minibatch: Mapping[str, Tensor]) -> None:
        self._gradients_of(minibatch)
        averages.average(self._made)
        self._optimise({})
        self._report_fault(minibatch)

    def losses(self, minibatch: Mapping[str, Tensor]) -> Losses:
        """Of a minibatch such as a fault dump holds: ``observations/…``, ``actions``,
        ``log_probs``, ``returns``, ``advantages``, and ``old/…`` with a KL penalty."""
        actor, entropy, ratio = self._actor_loss(minibatch)
        return Losses(actor, self._value_loss(minibatch), entropy, ratio)

    def _actor_loss(self, minibatch: Mapping[str, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        options, seen = self.options, observations_of(minibatch)
        distribution = self.policy.distribution(seen)
        ratio = torch.exp(distribution.log_prob(minibatch["actions"]) - minibatch["log_probs"])
        entropy = distribution.entropy().mean()
        loss = -clipped_surrogate(ratio, minibatch["advantages"], options.clip)
        if options.entropy_weight:
            loss = loss - options.entropy_weight * entropy
        if options.kl_penalty is not None:
            divergence = _collecting(minibatch, distribution).divergence(distribution)
            loss = loss + self._coefficient_on_device * divergence.mean()
        return loss, entropy, ratio

    def _value_loss(self, minibatch: Mapping[str, Tensor]) -> Tensor:
        values = self.policy.value(observations_of(minibatch))
        return self.options.value_weight * nn.functional.mse_loss(values, minibatch["returns"])

    def _differentiate(self, minibatch: Mapping[str, Tensor]) -> None:
        """Set the gradients and the statistics of `minibatch`."""
        self._beside(
            lambda: self._differentiate_actor(minibatch),
            lambda: self._differentiate_critic(minibatch),
        )

    def _differentiate_actor(self, minibatch: Mapping[str, Tensor]) -> None:
        loss, entropy, ratio = self._actor_loss(minibatch)
        self._aside(
            lambda: optimisers.differentiate(loss, self._actor, self._actor_gradient),
            lambda: self._note(loss, entropy, ratio),
        )

    @torch.no_grad()
    def _note(self, loss: Tensor, entropy: Tensor, ratio: Tensor) -> None:
        """The actor's part of the row."""
        away = ratio - 1
        kl = (away - ratio.log()).mean()  # Schulman's k3 estimator
        clip = self.options.clip if self.options.clip is not None else torch.inf
        outside = (away.abs() > clip).to(kl.dtype).mean()
        torch.stack([entropy, kl, outside, loss], out=self._row[:4])

    def _differentiate_critic(self, minibatch: Mapping[str, Tensor]) -> None:
        loss = self._value_loss(minibatch)
        optimisers.differentiate(loss, self._critic, self._critic_gradient)
        with torch.no_grad():
            self._row[4] = loss

    @torch.no_grad()
    def _apply(self, _: Mapping[str, Tensor]) -> None:
        """One optimiser step; if losses or gradients are not finite, nothing changes but the count."""
        norms = self._row[NORMS]
        norm = torch.linalg.vector_norm
        self._beside(
            lambda: norm(self._actor_gradient, out=norms[0]),
            lambda: norm(self._critic_gradient, out=norms[1]),
        )
        largest = norm(self._row[LOSSES_AND_NORMS], ord=torch.inf)
        sound = largest < torch.inf  # false for NaN
        unsound = sound.logical_not()
        skip, over = unsound.float(), (norms / self.options.max_gradient_norm).clamp(min=1.0)
        self._beside(
            lambda: optimisers.step(self._actor_optimiser, skip, over[0]),
            lambda: optimisers.step(self._critic_optimiser, skip, over[1]),
        )
        self._bad_steps.add_(1).mul_(unsound)
        self._sums += torch.where(sound, self._row, self._nothing)

    def _report_fault(self, minibatch: Mapping[str, Tensor]) -> None:
        """Hand out the first minibatch that went wrong; on a GPU that would cost a wait in each step."""
        on_cpu = self._row.device.type == "cpu"
        if on_cpu and self.on_fault is not None and int(self._bad_steps):
            self.on_fault({name: value.clone() for name, value in minibatch.items()})
            self.on_fault = None

    def _adapt_rate(self, kl: float) -> float:
        """Bring the actor's learning rate a step towards ``target_kl``; returns the rate, 0 while the critic learns alone."""
        if self._critic_alone:
            return 0.0
        target = self.options.target_kl
        if target is not None:
            if not kl <= 2 * target:  # also where it is not finite
                self._rate /= RATE_STEP
            elif kl < target / 2:
                self._rate *= RATE_STEP
            self._rate = min(max(self._rate, RATE_RANGE[0]), RATE_RANGE[1])
            self._rate_on_device.fill_(self._rate)
        return self._rate

    @torch.no_grad()
    def _adapt_penalty(self, batch: Mapping[str, Tensor]) -> dict[str, float]:
        """Adapt β to the divergence that the update made; returns both as metrics."""
        penalty = self.options.kl_penalty
        if penalty is None:
            return {}
        new = self.policy.distribution(observations_of(batch))
        divergence = float(averages.mean(_collecting(batch, new).divergence(new).mean()))
        used, (least, most) = self._coefficient, COEFFICIENT_RANGE
        if not self._critic_alone:
            self._coefficient = min(max(penalty.adapted(used, divergence), least), most)
            self._coefficient_on_device.fill_(self._coefficient)
        return {"divergence": divergence, "kl_coefficient": used}

    def state_dict(self) -> State:
        return {
            "actor": optimisers.state_of(self._actor_optimiser),
            "critic": optimisers.state_of(self._critic_optimiser),
            "actor_rate": self._rate,
            "kl_coefficient": self._coefficient,
            "bad_steps": self._bad_steps.clone(),
            "updates": self._updates,
            "generator": self._generator.get_state(),
        }

    def load_state_dict(self, state: State) -> None:
        # Older checkpoints do not count updates: they are of before the option.
        updates = state.get("updates", self.options.critic_first)
        for name in ("actor_rate", "kl_coefficient", "updates"):
            if (value := state.get(name, updates)) < 0:
                raise ValueError(f"'{name}' is {value:g}, below 0")
        optimisers.load_state(self._actor_optimiser, state["actor"])
        optimisers.load_state(self._critic_optimiser, state["critic"])
        self._rate, self._coefficient = state["actor_rate"], state["kl_coefficient"]
        self._updates = updates
        self._rate_on_device.fill_(self._rate)
        self._coefficient_on_device.fill_(self._coefficient)
        self._bad_steps.copy_(state["bad_steps"])
        self._generator.set_state(state["generator"].cpu())
        self._capture()


def _collecting(batch: Mapping[str, Tensor], like: Distribution) -> Distribution:
    """The distributions, of the same kind as `like`, that the samples were collected with."""
    parameters = (batch[f"{_OLD}{i}"] for i in itertools.count())
    return like.map(lambda _: next(parameters))


def _parts(batch: Mapping[str, Tensor], size: int) -> Iterator[dict[str, Tensor]]:
    """Views of `size` rows of `batch`, one after the other."""
    for parts in zip(*(value.split(size) for value in batch.values()), strict=True):
        yield dict(zip(batch, parts, strict=True))


def _minibatches(options: PPO.Options, samples: int) -> tuple[int, int]:
    """Optimiser steps of an epoch, and samples of each, of the `samples` of this process."""
    if samples < 2:
        raise ConfigError(
            "One sample an iteration is too few: raise num_worlds or learner.rollout_steps."
        )
    have = f"num_worlds × learner.rollout_steps = {samples}"
    if options.minibatches is not None:
        if options.minibatches > samples:
            raise ConfigError(
                f"learner.minibatches={options.minibatches} are more than the samples of an iteration: "
                f"{have}."
            )
        return options.minibatches, samples // options.minibatches
    assert options.batch_size is not None
    each, left = divmod(options.batch_size, distributed.size())
    if left:
        raise ConfigError(
            f"learner.batch_size={options.batch_size} cannot be shared by {distributed.size()} processes."
        )
    if each > samples:
        raise ConfigError(
            f"learner.batch_size={options.batch_size} is more than the samples of an iteration: {have}."
        )
    return samples // each, each


def _optimiser(
    options: PPO.Options, parameters: list[nn.Parameter], rate: Tensor
) -> torch.optim.Optimizer:
    decay = options.weight_decay
    if options.optimiser == "sgd":
        return optimisers.sgd(parameters, rate, momentum=options.momentum, weight_decay=decay)
    return optimisers.adam(parameters, rate, weight_decay=decay)
