"""How the task's cost changes with each action of real trajectories, by one pass back in time.

Stochastic value gradients of real trajectories (SVG(∞), Heess et al. 2015): states are those that the
simulator gave, and a learned model gives the derivatives of what follows from them alone. Its errors
therefore do not add up along a trajectory. Where actions follow from states, the policy's derivative
counts too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy_imagination.imagined import Imagined
from understudy_imagination.model import WorldModel
from understudy_imagination.rigid import Posed, Rigid
from understudy_networks.graphs import Captured
from understudy_reinforcement.policy import Policy

#: What a step back is given and what it gives, by these prefixes.
_STATE, _FIXED, _SEEN = "state/", "fixed/", "seen/"


@dataclass(frozen=True)
class Weights:
    """Of what makes the cost."""

    margins: float
    actions: float
    rewards: float
    norm: float  #: over the things of a margin
    power: float  #: of that


@dataclass(frozen=True)
class Window:
    """L decisions of N worlds in a row, time first."""

    before: dict[str, Tensor]  #: fields (L, N, …) of the states that actions were taken in
    reached: dict[str, Tensor]  #: and of those that they led to
    actions: Tensor  #: (L, N, A)
    ended: Tensor  #: (L, N) bool: the episode ended here

    def __len__(self) -> int:
        return len(self.actions)

    def followed_by(self, other: Window) -> Window:
        def joined(a: Mapping[str, Tensor], b: Mapping[str, Tensor]) -> dict[str, Tensor]:
            return {name: torch.cat([a[name], b[name]]) for name in a}

        return Window(
            joined(self.before, other.before),
            joined(self.reached, other.reached),
            torch.cat([self.actions, other.actions]),
            torch.cat([self.ended, other.ended]),
        )

    def newest(self, steps: int) -> Window:
        """A copy of the last `steps`."""
        return Window(
            {name: value[-steps:].clone() for name, value in self.before.items()},
            {name: value[-steps:].clone() for name, value in self.reached.items()},
            self.actions[-steps:].clone(),
            self.ended[-steps:].clone(),
        )


@dataclass(frozen=True)
class Gradients:
    """Of L decisions of N worlds."""

    actions: Tensor  #: (L, N, A): the cost's derivative, 0 where it is not finite
    means: Tensor  #: (L, N, A): the policy's actions now, without noise
    observations: dict[str, Tensor]  #: (L, N, …)
    cost: Tensor  #: (L, N), without that of actions


class Adjoint:
    """`decay` is by what derivatives shrink a step back, beyond the dynamics; `clip` how many times the
    median over worlds a world's may be."""

    def __init__(
        self,
        rigid: Rigid,
        imagined: Imagined,
        model: WorldModel,
        policy: Policy,
        weights: Weights,
        *,
        decay: float,
        clip: float,
    ) -> None:
        self._rigid, self._imagined, self._model = rigid, imagined, model
        self._policy, self._weights = policy, weights
        self._decay, self._clip = decay, clip
        #: What the newest step back gave.
        self._made: dict[str, Tensor] = {}
        self._back = Captured(self._step_back, imagined.reach.device)

    def forget_graphs(self) -> None:
        """Capture anew: where policy and model keep their weights has changed."""
        self._back = Captured(self._step_back, self._imagined.reach.device)

    def __call__(self, window: Window) -> Gradients:
        imagined, steps = self._imagined, len(window)
        cost, along, direct = self._costs(window)
        constants = imagined.constants(_flat(window.before))
        constants = {k: v.unflatten(0, window.ended.shape) for k, v in constants.items()}
        after = torch.zeros_like(along[0])
        actions, means, seen = torch.empty_like(window.actions), [], []
        for t in reversed(range(steps)):
            state = {name: value[t] for name, value in window.before.items()}
            fixed = {name: value[t] for name, value in constants.items()}
            going = along[t] + after.masked_fill(window.ended[t].unsqueeze(1), 0.0)
            self._back(
                {
                    **{f"{_STATE}{name}": value for name, value in state.items()},
                    **{f"{_FIXED}{name}": value for name, value in fixed.items()},
                    "action": window.actions[t],
                    "going": going,
                }
            )
            made = {name: value.clone() for name, value in self._made.items()}
            actions[t], after = made["action"] + direct[t], made["after"]
            means.append(made["mean"])
            seen.append(_named(made, _SEEN))
        return Gradients(
            clean(actions),
            torch.stack(means[::-1]),
            {name: torch.stack([s[name] for s in seen[::-1]]) for name in seen[0]},
            cost.view_as(window.ended),
        )

    def _step_back(self, given: Mapping[str, Tensor]) -> None:
        """One decision back, into ``_made``: `given` are its state, what does not move with it, the
        action, and the derivative ``going`` (N, 2 nv) by the state that it led to."""
        by_state, by_action, mean, observations = self._step(
            _named(given, _STATE), _named(given, _FIXED), given["action"], given["going"]
        )
        found = {f"{_SEEN}{name}": value for name, value in observations.items()}
        found |= {"action": by_action, "after": self._tamed(by_state), "mean": mean}
        for name, value in found.items():
            if name not in self._made:
                self._made[name] = torch.empty_like(value)
            self._made[name].copy_(value)

    def _costs(self, window: Window) -> tuple[Tensor, Tensor, Tensor]:
        """What states and actions cost: the sum (L N,), and its derivatives by the states reached
        (L, N, 2 nv) and by the actions (L, N, A)."""
        imagined, rigid, weights = self._imagined, self._rigid, self._weights
        state = _flat(window.reached)
        step = torch.zeros(len(state["qpos"]), 2 * rigid.nv, device=state["qpos"].device)
        action = window.actions.flatten(0, 1).clone().requires_grad_()
        posed = self._posed(state, step.requires_grad_())
        fields = imagined.fields(posed, imagined.constants(state), action)
        cost = weights.margins * imagined.used(fields, weights.norm, weights.power)
        reward = imagined.reward(fields)
        if reward is not None:
            cost = cost - weights.rewards * reward
        found = torch.autograd.grad(cost.sum(), (step, action), materialize_grads=True)
        by_state, by_action = (clean(g).unflatten(0, window.ended.shape) for g in found)
        return cost.detach(), by_state, by_action

    def _posed(self, state: Mapping[str, Tensor], step: Tensor) -> Posed:
        """The states moved by `step` (B, 2 nv), of positions and velocities."""
        place, speed = step.chunk(2, dim=1)
        return self._rigid.posed(self._rigid.moved(state["qpos"], place), state["qvel"] + speed)

    def _step(
        self,
        state: Mapping[str, Tensor],
        constants: Mapping[str, Tensor],
        action: Tensor,
        after: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor, dict[str, Tensor]]:
        """The derivative by states (N, 2 nv) and by actions (N, A) of what one decision costs and what
        follows from it, `after` (N, 2 nv); the policy's action without noise, and what it saw."""
        imagined, rigid = self._imagined, self._rigid
        step = torch.zeros_like(after).requires_grad_()
        moved = torch.zeros_like(action).requires_grad_()
        posed = self._posed(state, step)
        fields = imagined.fields(posed, constants, action)
        seen = imagined.observations(fields)
        mean = self._policy.distribution(seen).mode()
        chosen = mean + moved
        taken = action + chosen - mean.detach()
        qpos, qvel = self._model(posed, imagined.control(taken, fields))
        change = [rigid.difference(qpos.detach(), qpos), qvel - qvel.detach()]
        effort = self._weights.actions * imagined.offset(chosen, fields).square().mean()
        effort = effort * len(action)
        by_state, by_action = torch.autograd.grad(
            (torch.cat(change, dim=1), effort), (step, moved), (after, torch.ones_like(effort))
        )
        observations = {name: value.detach() for name, value in seen.items()}
        return by_state, by_action, mean.detach(), observations

    def _tamed(self, gradient: Tensor) -> Tensor:
        """`gradient` (N, 2 nv) a step further back; positions and velocities are limited apart."""
        parts = [
            limited(part, self._clip) * self._decay for part in clean(gradient).chunk(2, dim=1)
        ]
        return torch.cat(parts, dim=1)


def clean(gradient: Tensor) -> Tensor:
    """`gradient` (…, D), 0 in rows where a number is not finite."""
    sound = gradient.isfinite().all(dim=-1, keepdim=True)
    return torch.where(sound, gradient, 0.0)


def limited(gradient: Tensor, most: float) -> Tensor:
    """`gradient` (B, D), its rows no longer than `most` times the median of those that are not 0."""
    length = torch.linalg.vector_norm(gradient, dim=1, keepdim=True)
    counts = length > 0
    ordered = torch.where(counts, length, torch.inf).flatten().sort().values
    middle = (counts.sum() - 1).clamp(min=0) // 2  # torch's nanmedian waits for the device
    median = ordered.gather(0, middle.view(1))
    return gradient * (most * median / length.clamp(min=1e-30)).clamp(max=1.0)


def _named(given: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """What `given` has with this prefix, without it."""
    return {k.removeprefix(prefix): v for k, v in given.items() if k.startswith(prefix)}


def _flat(fields: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {name: value.flatten(0, 1) for name, value in fields.items()}
