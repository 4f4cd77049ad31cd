"""A task without physics for learners: stay near the origin of a line. Rollouts are made by hand."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from understudy.random import WorldStreams, private_rng
from understudy.task import ActionSpace, Box, Choice, Context, Rollout, box
from understudy_reinforcement.policy import Policy

#: One number, how far to go; or a side to go to and two numbers, of which the first is how far.
STEP = box(1)
SIDE_AND_STEP = ActionSpace({"side": Choice(2), "step": Box(2)})


def line_context(space: ActionSpace = STEP, worlds: int = 64, seed: int = 0) -> Context:
    return Context(
        seed=seed,
        device=torch.device("cpu"),
        num_worlds=worlds,
        control_dt=1.0,
        substeps=1,
        action_space=space,
        observation_shapes={"state": (2,)},
    )


def make_policy(kind: type, options: object, context: Context) -> Policy:
    with private_rng(context.seed, "policy"):
        return kind(options, context)


class Line:
    """Worlds at x in [-2, 2] that go up to 0.5 a step; reward exp(-x²) where they arrive, failure
    beyond 3, cut after 10 steps."""

    def __init__(self, context: Context, policy: Policy) -> None:
        assert context.action_space is not None
        self.space, self.policy, self.n = context.action_space, policy, context.num_worlds
        self.actions = WorldStreams(context.seed, "actions", self.n, "cpu")
        self.starts = WorldStreams(context.seed, "starts", self.n, "cpu")
        self.x, self.age = self._start(), torch.arange(self.n) % 10

    def _start(self) -> Tensor:
        return 4 * self.starts.uniform(1).squeeze(1) - 2

    def _observe(self, x: Tensor) -> dict[str, Tensor]:
        return {"state": torch.stack([x, torch.ones_like(x)], dim=-1)}

    def _move(self, action: Tensor) -> Tensor:
        parts = self.space.split(action)
        if "side" in parts:
            move = (2.0 * parts["side"] - 1.0) * parts["step"][:, 0].abs()
        else:
            move = parts["action"][:, 0]
        return move.clamp(-0.5, 0.5)

    @torch.no_grad()
    def collect(self, steps: int) -> Rollout:
        rows: dict[str, list[Tensor]] = {}

        def note(**values: Tensor) -> None:
            for name, value in values.items():
                rows.setdefault(name, []).append(value)

        for _ in range(steps):
            distribution = self.policy.distribution(self._observe(self.x))
            action = distribution.sample(self.actions)
            after = self.x + self._move(action)
            self.age = self.age + 1
            terminated = after.abs() > 3
            truncated = ~terminated & (self.age >= 10)
            ended = terminated | truncated
            values = self.policy.value(self._observe(after))
            note(
                state=self._observe(self.x)["state"],
                actions=action,
                log_probs=distribution.log_prob(action),
                rewards=torch.where(terminated, 0.0, torch.exp(-after.square())),
                terminated=terminated,
                truncated=truncated,
                final_values=torch.where(truncated, values, 0.0),
            )
            self.x = torch.where(ended, self._start(), after)
            self.age = torch.where(ended, 0, self.age)
        stacked = {name: torch.stack(row) for name, row in rows.items()}
        return Rollout(
            observations={"state": stacked.pop("state")},
            last_observations=self._observe(self.x),
            failed=stacked["terminated"],
            episode_returns=torch.zeros_like(stacked["rewards"]),
            fields={},
            **stacked,
        )


def train(
    line: Line, update: Callable[[Rollout], dict[str, float]], steps: int, iterations: int
) -> list[dict[str, float]]:
    """Metrics of `iterations` updates, the rollout's mean reward among them."""
    metrics = []
    for _ in range(iterations):
        rollout = line.collect(steps)
        metrics.append(update(rollout) | {"reward": float(rollout.rewards.mean())})
        line.policy.observe(rollout.observations)
    return metrics
