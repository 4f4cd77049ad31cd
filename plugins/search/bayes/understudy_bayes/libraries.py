"""What is used of BoTorch and GPyTorch, or one sentence about how to get them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

try:
    from botorch.exceptions import BotorchWarning, ModelFittingError
    from botorch.fit import fit_gpytorch_mll
    from botorch.generation.gen import gen_candidates_scipy
    from botorch.models import SingleTaskGP
    from botorch.models.utils.gpytorch_modules import get_covar_module_with_dim_scaled_prior
    from gpytorch.constraints import GreaterThan
    from gpytorch.kernels import Kernel, ProductKernel, RBFKernel
    from gpytorch.means import ConstantMean, Mean
    from gpytorch.mlls import ExactMarginalLogLikelihood
    from gpytorch.priors import LogNormalPrior, NormalPrior
    from gpytorch.settings import debug, lazily_evaluate_kernels
except ImportError as error:
    raise ImportError(
        "searches with a model need BoTorch: pip install 'understudy[bayes]'"
    ) from error

__all__ = [
    "BotorchWarning",
    "ConstantMean",
    "ExactMarginalLogLikelihood",
    "GreaterThan",
    "Kernel",
    "LogNormalPrior",
    "Mean",
    "ModelFittingError",
    "NormalPrior",
    "ProductKernel",
    "RBFKernel",
    "SingleTaskGP",
    "directly",
    "fit_gpytorch_mll",
    "gen_candidates_scipy",
    "get_covar_module_with_dim_scaled_prior",
]


@contextmanager
def directly() -> Iterator[None]:
    """Inside, GPyTorch does not check itself, a seventh of the time, and evaluates kernels at once, a tenth: that they
    wait is for many more points than a search has. No bit changes."""
    with debug(False), lazily_evaluate_kernels(False):
        yield
