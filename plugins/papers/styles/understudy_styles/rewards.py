"""Style rewards (thesis, eq. 3.4, 3.5 and 3.6), to be multiplied with survival and regularity (eq. 3.8)."""

from __future__ import annotations

import torch
from torch import Tensor

from understudy_tensors.limits import limits


@limits(least=(0, 1e6), most=(0, 1e6))
def low_energy(
    kinetic_energy: Tensor,
    *,
    least: float = 20.0,  #: E_min, J: energy up to which the reward is 1 (section 3.5.3)
    most: float = 100.0,  #: E_max, J: energy from which on the reward is 0 (section 3.5.3)
) -> Tensor:
    """clamp((E_max - E) / (E_max - E_min), 0, 1), of E (N,) J (eq. 3.4; section 3.5.3)."""
    return ((most - kinetic_energy) / (most - least)).clamp(0.0, 1.0)


@limits(least=(0, 1e6), most=(0, 1e6))
def high_energy(
    kinetic_energy: Tensor,
    *,
    least: float = 20.0,  #: E_min, J: energy up to which the reward is 0 (section 3.5.3)
    most: float = 100.0,  #: E_max, J: energy from which on the reward is 1 (section 3.5.3)
) -> Tensor:
    """clamp((E - E_min) / (E_max - E_min), 0, 1), of E (N,) J (eq. 3.4; section 3.5.3)."""
    return ((kinetic_energy - least) / (most - least)).clamp(0.0, 1.0)


@limits(scale=(1e-9, 1e3))
def small_volume(
    hull_volume: Tensor,
    *,
    scale: float = 0.12,  #: α, m³: volume at which the reward is 1/e (section 3.5.3)
) -> Tensor:
    """exp(-V / α), of V (N,) m³ (eq. 3.5; section 3.5.3)."""
    return torch.exp(-hull_volume / scale)


@limits(scale=(1e-9, 1e3))
def large_volume(
    hull_volume: Tensor,
    *,
    scale: float = 0.12,  #: α, m³: volume at which the reward is 1 - 1/e (section 3.5.3)
) -> Tensor:
    """1 - exp(-V / α), of V (N,) m³ (eq. 3.5; section 3.5.3)."""
    return 1.0 - torch.exp(-hull_volume / scale)


@limits(scale=(1e-9, 1e6))
def near(
    gram_distance: Tensor,
    *,
    #: α, in the distance's unit, above 0
    scale: float = 1.0,
) -> Tensor:
    """exp(-‖G_s - G‖ / α) (eq. 3.6), of the distance (N,) in the units of
    :class:`~understudy_styles.gram.GramDistance`."""
    return torch.exp(-gram_distance / scale)
