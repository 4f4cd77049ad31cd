"""The surrogate of g: a Gaussian process from the point of a trial to its feature (eq. 4.5, 4.16)."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import torch
from gpytorch.kernels import ScaleKernel
from gpytorch.means import ZeroMean
from torch import Tensor

from understudy import random
from understudy_bayes.libraries import (
    BotorchWarning,
    ExactMarginalLogLikelihood,
    LogNormalPrior,
    ModelFittingError,
    SingleTaskGP,
    directly,
    fit_gpytorch_mll,
    get_covar_module_with_dim_scaled_prior,
)
from understudy_diversity.strategies import Feature


class Surrogate:
    """Of n trials at `x` (n, d) in the unit cube with features `f` (n, k), one process for each feature.

    The prior mean is the middle of a feature's range; the kernel is Matérn 5/2, its scale θ and its
    length scales Λ the most probable ones. Priors: BoTorch's on Λ and on the noise η² (Hvarfner et al.
    2024), θ log-normal about half the range squared. float64; drawn from `seed` alone.
    """

    def __init__(self, x: Tensor, f: Tensor, features: Sequence[Feature], seed: int) -> None:
        low, high = torch.tensor([(a.low, a.high) for a in features], dtype=torch.float64).T
        self._middle, self._half = 0.5 * (low + high), 0.5 * (high - low)
        d, k = x.shape[1], len(features)
        batch = torch.Size([k]) if k > 1 else torch.Size()
        with warnings.catch_warnings(), random.private_rng(seed, "diversity/surrogate"):
            warnings.simplefilter("ignore", BotorchWarning)
            matern = get_covar_module_with_dim_scaled_prior(
                ard_num_dims=d, batch_shape=batch, use_rbf_kernel=False
            )
            prior = LogNormalPrior(0.0, 0.75)
            kernel = ScaleKernel(matern, batch_shape=batch, outputscale_prior=prior).double()
            #: BoTorch's, whose hyper-parameters are used.
            self.model = model = SingleTaskGP(
                x,
                (f - self._middle) / self._half,
                covar_module=kernel,
                mean_module=ZeroMean(batch_shape=batch),
                outcome_transform=None,
            )
            likelihood = ExactMarginalLogLikelihood(model.likelihood, model)
            begin = {name: v.clone() for name, v in model.state_dict().items()}
            try:
                with directly():
                    fit_gpytorch_mll(likelihood, optimizer_kwargs={"options": {"maxiter": 100}})
            except ModelFittingError:  # nothing can be learned from these: the priors' modes stay
                model.load_state_dict(begin)
        noise: Any = model.likelihood.noise
        self._scales = matern.lengthscale.detach().reshape(k, 1, d)  # Λ^-½
        self._theta = kernel.outputscale.detach().reshape(k, 1, 1)
        self._noise = noise.detach().reshape(k, 1, 1)  # η²
        self._observe(x, f)

    def _observe(self, x: Tensor, f: Tensor) -> None:
        self._x, self._f = x, f
        noise = self._noise * torch.eye(len(x), dtype=x.dtype)
        self._root = torch.linalg.cholesky(self._kernel(x, x) + noise)
        y = ((f - self._middle) / self._half).mT.unsqueeze(-1)
        self._weights = torch.cholesky_solve(y, self._root)

    def _kernel(self, a: Tensor, b: Tensor) -> Tensor:
        """k(a, b) (k, m, n) (eq. 4.16)."""
        exact = "donot_use_mm_for_euclid_dist"
        d = torch.cdist(a / self._scales, b / self._scales, compute_mode=exact)
        return self._theta * (1 + 5**0.5 * d + 5 / 3 * d**2) * torch.exp(-(5**0.5) * d)

    def believe(self, x: Tensor) -> Tensor:
        """Take trials at `x` (m, d), of which nothing is known, to show what is expected of them, so
        that the next one is asked for elsewhere; returns the features (m, k)."""
        f, _ = self.posterior(x)
        self._observe(torch.cat([self._x, x]), torch.cat([self._f, f]))
        return f

    def posterior(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """μ_t and σ_t, each (m, k), without noise, at `x` (m, d), in the features' units (eq. 4.5).

        By the formula: DIRECT asks for a thousand points one by one, for which a library's posterior,
        made for many at once, takes ten times as long.
        """
        k = self._kernel(x, self._x)
        mean = (k @ self._weights).squeeze(-1)
        explained = torch.linalg.solve_triangular(self._root, k.mT, upper=False).square().sum(1)
        deviation = (self._theta.squeeze(-1) - explained).clamp(min=1e-12).sqrt()
        return self._middle + self._half * mean.mT, self._half * deviation.mT
