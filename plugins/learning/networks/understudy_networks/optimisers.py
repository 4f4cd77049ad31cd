"""Optimisers that skip what is not finite without waiting for the device, and their exact state."""

from __future__ import annotations

import inspect
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.optim import SGD, Adam, Optimizer

from understudy.errors import TrainingError
from understudy.task import State

__all__ = [
    "adam",
    "differentiate",
    "gradient_views",
    "load_state",
    "refuse_hopeless",
    "sgd",
    "state_of",
    "step",
]


class _Uncompiled(Optimizer):
    """Does not import torch's compiler, which takes a second and more, only to have it leave these methods alone."""

    add_param_group = inspect.unwrap(Optimizer.add_param_group)


#: Tensors that one launch of torch's fused Adam takes.
_LAUNCH = 36


class _Adam(_Uncompiled, Adam):
    _whole = torch.no_grad()(inspect.unwrap(Adam.step))

    @torch.no_grad()
    def step(self) -> None:  # type: ignore[override] # pyright: ignore[reportIncompatibleMethodOverride]
        """As torch's, but on a GPU in pieces: its kernel has one block for 65 536 numbers of a tensor, so that a large
        layer keeps a tenth of the GPU busy."""
        group = self.param_groups[0]
        if not group["capturable"]:
            self._whole()
            return
        found: tuple[list[Tensor], ...] = ([], [], [], [], [], [])
        self._init_group(group, *found)
        *tensors, _, steps = found
        sizes = [p.numel() for p in tensors[0]]
        most = -(-sum(sizes) // max(1, _LAUNCH - len(sizes)))
        most = max(4096, -(-most // 4) * 4)  # 16 bytes: what kernels load at once
        pieces = [[x for t in of for x in t.view(-1).split(most)] for of in tensors]
        owners = [s for s, size in zip(steps, sizes, strict=True) for _ in range(0, size, most)]
        unsound, divisor = (getattr(self, name, None) for name in ("found_inf", "grad_scale"))
        torch.ops.aten._foreach_add_.Scalar(steps, 1)
        torch.ops.aten._fused_adam_.tensor_lr(
            *pieces, [], owners, lr=group["lr"], beta1=group["betas"][0], beta2=group["betas"][1], eps=group["eps"],
            weight_decay=group["weight_decay"], amsgrad=False, maximize=False, grad_scale=divisor, found_inf=unsound,
        )  # fmt: skip
        if unsound is not None:
            torch.ops.aten._foreach_sub_.List(steps, [unsound] * len(steps))


class _SGD(_Uncompiled, SGD):
    step = torch.no_grad()(inspect.unwrap(SGD.step))  # type: ignore[assignment]


def adam(parameters: Sequence[nn.Parameter], rate: Tensor, *, weight_decay: float = 0.0) -> Adam:
    """Adam (Kingma and Ba 2015). `rate` () is read at every step; decay is added to the gradient."""
    optimiser = _Adam(
        parameters, rate, weight_decay=weight_decay, fused=True, capturable=rate.is_cuda
    )
    for p in parameters:  # as a first step makes them; so a checkpoint without them is a wrong one
        moments = {name: torch.zeros_like(p) for name in ("exp_avg", "exp_avg_sq")}
        optimiser.state[p] = {"step": torch.zeros((), device=p.device), **moments}
    return optimiser


def sgd(
    parameters: Sequence[nn.Parameter],
    rate: Tensor,
    *,
    momentum: float = 0.0,
    weight_decay: float = 0.0,
) -> SGD:
    """Gradient descent, with heavy-ball `momentum`: v ← momentum·v + g, θ ← θ - rate·v."""
    optimiser = _SGD(parameters, rate, momentum=momentum, weight_decay=weight_decay, fused=True)
    if momentum:  # made here: one that a skipped first step makes would hold whatever was in memory
        for p in parameters:
            optimiser.state[p]["momentum_buffer"] = torch.zeros_like(p)
    return optimiser


def gradient_views(parameters: Sequence[nn.Parameter], flat: Tensor) -> None:
    """Make the gradients of `parameters` views of `flat` (P,), so that one operation handles all of them."""
    sizes = [p.numel() for p in parameters]
    for p, piece in zip(parameters, flat.split(sizes), strict=True):
        p.grad = piece.view_as(p)


def differentiate(loss: Tensor, parameters: Sequence[nn.Parameter], flat: Tensor) -> None:
    """Write the gradient of `loss` () with respect to `parameters` into `flat` (P,)."""
    gradients = torch.autograd.grad(loss, parameters, materialize_grads=True)
    torch.cat([g.flatten() for g in gradients], out=flat)


def step(optimiser: Optimizer, unsound: Tensor, divisor: Tensor | None = None) -> None:
    """One step with the gradients divided by `divisor` (); if `unsound` () is 1.0 instead of 0.0, weights and
    moments stay as they were.

    Both happen within the optimiser's own kernel, without waiting for the GPU.
    """
    optimiser.found_inf = unsound  # pyright: ignore[reportAttributeAccessIssue]
    optimiser.grad_scale = divisor  # pyright: ignore[reportAttributeAccessIssue]
    optimiser.step()


def state_of(optimiser: Optimizer) -> State:
    """Moments by parameter position; none of descent without momentum."""
    parameters = optimiser.param_groups[0]["params"]
    return {
        str(i): {k: v.clone() for k, v in optimiser.state[p].items()}
        for i, p in enumerate(parameters)
        if p in optimiser.state
    }


def load_state(optimiser: Optimizer, state: State) -> None:
    """Restore what :func:`state_of` returned; a ValueError if it belongs to other parameters."""
    parameters = optimiser.param_groups[0]["params"]
    adaptive = "betas" in optimiser.defaults
    names = {"step", "exp_avg", "exp_avg_sq"} if adaptive else {"momentum_buffer"}
    wanted = len(parameters) if optimiser.state else 0
    if len(state) != wanted:
        raise ValueError(f"moments of {len(state)} parameters, and there are {wanted}")
    for i, p in enumerate(parameters if state else ()):
        for name in names:
            value, shape = state[str(i)][name], () if name == "step" else p.shape
            least = -torch.inf if name in ("exp_avg", "momentum_buffer") else 0.0
            sound = value.isfinite() & (value >= least)
            if value.shape != shape or value.dtype != torch.float32 or not sound.all():
                raise ValueError(f"'{name}' of parameter {i} is not one of this optimiser")
        optimiser.state[p] = {k: v.clone().to(p.device) for k, v in state[str(i)].items()}


def refuse_hopeless(bad: int, patience: int, what: str = "optimiser steps") -> None:
    """Raise an error once `patience` of `what` in a row were not finite."""
    if bad >= patience:
        raise TrainingError(
            f"{bad} {what} in a row had a non-finite loss or gradient. The usual causes "
            "are too high a learning rate, or rewards that are huge; the weights are those before "
            "the first of them."
        )
