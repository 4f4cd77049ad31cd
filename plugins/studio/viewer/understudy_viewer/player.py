"""What is shown when: the page's clock."""

from __future__ import annotations

import numpy as np


class Player:
    """A clock over the `times` (F,) s of frames, from 0: plays, loops, steps. Knows no real time."""

    def __init__(self, times: np.ndarray) -> None:
        self.times = times
        self.playing, self.loop, self.speed = True, True, 1.0
        self.time = 0.0

    @property
    def duration(self) -> float:
        """Seconds from the first frame to the last."""
        return float(self.times[-1])

    @property
    def frame(self) -> int:
        """The frame that is shown: the last one that has begun."""
        return int(np.searchsorted(self.times, self.time, side="right")) - 1

    def advance(self, seconds: float) -> None:
        """Let `seconds` pass. Without loop, playing ends at the last frame."""
        if not self.playing:
            return
        self.time += seconds * self.speed
        if self.time < self.duration:
            return
        if self.loop:
            self.time %= self.duration
        else:
            self.time, self.playing = self.duration, False

    def play(self) -> None:
        """Go on, from the beginning if the end is reached."""
        if self.time >= self.duration:
            self.time = 0.0
        self.playing = True

    def seek(self, time: float) -> None:
        """Show the frame nearest to `time` s."""
        self.time = float(self.times[np.abs(self.times - time).argmin()])

    def step(self, frames: int) -> None:
        """Pause, `frames` further on, around the ends if it loops."""
        self.playing = False
        frame, last = self.frame + frames, len(self.times) - 1
        frame = frame % (last + 1) if self.loop else min(max(frame, 0), last)
        self.time = float(self.times[frame])
