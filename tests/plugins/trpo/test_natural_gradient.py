"""The parts of a natural-gradient step against explicit matrices, in float64."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor, nn
from torch.nn.utils import parameters_to_vector

from understudy.task import ActionSpace, Box, Choice
from understudy_networks.nn import action_distribution, box_columns, head_size, mlp
from understudy_reinforcement.policy import Distribution
from understudy_trpo.natural_gradient import (
    conjugate_gradient,
    gradient,
    hessian_product,
    line_search,
)

SPACES = {
    "box": ActionSpace({"a": Box(2)}),
    "choice": ActionSpace({"a": Choice(3)}),
    "hybrid": ActionSpace({"a": Choice(3), "b": Box(2)}),
}


class Small(nn.Module):
    def __init__(self, space: ActionSpace) -> None:
        super().__init__()
        self.space = space
        self.net = mlp([3, 4, head_size(space)], activation=nn.Tanh)
        self.log_std = nn.Parameter(torch.full((box_columns(space),), -0.5))

    def forward(self, x: Tensor) -> Distribution:
        return action_distribution(self.space, self.net(x), self.log_std.exp())


@pytest.mark.parametrize("space", SPACES.values(), ids=SPACES)
def test_product_equals_the_explicit_hessian(space: ActionSpace) -> None:
    torch.manual_seed(0)
    policy = Small(space).double()
    parameters = list(policy.parameters())
    x = torch.randn(16, 3, dtype=torch.float64)
    old = policy(x).map(Tensor.detach)
    kl = old.divergence(policy(x)).mean()
    names, shapes = zip(*((n, p.shape) for n, p in policy.named_parameters()), strict=True)

    def of_vector(theta: Tensor) -> Tensor:
        parts = theta.split([s.numel() for s in shapes])
        weights = {n: p.view(s) for n, p, s in zip(names, parts, shapes, strict=True)}
        return old.divergence(torch.func.functional_call(policy, weights, (x,))).mean()

    theta = parameters_to_vector(parameters).detach()
    hessian = torch.autograd.functional.hessian(of_vector, theta)
    assert isinstance(hessian, Tensor)
    product = hessian_product(kl, parameters)
    found = torch.stack([product(v) for v in torch.eye(theta.numel(), dtype=torch.float64)])
    torch.testing.assert_close(found, hessian, rtol=1e-9, atol=1e-12)
    assert float(hessian.abs().max()) > 1e-3
    assert float(torch.linalg.eigvalsh(hessian).min()) > -1e-12  # a Fisher matrix


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), size=st.integers(1, 12))
def test_conjugate_gradient_solves_in_as_many_steps_as_unknowns(seed: int, size: int) -> None:
    chance = torch.Generator().manual_seed(seed)
    root = torch.randn(size, size, generator=chance, dtype=torch.float64)
    a, b = root @ root.T + torch.eye(size), torch.randn(size, generator=chance, dtype=torch.float64)
    x = conjugate_gradient(lambda v: a @ v, b, iterations=3 * size, tolerance=1e-24)
    torch.testing.assert_close(a @ x, b, rtol=0, atol=1e-6)


def test_conjugate_gradient_of_zero_is_zero() -> None:
    assert not conjugate_gradient(lambda v: 2 * v, torch.zeros(3), iterations=5).any()


def test_line_search_takes_the_longest_that_is_accepted() -> None:
    weight = nn.Parameter(torch.tensor([1.0, 2.0]))
    full = torch.tensor([1.0, 0.0])
    tried: list[float] = []

    def accepts() -> bool:
        tried.append(float(weight[0]))
        return bool(weight[0] <= 1.3)

    assert line_search([weight], full, accepts, shrink=0.5, attempts=5) == 0.25
    assert tried == [2.0, 1.5, 1.25]
    assert weight.tolist() == [1.25, 2.0]
    assert line_search([weight], full, lambda: False, shrink=0.5, attempts=3) == 0.0
    assert weight.tolist() == [1.25, 2.0]


def test_natural_step_on_a_quadratic() -> None:
    """max g·θ with KL = θᵀHθ / 2 ≤ δ has the solution sqrt(2 δ / gᵀH⁻¹g) H⁻¹g, on the limit."""
    h = torch.tensor([[4.0, 1.0], [1.0, 0.5]], dtype=torch.float64)
    theta = nn.Parameter(torch.zeros(2, dtype=torch.float64))
    g = gradient(theta @ torch.tensor([1.0, -2.0], dtype=torch.float64), [theta])
    fisher = hessian_product(0.5 * theta @ h @ theta, [theta])
    s = conjugate_gradient(fisher, g, 10)
    step, limit = torch.sqrt(2 * 0.01 / (s @ fisher(s))) * s, 0.01
    assert float(0.5 * step @ h @ step) == pytest.approx(limit)
    best = torch.linalg.solve(h, g)
    torch.testing.assert_close(step / step.norm(), best / best.norm())
    for other in torch.randn(200, 2, dtype=torch.float64):
        inside = other * torch.sqrt(2 * limit / (other @ h @ other))
        assert g @ inside <= g @ step + 1e-12
