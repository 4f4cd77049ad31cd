"""The surrogate of g: a Gaussian process from the point of a trial to its feature (eq. 4.5, 4.16)."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

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
            self._model = SingleTaskGP(
                x,
                (f - self._middle) / self._half,
                covar_module=kernel,
                mean_module=ZeroMean(batch_shape=batch),
                outcome_transform=None,
            )
            likelihood = ExactMarginalLogLikelihood(self._model.likelihood, self._model)
            begin = {name: v.clone() for name, v in self._model.state_dict().items()}
            try:
                fit_gpytorch_mll(likelihood, optimizer_kwargs={"options": {"maxiter": 100}})
            except ModelFittingError:  # nothing can be learned from these: the priors' modes stay
                self._model.load_state_dict(begin)
        self._model.eval()
        self._x, self._f = x, f

    def believe(self, x: Tensor) -> Tensor:
        """Take trials at `x` (m, d), of which nothing is known, to show what is expected of them, so
        that the next one is asked for elsewhere; returns the features (m, k)."""
        with torch.no_grad():
            f, _ = self.posterior(x)
        self._x, self._f = torch.cat([self._x, x]), torch.cat([self._f, f])
        y = (self._f - self._middle) / self._half
        shared = self._x, y.squeeze(-1)
        if y.shape[1] > 1:
            shared = self._x.expand(y.shape[1], *self._x.shape), y.mT
        self._model.set_train_data(*shared, strict=False)
        self._model.eval()
        return f

    def posterior(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """μ_t and σ_t, each (m, k), without noise, at `x` (m, d), in the features' units."""
        found = self._model.posterior(x)
        mean, variance = found.mean, found.variance
        assert isinstance(mean, Tensor)
        assert isinstance(variance, Tensor)
        deviation = variance.clamp(min=1e-12).sqrt()
        return self._middle + self._half * mean, self._half * deviation
