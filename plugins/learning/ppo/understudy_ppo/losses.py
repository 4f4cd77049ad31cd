"""What proximal policy optimisation minimises (Schulman et al. 2017; equation numbers are theirs)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.options import check_range


def clipped_surrogate(ratio: Tensor, advantages: Tensor, clip: float | None) -> Tensor:
    """E[min(r A, clip(r, 1 - ε, 1 + ε) A)] (eq. 7), or E[r A] without clip (eq. 6).

    Parameters
    ----------
    ratio, advantages : (B,)
        r = π(a|s) / π_old(a|s), and A.
    """
    gain = ratio * advantages
    if clip is not None:  # the lesser is never above (1 ± ε) A, with the sign of A
        gain = gain.clamp(max=torch.add(advantages, advantages.abs(), alpha=clip))
    return gain.mean()


@dataclass(frozen=True)
class KLPenalty:
    """β KL[π_old, π], added to the loss (eq. 8), with β adapted after each update (section 4).

    Zhang et al. 2020 (eq. 4) have it beside the clipped surrogate, printed with a minus in a loss that is
    minimised. They write KL[π, π_old], which differs from this in third order of the step.
    """

    coefficient: float = 1.0  #: β of the first update; "not important in practice", it adapts fast
    target: float = 0.01  #: d_targ, the divergence that an update should make

    def __post_init__(self) -> None:
        check_range(self, "coefficient", "target", above=0)

    def adapted(self, coefficient: float, divergence: float) -> float:
        """β for the next update, after one that made `divergence`."""
        if not divergence <= self.target * 1.5:  # also where it is not finite
            return coefficient * 2.0
        if divergence < self.target / 1.5:
            return coefficient / 2.0
        return coefficient
