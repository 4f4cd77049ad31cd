"""What the tasks ask of a garment, whatever it is."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from functools import cached_property

import numpy as np

from understudy_cloth.garments import Garment
from understudy_cloth.scene import ClothModel, ClothScene
from understudy_dressing.body import Side
from understudy_dressing.drawing import FELT, Felt


class Alone(ClothScene):
    """Cloth without a task, to be laid out or put on before one."""

    finer = "scenes.cloth.substeps, in 10 ms"  # of a shirt; what others have suits the meshes that they take

    def __init__(self, model: ClothModel) -> None:
        self._model = model

    def model(self) -> ClothModel:
        return self._model


class GarmentScene(ClothScene):
    """A garment with sleeves, V vertices and F triangles."""

    recorded = (*ClothScene.recorded, *FELT)
    #: Whose sleeve it is held by, if it has two and is.
    held: Side | None = None

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


class CutGarment(GarmentScene):
    """One that is cut flat and sewn (:mod:`understudy_cloth.patterns`)."""

    @property
    def substeps(self) -> int:
        """Of 10 ms, while it is put on before an episode."""
        return 10

    @cached_property
    @abstractmethod
    def garment(self) -> Garment:
        """As it was cut."""

    @cached_property
    @abstractmethod
    def begins(self) -> np.ndarray:
        """(V, 3) m, world frame: where it is before it settles."""

    @property
    def laid_out(self) -> np.ndarray:
        return self.garment.positions

    @property
    def faces(self) -> np.ndarray:
        return self.garment.faces

    @property
    def corners(self) -> np.ndarray:
        assert self.garment.rest is not None
        return self.garment.rest

    def sleeve(self, side: Side) -> Mapping[str, np.ndarray]:
        out = 1.0 if side == "left" else -1.0
        return {
            part: self.turned(self.garment.loops[f"{side}_{part}"], (0.0, out, 0.0))
            for part in ("entrance", "middle", "end")
        }

    def turned(self, loop: np.ndarray, way: tuple[float, float, float]) -> np.ndarray:
        """The loop so that its area vector, as it begins, goes that way."""
        x = self.begins[loop]
        area = np.cross(x - x.mean(0), np.roll(x, -1, axis=0) - x.mean(0)).sum(axis=0)
        return loop if area @ np.array(way) > 0 else loop[::-1].copy()
