"""What stands around a character beside the floor: a bar and a mat, a chair."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

import mujoco
import numpy as np


class Surroundings(ABC):
    """Made from a config section; the scene ``character`` builds every section that is one."""

    #: Fields that :meth:`place` wants recorded, where the task has them.
    recorded: tuple[str, ...] = ()

    @abstractmethod
    def build(self, spec: mujoco.MjSpec) -> None:
        """Add to the model what is there, in bodies of its own."""

    @abstractmethod
    def place(
        self, model: mujoco.MjModel, data: mujoco.MjData, frame: Mapping[str, np.ndarray]
    ) -> None:
        """Put it, in a compiled model that is drawn, where one recorded `frame` has it."""
