"""A Gaussian process over the unit cube and the fidelity, through BoTorch, in float64."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, replace
from typing import Any, Literal

import torch
from torch import Tensor

from understudy import random
from understudy.options import check_range
from understudy_bayes.book import Book, Data
from understudy_bayes.libraries import (
    BotorchWarning,
    ConstantMean,
    ExactMarginalLogLikelihood,
    GreaterThan,
    Kernel,
    LogNormalPrior,
    Mean,
    ModelFittingError,
    NormalPrior,
    ProductKernel,
    RBFKernel,
    SingleTaskGP,
    directly,
    fit_gpytorch_mll,
    get_covar_module_with_dim_scaled_prior,
)
from understudy_bayes.space import Space

__all__ = ["Surrogate", "SurrogateOptions", "fitted"]


@dataclass(frozen=True)
class SurrogateOptions:
    """Priors on length scales in the unit cube are BoTorch's (Hvarfner et al. 2024), log-normal with
    a location that grows with √d; noise is log-normal of location -4, at least 1e-4 of y's variance."""

    kernel: Literal["se", "matern"] = "se"  #: squared exponential (eq. 6.2), or Matérn 5/2
    #: Mode and log-deviation of the log-normal prior on the fidelity kernel's length scale l_z; null is
    #: the search's own mode.
    fidelity_scale: float | None = None
    #: standard deviation of the logarithm of the fidelity's length scale, above 0
    fidelity_spread: float = 0.75
    #: Standard deviation, in y's, of the normal prior on the slope in z of the Gaussian process's mean,
    #: which takes a shift between fidelities that all points share; 0 is no slope, null the search's own.
    slope: float | None = None

    def __post_init__(self) -> None:
        check_range(self, "fidelity_scale", "fidelity_spread", above=0)
        check_range(self, "slope", least=0)

    def otherwise(self, fidelity_scale: float, slope: float) -> SurrogateOptions:
        """With these where nothing was chosen."""
        return replace(
            self,
            fidelity_scale=fidelity_scale if self.fidelity_scale is None else self.fidelity_scale,
            slope=slope if self.slope is None else self.slope,
        )


