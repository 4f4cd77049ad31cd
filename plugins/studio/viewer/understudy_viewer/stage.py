"""Everything that the page shows, on one time line; no browser is needed for it.

F frames. What stands side by side is seen at the same times: all frames of all motions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import gaussian_filter1d
from torch import Tensor

from understudy_characters.character import Character
from understudy_characters.overlay import Gauge, Region
from understudy_motion.clip import Clip
from understudy_mujoco.studio import LEARNED, REFERENCE
from understudy_viewer.figure import Figure, figure

__all__ = ["COLOURS", "Colour"]

Colour = tuple[int, int, int]

#: Of the first figure and of the second: as in a run's video.
COLOURS: tuple[Colour, ...] = tuple(
    (round(255 * r), round(255 * g), round(255 * b)) for r, g, b, _ in (LEARNED, REFERENCE)
)
#: Frames of several motions that are no further apart than this share of the whole are one.
_SAME_TIME = 1e-6
#: What the camera follows is the path, smoothed by a Gaussian of this width in s, and at most of so
#: many frames.
_SMOOTHING, _WIDEST = 0.25, 100.0


@dataclass(frozen=True)
class Subject:
    """A motion to show."""

    clip: Clip
    character: Character | None = None  #: what it is drawn as; bones if None
    origin: tuple[float, float] = (0.0, 0.0)  #: m: the place that is put in the page's middle
    role: str = ""  #: what it is in a run


@dataclass(frozen=True)
class Scene:
    """What there is to show: motions, and for a run what its task draws over them."""

    subjects: Sequence[Subject]
    marks: Sequence[Gauge | Region] = ()  #: of the frames of the first motion
    notes: Sequence[str] = ()


@dataclass(frozen=True)
class Actor:
    """A subject on the stage."""

    subject: Subject
    figure: Figure
    colour: Colour


@dataclass(frozen=True)
class Stage:
    """All that is drawn."""

    times: np.ndarray  #: (F,) s, from 0
    actors: tuple[Actor, ...]
    gauges: tuple[Gauge, ...]
    regions: tuple[Region, ...]
    notes: tuple[str, ...]
    focus: np.ndarray  #: (F, 2) m: what the camera follows, from the origins

    @property
    def duration(self) -> float:
        """Seconds."""
        return float(self.times[-1])

    @property
    def reach(self) -> float:
        """Of the largest figure, m, and never nothing."""
        return max(0.1, *(actor.figure.reach for actor in self.actors))


def build(scene: Scene) -> Stage:
    """The stage of `scene`.

    Raises
    ------
    FileError
        as :func:`figure`.
    """
    times = shared_times([subject.clip for subject in scene.subjects])
    actors = tuple(
        Actor(subject, figure(subject.clip, subject.character, times), colour)
        for subject, colour in zip(scene.subjects, COLOURS, strict=False)
    )
    paths = [actor.figure.root[:, :2] - actor.subject.origin for actor in actors]
    return Stage(
        times=times.numpy(),
        actors=actors,
        gauges=tuple(mark for mark in scene.marks if isinstance(mark, Gauge)),
        regions=tuple(mark for mark in scene.marks if isinstance(mark, Region)),
        notes=tuple(scene.notes),
        focus=_smoothed(np.mean(paths, axis=0), times.numpy()),
    )


def shared_times(clips: Sequence[Clip]) -> Tensor:
    """(F,) s: the times of all frames of all `clips`, each once."""
    if len(clips) == 1:
        return clips[0].times
    times = np.concatenate([clip.times.numpy() for clip in clips])
    ticks = np.round(times / (_SAME_TIME * times.max()))
    _, first = np.unique(ticks, return_index=True)
    return torch.from_numpy(times[first])


def _smoothed(path: np.ndarray, times: np.ndarray) -> np.ndarray:
    width = min(_SMOOTHING * (len(times) - 1) / times[-1], _WIDEST)
    beyond = min(math.ceil(4.0 * width), len(path) - 1)
    # Going on at the ends as it came, it does not stop there.
    longer = np.pad(path, ((beyond, beyond), (0, 0)), mode="reflect", reflect_type="odd")
    return gaussian_filter1d(longer, width, axis=0, mode="nearest")[beyond : beyond + len(path)]
