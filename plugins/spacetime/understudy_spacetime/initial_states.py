"""Initial-state distributions of section 3.4.2: uniform, importance-sampled, evolved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy import distributed
from understudy.options import check_range
from understudy.random import WorldStreams, generator
from understudy.task import Context, InitialStates, Rollout, Shape, State
from understudy_humanoid.reference import ReferenceMotion
from understudy_humanoid.scene import reference_motion

EPISODE_FIELDS: dict[str, Shape] = {"motion_start": ()}


def segment_probabilities(returns: Tensor, *, uniform: float) -> Tensor:
    """p(k) of eq. 3.9 for the segments' average returns w, (n,): low returns are drawn more often.

    The scale v is (max w - min w) / 3; equal returns give the uniform distribution.
    """
    spread = returns.max() - returns.min()
    scale = torch.where(spread > 0, spread / 3, torch.ones_like(spread))
    return (1 - uniform) * torch.softmax(-returns / scale, dim=0) + uniform / len(returns)


class _SegmentReturns:
    """Running average of the estimated return of states by motion segment."""

    def __init__(self, segments: int, decay: float, device: torch.device) -> None:
        self.average = torch.zeros(segments, device=device)
        self.seen = torch.zeros(segments, device=device)
        self._decay = decay

    def update(self, phase: Tensor, returns: Tensor) -> None:
        segments = len(self.average)
        index = (phase * segments).long().clamp(0, segments - 1)
        # Not index_add_, whose order of summation differs from run to run on a GPU.
        of_segment = index == torch.arange(segments, device=index.device).unsqueeze(1)
        sums, counts = torch.where(of_segment, returns, 0.0).sum(1), of_segment.sum(1).float()
        sums, counts = distributed.total(torch.stack([sums, counts]))
        mean = sums / counts.clamp(min=1.0)
        keep = torch.where(self.seen > 0, self._decay, 0.0)
        updated = keep * self.average + (1 - keep) * mean
        self.average = torch.where(counts > 0, updated, self.average)
        self.seen = self.seen + counts

    def probabilities(self, uniform: float) -> Tensor:
        seen = self.seen > 0  # segments without samples count as average
        mean = (self.average * seen).sum() / seen.sum().clamp(min=1)
        return segment_probabilities(torch.where(seen, self.average, mean), uniform=uniform)


class Uniform(InitialStates):
    """Reference-state initialisation: the clip's state at a uniformly drawn time."""

    episode_fields = EPISODE_FIELDS

    def __init__(self, options: None, context: Context) -> None:
        self._reference = reference_motion(context)

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        time = streams.uniform(1).squeeze(1) * self._reference.duration
        return _reference_states(self._reference, time)


def _reference_states(reference: ReferenceMotion, time: Tensor) -> dict[str, Tensor]:
    state = reference.sample(time)
    return {
        "qpos": state["reference_qpos"],
        "qvel": state["reference_qvel"],
        "motion_start": time,
    }


class Importance(InitialStates):
    """Reference states, drawn more often from segments whose states have low returns (eq. 3.9)."""

    episode_fields = EPISODE_FIELDS
    records = ("phase",)

    @dataclass(frozen=True)
    class Options:
        segments: int = 20  #: n of eq. 3.9
        uniform: float = 0.2  #: u of eq. 3.9
        decay: float = 0.9  #: of the running average of returns, per rollout

        def __post_init__(self) -> None:
            check_range(self, "segments", least=1)
            check_range(self, "uniform", "decay", least=0, most=1)

    def __init__(self, options: Options, context: Context) -> None:
        self._reference = reference_motion(context)
        self._options = options
        self._returns = _SegmentReturns(options.segments, options.decay, context.device)
        self._cumulative = _cumulative(
            torch.full((options.segments,), 1.0 / options.segments, device=context.device)
        )

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        segment, within = _draw_segment(self._cumulative, streams)
        phase = (segment + within) / self._options.segments
        return _reference_states(self._reference, phase * self._reference.duration)

    def update(self, rollout: Rollout) -> dict[str, float]:
        assert rollout.returns is not None
        self._returns.update(rollout.records["phase"].flatten(), rollout.returns.flatten())
        probabilities = self._returns.probabilities(self._options.uniform)
        self._cumulative = _cumulative(probabilities)
        return {"hardest_segment": float(probabilities.argmax())}

    def state_dict(self) -> State:
        return {
            "average": self._returns.average.clone(),
            "seen": self._returns.seen.clone(),
            "cumulative": self._cumulative.clone(),
        }

    def load_state_dict(self, state: State) -> None:
        self._returns.average = state["average"].clone()
        self._returns.seen = state["seen"].clone()
        self._cumulative = state["cumulative"].clone()


def _cumulative(probabilities: Tensor) -> Tensor:
    return probabilities.cumsum(0) / probabilities.sum()


