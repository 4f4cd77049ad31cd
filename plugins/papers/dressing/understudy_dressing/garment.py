"""What the tasks ask of a garment, whatever it is."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

import numpy as np

from understudy_cloth.scene import ClothScene
from understudy_dressing.drawing import FELT, Felt
from understudy_dressing.person import Side


class GarmentScene(ClothScene):
    """A garment with sleeves, V vertices and F triangles."""

    recorded = (*ClothScene.recorded, *FELT)

    def marks(self, tracks: Mapping[str, np.ndarray]) -> Felt | None:
        """What the person feels, where that was recorded."""
        return Felt(tracks) if all(name in tracks for name in self.recorded) else None

    @property
    @abstractmethod
    def laid_out(self) -> np.ndarray:
        """(V, 3) m: open, so that distances along it can be taken."""

    @property
    @abstractmethod
    def faces(self) -> np.ndarray:
        """(F, 3), facing out."""

    @property
    @abstractmethod
    def corners(self) -> np.ndarray:
        """(F, 3, 2) or (F, 3, 3) m: each triangle at rest."""

    @abstractmethod
    def sleeve(self, side: Side) -> Mapping[str, np.ndarray]:
        """The loops ``entrance``, ``middle`` and ``end`` of the sleeve of that arm: vertices in order, turning so that by
        the right hand the thumb points the way that the hand goes."""