class Surrogate:
    """k((x, z), (x', z')) = k(x, x') k_SE(z, z') (eq. 6.2) about a constant mean, or one that is a line in
    z, fitted to `data`.

    Length scales of x are one per dimension. y is standardised to mean 0 and variance 1; all that is
    returned is in these units, in which the prior's variance is 1 (``scale`` is one such unit in
    units of y). Hyper-parameters are the most probable ones, found by L-BFGS from the priors' modes.
    Whatever the fit draws depends on `seed` alone. With a `space`, a place between two values of an
    integer parameter is the one that would be trained.
    """

    def __init__(
        self, options: SurrogateOptions, data: Data, seed: int = 0, space: Space | None = None
    ) -> None:
        spread = data.y.std() if len(data.y) > 1 else torch.zeros(())
        self.scale = float(spread) if spread > 1e-12 * (1 + data.y.abs().max()) else 1.0
        self._d, self._taken = data.x.shape[1], space.rounded if space else _as_is
        self._x, self._y = _joined(data.x, data.z), (data.y - data.y.mean()) / self.scale
        self._space = get_covar_module_with_dim_scaled_prior(
            self._d, use_rbf_kernel=options.kernel == "se", active_dims=tuple(range(self._d))
        )
        options = options.otherwise(fidelity_scale=0.3, slope=0.0)
        assert options.fidelity_scale is not None
        assert options.slope is not None
        location = math.log(options.fidelity_scale) + options.fidelity_spread**2
        prior = LogNormalPrior(location, options.fidelity_spread)
        self._fidelity = RBFKernel(
            active_dims=(self._d,),
            lengthscale_prior=prior,
            lengthscale_constraint=GreaterThan(
                0.025,
                transform=None,  # type: ignore[arg-type]
                initial_value=prior.mode,
            ),
        )
        self._kernel: Kernel = ProductKernel(self._space, self._fidelity).double()
        with warnings.catch_warnings(), random.private_rng(seed, "surrogate"):
            warnings.simplefilter("ignore", BotorchWarning)
            self._model = SingleTaskGP(
                self._x,
                self._y.unsqueeze(1),
                covar_module=self._kernel,
                mean_module=_Line(options.slope) if options.slope > 0 else None,
                outcome_transform=None,
            )
            self._fit()
        self._model.eval()

    def _fit(self) -> None:
        model = self._model
        begin = {name: value.clone() for name, value in model.state_dict().items()}
        likelihood = ExactMarginalLogLikelihood(model.likelihood, model)
        try:
            with directly():
                fit_gpytorch_mll(likelihood, optimizer_kwargs={"options": {"maxiter": 200}})
        except ModelFittingError:  # nothing can be learned from these: the priors' modes stay
            model.load_state_dict(begin)

    def believe(self, x: Tensor, z: Tensor) -> None:
        """Take the trials at `x` (m, d), `z` (m,), which still run, to give what the model expects
        of them ("kriging believer"), so that the next one is asked for elsewhere."""
        if len(x) == 0:
            return
        with torch.no_grad():
            mean, _ = self.posterior(x, z)
        self._x = torch.cat([self._x, _joined(x, z)])
        self._y = torch.cat([self._y, mean])
        self._model.set_train_data(self._x, self._y, strict=False)
        self._model.eval()

    def posterior(self, x: Tensor, z: Tensor) -> tuple[Tensor, Tensor]:
        """Mean (m,) and standard deviation (m,) of the function, without noise, at `x` (m, d) and
        fidelities `z` (m,)."""
        with directly():
            found = self._model.posterior(_joined(self._taken(x), z))
            mean, variance = found.mean, found.variance
        assert isinstance(mean, Tensor)
        assert isinstance(variance, Tensor)
        return mean.squeeze(-1), variance.squeeze(-1).clamp(min=1e-12).sqrt()

    def correlation(self, x: Tensor, z: Tensor, xs: Tensor, zs: Tensor) -> Tensor:
        """k((x, z), (x_i, z_i)) (n,) of one place `x` (d,), `z` () with `xs` (n, d), `zs` (n,)."""
        with torch.no_grad():
            one = _joined(self._taken(x.unsqueeze(0)), z.reshape(1))
            return self._kernel(one, _joined(xs, zs)).to_dense()[0]

    @property
    def fidelity_scale(self) -> float:
        """l_z: the length scale of the fidelity's kernel."""
        return float(self._fidelity.lengthscale.detach())

    @property
    def length_scales(self) -> list[float]:
        """Of each dimension of x, in the unit cube; a short one means a sensitive parameter."""
        return self._space.lengthscale.detach().reshape(-1).tolist()

    @property
    def noise(self) -> float:
        """Standard deviation of the noise."""
        variance: Any = self._model.likelihood.noise
        return float(variance.detach().sqrt())


class _Line(Mean):
    """m(x, z) = constant + slope z."""

    slope: torch.nn.Parameter

    def __init__(self, deviation: float) -> None:
        super().__init__()
        self.constant = ConstantMean()
        self.register_parameter("slope", torch.nn.Parameter(torch.zeros(())))
        self.register_prior("slope_prior", NormalPrior(0.0, deviation), "slope")

    def forward(self, x: Tensor) -> Tensor:
        constant = self.constant(x)
        assert isinstance(constant, Tensor)
        return constant + self.slope * x[..., -1]


def _as_is(x: Tensor) -> Tensor:
    return x


def _joined(x: Tensor, z: Tensor) -> Tensor:
    return torch.cat([x, z.to(x).reshape(-1, 1).expand(len(x), 1)], dim=1)


def fitted(book: Book, options: SurrogateOptions, seed: int) -> Surrogate | None:
    """The model of what the trials in `book` gave, those that run taken as expected; None before the
    first is finished."""
    if not book.reports:
        return None
    model = Surrogate(options, book.data(), seed, book.space)
    model.believe(*book.places(book.pending))
    return model
