"""What the doctor says: findings, each with its place, its size and its remedy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from understudy_motion.clip import Clip

__all__ = ["Severity"]


class Severity(StrEnum):
    """How much a finding matters."""

    MINOR = "minor"  #: worth knowing; training copes with it
    MAJOR = "major"  #: the character cannot follow this, or learns what is wrong with it


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with a clip."""

    kind: str  #: stable identifier, listed in the README
    severity: Severity
    what: str  #: in words, without the place and without the remedy
    first: int  #: frame
    last: int  #: frame, inclusive
    start: float  #: s
    stop: float  #: s
    joints: tuple[str, ...]
    value: float  #: how bad
    unit: str
    remedy: str  #: what to do; a command where one does it

    @property
    def when(self) -> str:
        """Its time, in words."""
        single = self.first == self.last
        return f"{self.start:.2f} s" if single else f"{self.start:.2f}–{self.stop:.2f} s"

    @property
    def frames(self) -> str:
        """Its frames, in words."""
        single = self.first == self.last
        return f"frame {self.first}" if single else f"frames {self.first}–{self.last}"

    def line(self) -> str:
        """The finding as one line of text."""
        who = " ".join((self.kind, ", ".join(self.joints))).strip()
        return f"{self.severity}: {who} at {self.when} ({self.frames}): {self.what}. {self.remedy}"


def severity(value: float, major: float) -> Severity:
    """Major from `major` on."""
    return Severity.MAJOR if value >= major else Severity.MINOR


@dataclass(frozen=True)
class Places:
    """Makes findings of a clip at frames of it."""

    clip: Clip

    def finding(
        self,
        kind: str,
        level: Severity,
        what: str,
        frames: tuple[int, int] | None,
        value: float,
        unit: str,
        remedy: str,
        joints: Sequence[str] = (),
    ) -> Finding:
        """The finding at `frames` (first, last), or at the whole clip."""
        first, last = frames or (0, self.clip.num_frames - 1)
        start, stop = self.clip.times[[first, last]].tolist()
        return Finding(
            kind, level, what, first, last, start, stop, tuple(joints), value, unit, remedy
        )


def intervals(mask: np.ndarray, *, close: int = 0, least: int = 1) -> list[tuple[int, int]]:
    """The (first, last) indices of the runs of true in `mask` (F,).

    Gaps of up to `close` are part of a run; runs shorter than `least` are left out.
    """
    inside = np.flatnonzero(mask)
    if len(inside) == 0:
        return []
    parts = np.split(inside, np.flatnonzero(np.diff(inside) > close + 1) + 1)
    return [(int(p[0]), int(p[-1])) for p in parts if p[-1] - p[0] + 1 >= least]
