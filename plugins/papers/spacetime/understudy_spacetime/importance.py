"""Importance sampling of initial states (section 3.4.2, eq. 3.9)."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, InitialStates, Rollout, State
from understudy_characters.initial_states import EPISODE_FIELDS, reference_states
from understudy_characters.scene import reference_motion
from understudy_spacetime.segments import By, Segments, counted


class Importance(InitialStates):
    """Reference states, drawn more often from segments whose states have low returns (eq. 3.9)."""

    episode_fields = EPISODE_FIELDS
    rollout_fields = ("phase", "episode_step")

    @dataclass(frozen=True)
    class Options:
        segments: int = 20  #: n of eq. 3.9: how many segments the motion has, from 1
        uniform: float = 0.2  #: u of eq. 3.9, in [0, 1]: the share that is drawn evenly
        #: factor of the running average of returns from rollout to rollout, in [0, 1]
        decay: float = 0.9
        #: whose returns are w: of all states in a segment, or of those where episodes begin
        by: By = "visits"

        def __post_init__(self) -> None:
            check_range(self, "segments", least=1, most=10_000)
            check_range(self, "uniform", "decay", least=0, most=1)

    def __init__(self, options: Options, context: Context) -> None:
        self._reference = reference_motion(context)
        self._options = options
        self._segments = Segments(
            options.segments, uniform=options.uniform, decay=options.decay, device=context.device
        )

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        segment, within = self._segments.draw(streams)
        phase = (segment + within) / self._options.segments
        return reference_states(self._reference, phase * self._reference.duration)

    def update(self, rollout: Rollout) -> dict[str, float]:
        assert rollout.returns is not None
        of_segment = self._segments.of(rollout.fields["phase"].flatten())
        of_segment = counted(rollout, of_segment, self._options.by)
        probabilities = self._segments.update(of_segment, rollout.returns.flatten())
        return {"hardest_segment": float(probabilities.argmax())}

    def state_dict(self) -> State:
        return self._segments.state_dict()

    def load_state_dict(self, state: State) -> None:
        self._segments.load_state_dict(state)
