"""Plays one episode of a policy in each world, with functions called at each moment."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from understudy.running.environment import Environment
from understudy.running.step import Step
from understudy.setup.building import Built
from understudy_reinforcement.policy import Policy, build_policy
from understudy_skills.skill import Skill

__all__ = ["act_out", "policy_of"]


def policy_of(skill: Skill, built: Built) -> Policy:
    """The policy of `skill`, for the environment that was `built`.

    Raises
    ------
    RunError
        if it has another shape here.
    """
    policy: Any = build_policy(skill.experiment, built.context)
    skill.give(policy)
    return policy


@torch.no_grad()
def act_out(
    environment: Environment,
    policy: Policy,
    seconds: float,
    *,
    see: Callable[[Tensor], None],
    decided: Callable[[Tensor, Step], None],
) -> None:
    """Carry out the episodes in which `environment` was just reset, the policy acting by its mode.

    Parameters
    ----------
    environment
        of N worlds; each counts until its first ending, and goes on until all are over
    policy
        sees its observations
    seconds
        s, for which at most it is simulated
    see
        is told before every control period which worlds (N,) bool count
    decided
        is told after every decision which worlds (N,) bool counted in it, and what the step gave
    """
    running = torch.ones(environment.num_worlds, dtype=torch.bool, device=environment.device)
    environment.on_period = lambda: see(running)
    decision = environment.decision * environment.control_dt
    for _ in range(max(1, round(seconds / decision))):
        action = policy.distribution(environment.observations).mode()
        step = environment.advance(action)
        decided(running, step)
        running = running & ~step.ended
