"""Evaluation: how often the deterministic policy lasts an episode, and what it violates meanwhile."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from understudy.setup.building import Built, build_environment
from understudy.setup.config import Experiment
from understudy.task.interfaces import Context, Policy


@dataclass(frozen=True)
class Evaluation:
    """What an evaluation found. Shares are of episodes."""

    episodes: int
    success_rate: float
    mean_episode_seconds: float
    violated: Mapping[str, float]  #: by termination term
    within_all_bounds: float  #: share of episodes that violated none of the terms
    seconds: float
    complete: bool  #: False if it was stopped once success was out of reach

    def as_json(self, samples: int) -> dict[str, Any]:
        low, high = wilson_interval(self.success_rate, self.episodes)
        return {
            "episodes": self.episodes,
            "success_rate": self.success_rate,
            "success_rate_95": [low, high],
            "mean_episode_seconds": self.mean_episode_seconds,
            "episode_seconds": self.seconds,
            "within_all_bounds": self.within_all_bounds,
            "violated": dict(self.violated),
            "samples": samples,
            "policy": "deterministic",
        }


def wilson_interval(rate: float, n: int, z: float = 1.96) -> tuple[float, float]:
    """The Wilson score interval of a share `rate` of `n` (95 % by default)."""
    if n == 0:
        return 0.0, 1.0
    centre = rate + z * z / (2 * n)
    spread = z * math.sqrt(rate * (1 - rate) / n + z * z / (4 * n * n))
    scale = 1 + z * z / n
    return max(0.0, (centre - spread) / scale), min(1.0, (centre + spread) / scale)


class Evaluator:
    """One environment with one world per episode, kept between evaluations of the same training."""

    def __init__(self, experiment: Experiment, context: Context | None = None) -> None:
        options = experiment.root.evaluation
        self.experiment, self.options, self._seed = experiment, options, experiment.root.seed
        self.built: Built = build_environment(
            experiment,
            num_worlds=options.episodes,
            episode_seconds=options.seconds,
            scene=context.scene if context else None,
            sections=dict(context.sections) if context else None,
            ending=options.failures,
        )

    @torch.no_grad()
    def run(
        self,
        policy: Policy,
        *,
        give_up_below: float | None = None,
        on_step: Callable[[Tensor], None] | None = None,
    ) -> Evaluation:
        """Run all episodes at once; each world counts until its first ending.

        The same policy gives the same result every time. With `give_up_below`, stops as soon as
        that success rate is out of reach. Before each step, `on_step` is told which worlds (N,)
        still count.
        """
        environment = self.built.environment
        n, device = environment.num_worlds, environment.device
        running = torch.ones(n, dtype=torch.bool, device=device)
        failed = torch.zeros(n, dtype=torch.bool, device=device)
        lasted = torch.zeros(n, device=device)
        violated = {
            t.name: torch.zeros(n, dtype=torch.bool, device=device)
            for t in environment.parts.terminations
            if t.outcome != "truncation"  # an end in time violates nothing
        }
        observations = environment.reset(self._seed)
        complete = True
        for step in range(environment.max_steps):
            if on_step is not None:
                on_step(running)
            result = environment.step(policy.distribution(observations).mode())
            observations = result.observations
            lasted += running
            for name, fired in violated.items():
                fired |= result.endings[name] & running
            failed |= result.failed & running
            running &= ~(result.terminated | result.truncated)
            if step % 30 != 29 or give_up_below is None:
                continue
            if (n - int(failed.sum())) / n < give_up_below:
                complete = False
                break
        unbroken = ~failed
        for fired in violated.values():
            unbroken &= ~fired
        return Evaluation(
            episodes=n,
            success_rate=(n - int(failed.sum())) / n,
            mean_episode_seconds=float(lasted.mean()) * environment.control_dt,
            violated={k: float(v.float().mean()) for k, v in violated.items()},
            within_all_bounds=float(unbroken.float().mean()),
            seconds=self.options.seconds,
            complete=complete,
        )

    def close(self) -> None:
        self.built.environment.close()
