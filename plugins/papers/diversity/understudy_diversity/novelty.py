"""The reward that seeks policies unlike those that are known (thesis, section 4.5.2)."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.task import Context
from understudy_diversity.strategies import Metric, distances


class Novelty:
    """r_novelty = clip(min_i ‖f_i - f‖ / d_threshold, 0.01, 1) (eq. 4.11) of the field ``feature`` (N,) or
    (N, k); to be multiplied with the task's reward (eq. 4.14)."""

    @dataclass(frozen=True)
    class Options:
        found: tuple[tuple[float, ...], ...]  #: f_i, the features of the strategies that are known
        threshold: float = 0.5 * pi  #: d_threshold, in the features' unit, above 0 (eq. 4.11)
        metric: Metric = "euclidean"  #: or ``rotation``: the angle, of x axes and z axes

        def __post_init__(self) -> None:
            check_range(self, "threshold", above=0)
            if not self.found or len({len(f) for f in self.found}) != 1:
                raise ValueError("found must be features of the same length, one at least.")

    def __init__(self, options: Options, context: Context) -> None:
        self._options = options
        self._found = torch.tensor(options.found, device=context.device)

    def __call__(self, feature: Tensor) -> Tensor:
        feature = feature.view(len(feature), -1)
        if feature.shape[1] != self._found.shape[1]:
            raise ConfigError(
                f"reward 'diversity/novelty': the feature has {feature.shape[1]} numbers and those in "
                f"found have {self._found.shape[1]}. Read another field, or give other features."
            )
        nearest = distances(feature, self._found, self._options.metric).amin(-1)
        return (nearest / self._options.threshold).clamp(0.01, 1.0)
