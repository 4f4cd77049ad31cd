"""How likely hyper-parameters of a Gaussian process are, and its slopes, for n trials: one Cholesky factor and a
few products. GPyTorch's general modules find the same in some twenty times the time, nearly all of it Python's.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from torch import Tensor

from understudy_bayes.libraries import LogNormalPrior, NormalPrior, NotPSDError

__all__ = ["Likelihood", "log_density"]


class Likelihood:
    """Of trials at `points` (n, d + 1), their fidelities last, with values `y` (n,).

    The kernel is the squared exponential of all columns or, if `matern`, Matérn 5/2 of all but the
    last times the squared exponential of that.
    """

    def __init__(self, points: Tensor, y: Tensor, matern: bool) -> None:
        self._y, self._z, self._matern = y.numpy(), points[:, -1].numpy(), matern
        apart = (points.unsqueeze(1) - points).square()
        self._apart = apart.reshape(-1, points.shape[1]).numpy()  # (n², d + 1)

    def at(
        self, scales: np.ndarray, noise: float, constant: float, slope: float
    ) -> tuple[float, np.ndarray, float, float, float]:
        """log p(y), and its slopes in each.

        Parameters
        ----------
        scales
            (d + 1,) length scales.
        noise
            its variance.
        constant, slope
            of the mean, a line in the fidelity.
        """
        n, weights = len(self._y), scales**-2.0
        if self._matern:
            r = np.sqrt(5.0 * (self._apart[:, :-1] @ weights[:-1]))
            tail = np.exp(-r - 0.5 * weights[-1] * self._apart[:, -1])
            covariance, steep = (1.0 + r + r * r / 3.0) * tail, 5.0 / 3.0 * (1.0 + r) * tail
        else:
            covariance = steep = np.exp(-0.5 * (self._apart @ weights))
        try:
            root = np.linalg.cholesky(covariance.reshape(n, n) + noise * np.eye(n))
        except np.linalg.LinAlgError as error:
            raise NotPSDError(str(error)) from error
        half = np.linalg.inv(root)
        inverse = half.T @ half
        off = self._y - constant - slope * self._z
        pull = inverse @ off
        value = -0.5 * (off @ pull + n * math.log(2.0 * math.pi)) - np.log(np.diag(root)).sum()
        change = 0.5 * (np.outer(pull, pull) - inverse)
        flat = change.ravel()
        slopes = ((flat * steep) @ self._apart) * scales**-3.0
        if self._matern:
            slopes[-1] = (flat * covariance) @ self._apart[:, -1] * scales[-1] ** -3.0
        return (
            float(value),
            slopes,
            float(np.trace(change)),
            float(pull.sum()),
            float(pull @ self._z),
        )


def log_density(prior: Any, value: np.ndarray) -> tuple[float, np.ndarray]:
    """Of a normal or log-normal prior at several values, added up; and its slope in each."""
    location, scale = float(prior.loc), float(prior.scale)
    if isinstance(prior, LogNormalPrior):
        shift = (np.log(value) - location) / scale
        slope, size = -(shift / scale + 1.0) / value, scale * value
    else:
        assert isinstance(prior, NormalPrior)
        shift = (value - location) / scale
        slope, size = -shift / scale, np.full_like(value, scale)
    found = -0.5 * shift * shift - np.log(size * math.sqrt(2.0 * math.pi))
    return float(found.sum()), slope
