"""Natural-gradient steps without the Fisher matrix (Schulman et al. 2015, appendix C)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn
from torch.nn.utils import parameters_to_vector, vector_to_parameters

Product = Callable[[Tensor], Tensor]


def gradient(value: Tensor, parameters: Sequence[nn.Parameter], *, again: bool = False) -> Tensor:
    """The gradient (P,) of `value` () by all `parameters`, itself differentiable if `again`."""
    parts = torch.autograd.grad(
        value, parameters, create_graph=again, retain_graph=True, materialize_grads=True
    )
    return torch.cat([part.reshape(-1) for part in parts])


def hessian_product(value: Tensor, parameters: Sequence[nn.Parameter]) -> Product:
    """v (P,) ↦ H v, H the Hessian of `value` () by `parameters`. Of the mean KL divergence from the
    present distribution, at the present weights, H is the Fisher matrix."""
    slope = gradient(value, parameters, again=True)
    return lambda v: gradient(slope @ v, parameters)


def conjugate_gradient(
    product: Product, b: Tensor, iterations: int, tolerance: float = 1e-10
) -> Tensor:
    """x (P,) with A x ≈ b, for a positive definite A given by `product`: v ↦ A v.

    The classic recurrence (Hestenes and Stiefel 1952). Once the squared residual is below
    `tolerance` of the first one, x stays: what follows would divide rounding errors.
    """
    x, r, p = torch.zeros_like(b), b.clone(), b.clone()
    rr = r @ r
    enough = tolerance * rr
    for _ in range(iterations):
        going = rr > enough
        ap = product(p)
        alpha = torch.where(going, rr / (p @ ap), 0.0)
        x, r = x + alpha * p, r - alpha * ap
        before, rr = rr, torch.where(going, r @ r, rr)
        p = torch.where(going, r + rr / before * p, p)
    return x


def line_search(
    parameters: Sequence[nn.Parameter],
    full_step: Tensor,
    accepts: Callable[[], bool],
    *,
    shrink: float,
    attempts: int,
) -> float:
    """Take the longest of `full_step` (P,) · 1, shrink, shrink², … that `accepts` approves with the
    weights there; returns its share, or 0 with the weights as they were."""
    start = parameters_to_vector(parameters).detach()
    share = 1.0
    for _ in range(attempts):
        vector_to_parameters(start + share * full_step, parameters)
        if accepts():
            return share
        share *= shrink
    vector_to_parameters(start, parameters)
    return 0.0
