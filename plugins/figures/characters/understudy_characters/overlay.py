"""What a plugin has drawn over the recorded motion of a run of its tasks: limits, and what they limit.

An overlay is a component of kind ``overlay``. T frames, K things that one limit holds for.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from understudy.setup.registry import Registry

__all__ = ["Gauge", "Overlay", "Region"]


@dataclass(frozen=True)
class Gauge:
    """A number that has a limit."""

    name: str
    values: np.ndarray  #: (T,)
    limits: np.ndarray  #: (T,)
    unit: str


@dataclass(frozen=True)
class Region:
    """Where K points of the learned motion have to be: around as many of the reference."""

    name: str
    shape: Literal["box", "ball"]  #: a box has its sides along the world's axes
    centres: np.ndarray  #: (T, K, 3) m, world
    sizes: np.ndarray  #: (T,) m, half a side or the radius
    points: np.ndarray  #: (T, K, 3) m, world: what has to be inside


class Overlay(ABC):
    """Made without arguments."""

    @abstractmethod
    def marks(
        self, config: Mapping[str, Any], tracks: Mapping[str, np.ndarray], registry: Registry
    ) -> Sequence[Gauge | Region]:
        """What to draw; nothing for the run of another task.

        Parameters
        ----------
        config
            the run's configuration.
        tracks
            the recorded state fields by name, each (T, …): ``qpos``, and where the task has
            them ``reference_qpos`` and ``phase``.
        registry
            where the parts that the configuration names are found.

        Raises
        ------
        UnderstudyError
            the tracks do not say enough, or do not fit the task.
        """
