"""Motions to show."""

from __future__ import annotations

import pytest
import torch

from understudy_characters.character import Character
from understudy_humanoid.clips import generated_walk
from understudy_motion.clip import Clip


@pytest.fixture(scope="session")
def walk() -> Clip:
    return generated_walk()


@pytest.fixture(scope="session")
def standing(humanoid: Character) -> Clip:
    """The zero pose for two seconds, at ten frames a second."""
    times = torch.arange(21, dtype=torch.float64) / 10
    qpos = torch.tensor(humanoid.model.qpos0, dtype=torch.float64).repeat(21, 1)
    return humanoid.clip(qpos, times, name="standing")
