"""What stands around a character: chairs, bars, rooms."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

import mujoco
import numpy as np

__all__ = ["Surroundings"]


class Surroundings(ABC):
    """A config section of this type adds to the model of ``scene=character``.

    Its bodies have no joints; bodies whose place differs between worlds or episodes are mocap bodies.
    """

    #: Fields that :meth:`place` wants recorded, where the task has them.
    recorded: tuple[str, ...] = ()

    @abstractmethod
    def add(self, spec: mujoco.MjSpec) -> None:
        """Add bodies and sensors to the character's model. A geom that collides is made so by
        :func:`understudy_characters.staging.make_solid`; others have no contype."""

    def place(  # noqa: B027 - most stand where the model has them
        self, model: mujoco.MjModel, data: mujoco.MjData, recorded: Mapping[str, np.ndarray]
    ) -> None:
        """Put them where they were in a frame of a recording with the fields `recorded`."""
