"""A skill that learns to give its servos the clip's own targets, from what it sees and without a clock.

Played open loop, from the first frame on, the targets of a clip may already carry the figure through it, as those of the generated
``sit`` do. A reward only hints at the targets, by where they lead; here the policy is told them, in the states that it reaches itself
(dataset aggregation: Ross, Gordon, Bagnell, "A reduction of imitation learning and structured prediction to no-regret
online learning", 2011).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.options import check_range
from understudy.random import generator
from understudy.task import Context, Rollout, State
from understudy_reinforcement.learner import Learner
from understudy_reinforcement.policy import Policy
from understudy_sitting.actuation import units

_TARGETS = "reference_joint_targets"


class AfterClip(Learner):
    """Least squares of the policy's mode and the clip's targets, in the units of ``sitting/around_clip``."""

    rollout_fields = (_TARGETS,)

    @dataclass(frozen=True)
    class Options:
        rollout_steps: int = 16  #: T, steps per world and iteration
        keep: int = 40  #: how many of the newest iterations it learns from
        steps: int = 48  #: optimiser steps in an iteration
        batch_size: int = 1024  #: samples of an optimiser step, from 1
        learning_rate: float = 1e-3  #: learning rate of Adam, above 0
        least: float = 0.15  #: rad, least unit of the action, as in ``sitting/around_clip``

        def __post_init__(self) -> None:
            check_range(self, "least", most=100)
            check_range(self, "rollout_steps", "keep", "steps", "batch_size", least=1)
            check_range(self, "learning_rate", "least", above=0)

    def __init__(self, options: Options, context: Context, policy: Policy) -> None:
        self.options, self.policy = options, policy
        self.rollout_steps = options.rollout_steps
        self._middle, self._unit = units(context, options.least)
        self._optimiser = torch.optim.Adam(policy.actor_parameters(), lr=options.learning_rate)
        self._generator = generator(context.seed, "after_clip", context.device)
        #: Observations by name and what they ask for, of the newest iterations.
        self._seen: deque[dict[str, Tensor]] = deque(maxlen=options.keep)

    def update(self, rollout: Rollout) -> dict[str, float]:
        options, policy = self.options, self.policy
        with torch.no_grad():
            rollout.values = policy.value(rollout.observations)
            rollout.returns = rollout.values.clone()
        policy.observe(rollout.observations)
        wanted = (rollout.fields[_TARGETS] - self._middle) / self._unit
        batch = {**rollout.observations, _TARGETS: wanted}
        self._seen.append({name: value.flatten(0, 1).clone() for name, value in batch.items()})
        known = {name: torch.cat([one[name] for one in self._seen]) for name in batch}
        total, skipped = 0.0, 0
        for _ in range(options.steps):
            size = len(known[_TARGETS])
            rows = torch.randint(
                size, (options.batch_size,), generator=self._generator, device=wanted.device
            )
            minibatch = {name: value[rows] for name, value in known.items()}
            targets = minibatch.pop(_TARGETS)
            loss = (policy.distribution(minibatch).mode() - targets).square().mean()
            if not torch.isfinite(loss):
                skipped += 1
                continue
            self._optimiser.zero_grad()
            loss.backward()
            self._optimiser.step()
            total += float(loss.detach())
        done = max(1, options.steps - skipped)
        return {"target_error": total / done, "skipped_steps": float(skipped)}

    def state_dict(self) -> State:
        return {"optimiser": self._optimiser.state_dict(), "generator": self._generator.get_state()}

    def load_state_dict(self, state: State) -> None:
        self._optimiser.load_state_dict(state["optimiser"])
        self._generator.set_state(state["generator"].cpu())
