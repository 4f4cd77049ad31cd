"""Initial states that evolve during a training (section 3.4.2, eq. 3.10), and those of another run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.errors import RunError
from understudy.options import at, check_range
from understudy.random import WorldStreams
from understudy.records.checkpoint import misshapen
from understudy.records.runs import newest_state
from understudy.task import Context, InitialStates, Rollout, State
from understudy_characters.initial_states import EPISODE_FIELDS, reference_states
from understudy_characters.scene import reference_motion
from understudy_spacetime.segments import By, Segments, counted


def boltzmann_draws(
    of_segment: Tensor, returns: Tensor, bits: Tensor, *, sign: float
) -> tuple[Tensor, Tensor]:
    """For each segment, states drawn with replacement by the weights of eq. 3.10, without waiting for the
    device.

    Weights are whole numbers (32 bits), so that their sums do not depend on the order of summation and
    draws repeat exactly.

    Parameters
    ----------
    of_segment
        (n, B) bool, the states of each segment.
    returns
        (B,) of the states.
    bits
        (n, m) int64 random bits, one for each draw.
    sign
        -1 prefers low returns, 1 high ones.

    Returns
    -------
    tuple[Tensor, Tensor]
        The rows (n, m) of the states drawn, and how many each segment has, (n,); where it has none
        the rows mean nothing.
    """
    low = torch.where(of_segment, returns, torch.inf).amin(1, keepdim=True)
    high = torch.where(of_segment, returns, -torch.inf).amax(1, keepdim=True)
    best = high if sign > 0 else low
    odds = torch.exp(sign * (returns - best) / (high - low).clamp(min=1e-6))  # in [1 / e, 1]
    weights = torch.where(of_segment, odds * 2.0**32, 0.0).long()
    sums = weights.cumsum(1)
    drawn = (bits & torch.iinfo(torch.int64).max) % sums[:, -1:].clamp(min=1)
    rows = torch.searchsorted(sums, drawn, right=True).clamp(max=len(returns) - 1)
    return rows, of_segment.sum(1)


class Evolution(InitialStates):
    """Initial states that evolve from the clip's into those the policy reaches (eq. 3.10).

    Each motion segment has a buffer of states, at first the reference's. After every rollout each
    buffer is overwritten by a Boltzmann draw, with weights exp(-w / v), from the states that were
    collected in its segment; w is the estimated return and v = max w - min w.
    """

    episode_fields = EPISODE_FIELDS
    rollout_fields = ("phase", "episode_step", "motion_time", "qpos", "qvel")

    @dataclass(frozen=True)
    class Options:
        segments: int = 20  #: how many segments the motion has, from 1, each with a buffer
        size: int = 32  #: how many states a buffer holds, from 1 (m of eq. 3.10)
        uniform: float = 0.2  #: share of segments drawn uniformly (eq. 3.9)
        #: factor of the running average of returns from rollout to rollout, in [0, 1]
        decay: float = 0.9
        #: whose returns count: of all states in a segment, or of those where episodes begin
        by: By = "visits"
        #: Share of episodes that begin in the reference itself.
        reference_share: float = 0.1
        #: ``low`` prefers states of low return, as eq. 3.10 is printed; ``high`` the opposite.
        prefer: str = "low"

        def __post_init__(self) -> None:
            if self.prefer not in ("low", "high"):
                raise ValueError(f"prefer={self.prefer} is not possible: low or high.")
            check_range(self, "segments", "size", least=1, most=10_000)
            check_range(self, "uniform", "decay", "reference_share", least=0, most=1)

    def __init__(self, options: Options, context: Context) -> None:
        self._reference, self._options = reference_motion(context), options
        self._segments = Segments(
            options.segments, uniform=options.uniform, decay=options.decay, device=context.device
        )
        #: One sequence of draws for each segment.
        self._draws = WorldStreams(context.seed, "evolution", options.segments, context.device)
        n, m = options.segments, options.size
        phase = (torch.arange(n * m, device=context.device) + 0.5) / (n * m)
        states = reference_states(self._reference, phase * self._reference.duration)
        self._buffer = {k: v.view(n, m, *v.shape[1:]).clone() for k, v in states.items()}

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        segment, _ = self._segments.draw(streams)
        draws = streams.uniform(3)
        slot = (draws[:, 0] * self._options.size).long()
        evolved = {name: value[segment, slot] for name, value in self._buffer.items()}
        reference = reference_states(self._reference, draws[:, 2] * self._reference.duration)
        plain = draws[:, 1] < self._options.reference_share
        return {
            name: torch.where(plain.view(-1, *([1] * (value.dim() - 1))), reference[name], value)
            for name, value in evolved.items()
        }

    def update(self, rollout: Rollout) -> dict[str, float]:
        assert rollout.returns is not None
        options, fields = self._options, rollout.fields
        returns = rollout.returns.flatten()
        of_segment = self._segments.of(fields["phase"].flatten())
        self._segments.update(counted(rollout, of_segment, options.by), returns)
        qpos, qvel, start = self._reference.to_first_cycle(
            fields["qpos"].flatten(0, 1),
            fields["qvel"].flatten(0, 1),
            fields["motion_time"].flatten(),
        )
        sign = -1.0 if options.prefer == "low" else 1.0
        rows, counts = boltzmann_draws(
            of_segment, returns, self._draws.bits(options.size), sign=sign
        )
        enough = counts >= options.size  # too few states do not replace the buffer
        for name, found in {"qpos": qpos, "qvel": qvel, "motion_start": start}.items():
            buffer = self._buffer[name]
            replaced = enough.view(-1, *([1] * (buffer.dim() - 1)))
            buffer.copy_(torch.where(replaced, found[rows], buffer))
        return {}

    def state_dict(self) -> State:
        return {
            **self._segments.state_dict(),
            "buffer": {k: v.clone() for k, v in self._buffer.items()},
            "draws": self._draws.state_dict(),
        }

    def load_state_dict(self, state: State) -> None:
        self._segments.load_state_dict(state)
        for name, value in self._buffer.items():
            value.copy_(state["buffer"][name])
        self._draws.load_state_dict(state["draws"])


class Evolved(InitialStates):
    """The states into which the initial states of another run have evolved, drawn uniformly."""

    episode_fields = EPISODE_FIELDS

    @dataclass(frozen=True)
    class Options:
        run: str  #: the folder of a run with ``initial_states=spacetime/evolution``

    def __init__(self, options: Options, context: Context) -> None:
        states = {k: v.flatten(0, 1) for k, v in evolved_states(options.run).items()}
        own = reference_states(reference_motion(context), torch.zeros(1, device=context.device))
        given = {k: v[:1] for k, v in states.items()}
        for misfit in misshapen(own, given, "state"):
            raise RunError(f"The states of {options.run} do not fit this character: {misfit}.")
        self._states = {k: v.to(context.device) for k, v in states.items()}

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        count = len(self._states["motion_start"])
        row = (streams.uniform(1).squeeze(1) * count).long()
        return {name: value[row] for name, value in self._states.items()}


def evolved_states(run: str) -> dict[str, Tensor]:
    """The buffers (n, m, …) of the newest checkpoint of the folder `run`: qpos, qvel, motion_start.

    Raises
    ------
    RunError
        it is no run whose initial states evolve.
    """
    buffer = at(newest_state(run), "environment.initial_states.buffer")
    names = ("qpos", "qvel", "motion_start")
    if not isinstance(buffer, Mapping) or not all(isinstance(buffer.get(n), Tensor) for n in names):
        raise RunError(
            f"The initial states of {run} do not evolve: train it with "
            "initial_states=spacetime/evolution."
        )
    states = {name: buffer[name] for name in names}
    lead = states["motion_start"].shape
    if (
        len(lead) != 2
        or any(v.dim() < 2 or v.shape[:2] != lead for v in states.values())
        or not all(v.dtype == torch.float32 and bool(v.isfinite().all()) for v in states.values())
    ):
        raise RunError(
            f"The initial states of {run} are damaged: their numbers do not fit together."
        )
    return states
