"""What a policy decides: named boxes of numbers and named choices, side by side in one tensor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

Reach = float | tuple[float, ...]
Around = str | tuple[float, ...] | None


@dataclass(frozen=True)
class Box:
    """`size` real numbers, unbounded: the actuation decides their meaning and their limits.

    Learners that act in [-1, 1] cover what is within `reach` of `around`: 0, numbers, or the field
    of that name, (N, size).
    """

    size: int
    reach: Reach = 1.0
    around: Around = None

    @property
    def columns(self) -> int:
        return self.size


@dataclass(frozen=True)
class Choice:
    """One of `count` options; its column holds the option's number."""

    count: int

    @property
    def columns(self) -> int:
        return 1


@dataclass(frozen=True)
class ActionSpace:
    """Named parts of an action. An action tensor is (…, A), the parts' columns in this order."""

    parts: Mapping[str, Box | Choice]

    @property
    def size(self) -> int:
        """A."""
        return sum(part.columns for part in self.parts.values())

    def split(self, action: Tensor) -> dict[str, Tensor]:
        """The parts of `action` (…, A) by name: boxes (…, size), choices (…,) int64."""
        columns = action.split([part.columns for part in self.parts.values()], dim=-1)
        return {
            name: piece
            if isinstance(part, Box)
            else piece.squeeze(-1).long().clamp(0, part.count - 1)
            for (name, part), piece in zip(self.parts.items(), columns, strict=True)
        }


def box(size: int, reach: Reach = 1.0, around: Around = None) -> ActionSpace:
    """The space of `size` real numbers, named ``action``."""
    return ActionSpace({"action": Box(size, reach, around)})
