"""Collects rollouts of fixed length; episodes continue from one rollout to the next."""

from __future__ import annotations

import time
from collections.abc import Sequence

import torch
from torch import Tensor

from understudy.random import WorldStreams
from understudy.running.environment import Environment
from understudy.running.soundness import without_unsound
from understudy.running.step import Step
from understudy.task import Rollout
from understudy_reinforcement.policy import Policy, enough_memory

__all__ = ["Collector"]

#: Bytes from which on it is asked whether there is room for a rollout.
_LARGE = 2**30


class Collector:
    """Steps an environment with a policy and keeps what a learner needs: the `fields` before each action, and
    `next_fields` of the states that were reached."""

    def __init__(
        self,
        environment: Environment,
        policy: Policy,
        seed: int,
        fields: Sequence[str] = (),
        next_fields: Sequence[str] = (),
    ) -> None:
        self.environment, self.policy = environment, policy
        self._fields, self._next_fields = tuple(dict.fromkeys(fields)), tuple(next_fields)
        self.streams = WorldStreams(seed, "actions", environment.num_worlds, environment.device)
        #: By reward term, where there are several: what it gave to the steps of the last rollout, on average.
        self.rewarded: dict[str, float] = {}
        self._first = True  #: whether nothing was stepped yet in this process
        #: s: what the last rollout's steps took before they were steps, since kernels had to be compiled for them.
        self.compiling = 0.0

    def check_room(self, steps: int) -> None:
        """Refuse a rollout of so many `steps` that there is no memory for, before anything of a run is written.

        Raises
        ------
        ConfigError
            there is none.
        """
        environment = self.environment
        kept = (*environment.observations.values(), environment.action)
        each = sum(value[:1].nbytes for value in kept)
        if (size := steps * environment.num_worlds * each) > _LARGE:
            with enough_memory(
                f"rollout (num_worlds={environment.num_worlds} times learner.rollout_steps={steps})"
            ):
                torch.empty(size, dtype=torch.uint8, device=environment.device)

    @torch.no_grad()
    def collect(self, steps: int) -> Rollout:
        environment, policy = self.environment, self.policy
        n, device = environment.num_worlds, environment.device

        def empty(like: Tensor | None = None, dtype: torch.dtype = torch.float32) -> Tensor:
            shape, kind = ((), dtype) if like is None else (like.shape[1:], like.dtype)
            return torch.empty((steps, n, *shape), dtype=kind, device=device)

        rollout = Rollout(
            observations={k: empty(v) for k, v in environment.observations.items()},
            last_observations={},
            actions=empty(environment.action),
            log_probs=empty(),
            rewards=empty(),
            terminated=empty(dtype=torch.bool),
            truncated=empty(dtype=torch.bool),
            failed=empty(dtype=torch.bool),
            final_values=empty().zero_(),
            episode_returns=empty(),
            fields={name: empty(environment.table[name]) for name in self._fields},
            next_fields={name: empty(environment.table[name]) for name in self._next_fields},
        )
        environment.next_fields = self._next_fields
        given: dict[str, Tensor] = {}
        self.compiling = 0.0
        for t in range(steps):
            observations = environment.observations
            for name, value in observations.items():
                rollout.observations[name][t] = value
            for name in self._fields:
                rollout.fields[name][t] = without_unsound(environment.table[name])
            distribution = policy.distribution(observations)
            action = distribution.sample(self.streams)
            rollout.actions[t] = action
            rollout.log_probs[t] = distribution.log_prob(action)
            step = self._step(action)
            rollout.rewards[t] = step.rewards
            for name, value in environment.rewarded.items():
                given.setdefault(name, empty())[t] = value
            rollout.terminated[t] = step.terminated
            rollout.truncated[t] = step.truncated
            rollout.failed[t] = step.failed
            rollout.episode_returns[t] = step.returns
            for name, value in step.next_fields.items():
                rollout.next_fields[name][t] = value
            if step.final_observations is not None and (
                device.type != "cpu" or bool(step.truncated.any())
            ):
                values = policy.value(step.final_observations)
                rollout.final_values[t] = torch.where(step.truncated, values, 0.0)
        rollout.last_observations = {k: v.clone() for k, v in environment.observations.items()}
        several = given if len(given) > 1 else {}
        self.rewarded = {k: float(without_unsound(v.flatten()).mean()) for k, v in several.items()}
        return rollout

    def _step(self, action: Tensor) -> Step:
        """Step the environment; the time of the first step, a minute on a new machine, is `compiling`."""
        if not self._first:
            return self.environment.step(action)
        began, device = time.perf_counter(), self.environment.device
        step, self._first = self.environment.step(action), False
        if device.type == "cuda":
            torch.cuda.synchronize(device)
        self.compiling = time.perf_counter() - began
        return step
