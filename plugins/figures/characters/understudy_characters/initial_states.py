"""Episodes that begin in the reference motion."""

from __future__ import annotations

from torch import Tensor

from understudy.random import WorldStreams
from understudy.task import Context, InitialStates, Shape
from understudy_characters.reference import ReferenceMotion
from understudy_characters.scene import reference_motion

__all__ = ["EPISODE_FIELDS", "reference_states"]

EPISODE_FIELDS: dict[str, Shape] = {"motion_start": ()}


class ReferenceStates(InitialStates):
    """Reference-state initialisation (Peng et al. 2018): the clip's state at a uniformly drawn time."""

    episode_fields = EPISODE_FIELDS

    def __init__(self, options: None, context: Context) -> None:
        self._reference = reference_motion(context)

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        time = streams.uniform(1).squeeze(1) * self._reference.duration
        return reference_states(self._reference, time)


def reference_states(reference: ReferenceMotion, time: Tensor) -> dict[str, Tensor]:
    """What initial states return for episodes that begin at `time` (N,) s of the clip; a figure that is in the floor is
    raised out of it."""
    state = reference.sample(time)
    qpos = state["reference_qpos"]
    if reference.sinks:
        depth = -state["reference_link_clearances"].amin(1)
        qpos = reference.raised(qpos, depth.clamp(min=0.0))
    return {
        "qpos": qpos,
        "qvel": state["reference_qvel"],
        "motion_start": time,
    }
