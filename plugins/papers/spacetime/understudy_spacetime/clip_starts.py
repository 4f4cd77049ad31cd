"""Starts in the clip, for evaluations and trainings: its beginning, a part of it, or where it can be flown."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, InitialStates
from understudy_characters.initial_states import EPISODE_FIELDS, reference_states
from understudy_characters.letting_go import LettingGo, let_go
from understudy_characters.scene import CharacterScene, reference_motion
from understudy_motion.section import Motion


class ClipStart(InitialStates):
    """The clip's beginning, where a performance of the skill would begin.

    Episodes begin within the first `window` s, so that they differ.
    """

    episode_fields = EPISODE_FIELDS

    @dataclass(frozen=True)
    class Options:
        #: s from the clip's beginning within which episodes begin; 0: always at the first frame
        window: float = 0.1

        def __post_init__(self) -> None:
            check_range(self, "window", least=0)

    def __init__(self, options: Options, context: Context) -> None:
        self._reference = reference_motion(context)
        self._window, lasts = options.window, self._reference.duration
        if self._window > lasts:
            raise ConfigError(
                f"initial_states.window={self._window:g} is not possible: the clip lasts {lasts:.4g} s. Give less."
            )

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        return reference_states(self._reference, streams.uniform(1).squeeze(1) * self._window)


class Phases(InitialStates):
    """Uniformly between two phases of the clip, to judge a part of it by itself."""

    episode_fields = EPISODE_FIELDS

    @dataclass(frozen=True)
    class Options:
        low: float = 0.0  #: phase, in [0, 1), from which on episodes begin
        high: float = 1.0  #: phase, above `low` and at most 1, before which they begin

        def __post_init__(self) -> None:
            check_range(self, "low", "high", least=0, most=1)
            if self.low >= self.high:
                raise ValueError(
                    f"low={self.low:g} is not possible: it must be less than high={self.high:g}."
                )

    def __init__(self, options: Options, context: Context) -> None:
        self._reference, self._options = reference_motion(context), options

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        low, high = self._options.low, self._options.high
        phase = low + (high - low) * streams.uniform(1).squeeze(1)
        return reference_states(self._reference, phase * self._reference.duration)


class Flyable(InitialStates):
    """Any time of the clip, except those from which a body that is let go, in the clip's state and at the height
    that training uses, lands outside the bounds (:func:`~understudy_characters.letting_go.let_go`).

    From most of the excepted times, no policy can follow the clip. The run's page says how many there are.
    """

    episode_fields = EPISODE_FIELDS

    def __init__(self, options: None, context: Context) -> None:
        self._reference = reference_motion(context)
        found = fall_of(context)
        times = torch.from_numpy(found.times[~found.bad]).float()
        if not len(times):
            raise ConfigError(
                "initial_states 'spacetime/flyable': from no start in this clip does a body that is let go land within "
                "the bounds. Repair the clip (understudy motion check CLIP --fix OUT)."
            )
        self._times = times.to(context.device)
        self._apart = self._reference.duration / len(found.times)

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        drawn, within = streams.uniform(2).unbind(1)
        row = (drawn * len(self._times)).long().clamp(max=len(self._times) - 1)
        # the start represents half a step to either side
        time = self._times[row] + (within - 0.5) * self._apart
        return reference_states(self._reference, time.clamp(0.0, self._reference.duration))


def fall_of(context: Context) -> LettingGo:
    """What happens to the task's character when it is let go in the states of its clip."""
    scene = context.need_scene(CharacterScene, "initial_states 'spacetime/flyable'")
    motion = context.need_section("motion", Motion, "initial_states 'spacetime/flyable'")
    return context.once("let_go", lambda: let_go(motion.clip, scene.character, motion.floor))