def _draw_segment(cumulative: Tensor, streams: WorldStreams) -> tuple[Tensor, Tensor]:
    """A segment by its probability and a uniform position within it, each (N,)."""
    draws = streams.uniform(2)
    segment = torch.searchsorted(cumulative, draws[:, :1].contiguous()).squeeze(1)
    return segment.clamp(max=len(cumulative) - 1), draws[:, 1]


class Evolution(InitialStates):
    """Initial states that evolve from the clip's into those the policy reaches (eq. 3.10).

    Each motion segment has a buffer of states, at first the reference's. After every rollout each
    buffer is overwritten by a Boltzmann draw, with weights exp(-w / v), from the states that were
    collected in its segment; w is the estimated return and v = max w - min w.
    """

    episode_fields = EPISODE_FIELDS
    records = ("phase", "motion_time", "qpos", "qvel")

    @dataclass(frozen=True)
    class Options:
        segments: int = 20
        size: int = 32  #: m, states per buffer
        uniform: float = 0.2  #: share of segments drawn uniformly (eq. 3.9)
        decay: float = 0.9
        #: Share of episodes that begin in the reference itself.
        reference_share: float = 0.1
        #: ``low`` prefers states of low return, as eq. 3.10 is printed; ``high`` the opposite.
        prefer: str = "low"

        def __post_init__(self) -> None:
            if self.prefer not in ("low", "high"):
                raise ValueError(f"prefer={self.prefer} is not possible: low or high.")
            check_range(self, "segments", "size", least=1)
            check_range(self, "uniform", "decay", "reference_share", least=0, most=1)

    def __init__(self, options: Options, context: Context) -> None:
        self._reference, self._options = reference_motion(context), options
        self._returns = _SegmentReturns(options.segments, options.decay, context.device)
        self._cumulative = _cumulative(
            torch.full((options.segments,), 1.0 / options.segments, device=context.device)
        )
        self._generator = generator(context.seed, "evolution")
        n, m = options.segments, options.size
        phase = (torch.arange(n * m, device=context.device) + 0.5) / (n * m)
        states = _reference_states(self._reference, phase * self._reference.duration)
        self._buffer = {k: v.view(n, m, *v.shape[1:]).clone() for k, v in states.items()}

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        segment, _ = _draw_segment(self._cumulative, streams)
        draws = streams.uniform(3)
        slot = (draws[:, 0] * self._options.size).long()
        evolved = {name: value[segment, slot] for name, value in self._buffer.items()}
        reference = _reference_states(self._reference, draws[:, 2] * self._reference.duration)
        plain = draws[:, 1] < self._options.reference_share
        return {
            name: torch.where(plain.view(-1, *([1] * (value.dim() - 1))), reference[name], value)
            for name, value in evolved.items()
        }

    def update(self, rollout: Rollout) -> dict[str, float]:
        assert rollout.returns is not None
        options, records = self._options, rollout.records
        returns, phase = rollout.returns.flatten(), records["phase"].flatten()
        self._returns.update(phase, returns)
        self._cumulative = _cumulative(self._returns.probabilities(options.uniform))
        qpos, qvel, start = self._reference.to_first_cycle(
            records["qpos"].flatten(0, 1),
            records["qvel"].flatten(0, 1),
            records["motion_time"].flatten(),
        )
        index = (phase * options.segments).long().clamp(0, options.segments - 1)
        sign = -1.0 if options.prefer == "low" else 1.0
        for k in range(options.segments):
            rows = (index == k).nonzero().squeeze(1)
            if len(rows) < options.size:
                continue  # too few states to replace the buffer with
            w = returns[rows]
            spread = (w.max() - w.min()).clamp(min=1e-6)
            weights = torch.softmax(sign * w / spread, dim=0).cpu()
            drawn = torch.multinomial(
                weights, options.size, replacement=True, generator=self._generator
            )
            chosen = rows[drawn.to(rows.device)]
            self._buffer["qpos"][k] = qpos[chosen]
            self._buffer["qvel"][k] = qvel[chosen]
            self._buffer["motion_start"][k] = start[chosen]
        return {}

    def state_dict(self) -> State:
        return {
            "buffer": {k: v.clone() for k, v in self._buffer.items()},
            "average": self._returns.average.clone(),
            "seen": self._returns.seen.clone(),
            "cumulative": self._cumulative.clone(),
            "generator": self._generator.get_state(),
        }

    def load_state_dict(self, state: State) -> None:
        buffer: Mapping[str, Tensor] = state["buffer"]
        self._buffer = {k: v.clone() for k, v in buffer.items()}
        self._returns.average = state["average"].clone()
        self._returns.seen = state["seen"].clone()
        self._cumulative = state["cumulative"].clone()
        self._generator.set_state(state["generator"].cpu())
