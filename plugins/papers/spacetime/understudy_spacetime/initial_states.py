"""Initial-state distributions of section 3.4.2: importance-sampled and evolved; and where evaluations
begin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from understudy import distributed
from understudy.errors import ConfigError, RunError
from understudy.options import at, check_range
from understudy.random import WorldStreams
from understudy.records.checkpoint import misshapen
from understudy.records.runs import newest_state
from understudy.task import Context, InitialStates, Rollout, State
from understudy_characters.initial_states import EPISODE_FIELDS, reference_states
from understudy_characters.letting_go import LettingGo, let_go
from understudy_characters.scene import CharacterScene, reference_motion
from understudy_motion.section import Motion

#: Whose returns stand for a segment: of all states that pass through it, or only of those in which
#: episodes began ("the average estimated return starting from states in segment k").
By = Literal["visits", "starts"]


def segment_probabilities(returns: Tensor, *, uniform: float) -> Tensor:
    """p(k) of eq. 3.9 for the segments' average returns w, (n,): low returns are drawn more often.

    The scale v is (max w - min w) / 3; equal returns give the uniform distribution.
    """
    low = returns.min()
    spread = returns.max() - low
    scale = torch.where(
        spread > torch.finfo(spread.dtype).tiny, spread / 3, torch.ones_like(spread)
    )
    return (1 - uniform) * torch.softmax((low - returns) / scale, dim=0) + uniform / len(returns)


def of_segments(phase: Tensor, count: int) -> Tensor:
    """(count, B) bool: which states at `phase` (B,) in [0, 1) belong to which of `count` equal segments."""
    index = (phase * count).long().clamp(0, count - 1)
    return index == torch.arange(count, device=index.device).unsqueeze(1)


def counted(rollout: Rollout, of_segment: Tensor, by: By) -> Tensor:
    """`of_segment` (n, T N), less the states that do not count for eq. 3.9."""
    if by == "visits":
        return of_segment
    return of_segment & (rollout.fields["episode_step"].flatten() == 0)


class _Segments:
    """The running average of the estimated return of states by motion segment, and the distribution
    of eq. 3.9 over segments. Tensors stay the same objects, since captured steps read them."""

    def __init__(
        self, segments: int, *, uniform: float, decay: float, device: torch.device
    ) -> None:
        self.average = torch.zeros(segments, device=device)
        self.seen = torch.zeros(segments, device=device)
        self.cumulative = torch.arange(1, segments + 1, device=device) / segments
        self._uniform, self._decay = uniform, decay

    def of(self, phase: Tensor) -> Tensor:
        """(n, B) bool: which states at `phase` (B,) belong to which segment."""
        return of_segments(phase, len(self.average))

    def update(self, of_segment: Tensor, returns: Tensor) -> Tensor:
        """Learn from the states' `returns` (B,); the probabilities (n,)."""
        # Not index_add_, whose order of summation differs from run to run on a GPU.
        sums, counts = torch.where(of_segment, returns, 0.0).sum(1), of_segment.sum(1).float()
        sums, counts = distributed.total(torch.stack([sums, counts]))
        mean = sums / counts.clamp(min=1.0)
        keep = torch.where(self.seen > 0, self._decay, 0.0)
        updated = keep * self.average + (1 - keep) * mean
        self.average.copy_(torch.where(counts > 0, updated, self.average))
        self.seen += counts

        seen = self.seen > 0  # segments without samples count as average
        mean = (self.average * seen).sum() / seen.sum().clamp(min=1)
        returns = torch.where(seen, self.average, mean)
        probabilities = segment_probabilities(returns, uniform=self._uniform)
        self.cumulative.copy_(probabilities.cumsum(0) / probabilities.sum())
        return probabilities

    def draw(self, streams: WorldStreams) -> tuple[Tensor, Tensor]:
        """A segment by its probability and a uniform position within it, each (N,)."""
        draws = streams.uniform(2)
        segment = torch.searchsorted(self.cumulative, draws[:, :1].contiguous()).squeeze(1)
        return segment.clamp(max=len(self.cumulative) - 1), draws[:, 1]

    def state_dict(self) -> dict[str, Tensor]:
        return {name: getattr(self, name).clone() for name in ("average", "seen", "cumulative")}

    def load_state_dict(self, state: State) -> None:
        for name in ("average", "seen", "cumulative"):
            getattr(self, name).copy_(state[name])


class Importance(InitialStates):
    """Reference states, drawn more often from segments whose states have low returns (eq. 3.9)."""

    episode_fields = EPISODE_FIELDS
    rollout_fields = ("phase", "episode_step")

    @dataclass(frozen=True)
    class Options:
        segments: int = 20  #: n of eq. 3.9: segments of the motion, from 1
        uniform: float = 0.2  #: u of eq. 3.9, in [0, 1]: the share that is drawn evenly
        decay: float = 0.9  #: of the running average of returns, per rollout
        by: By = (
            "visits"  #: whose returns w are: of states that pass a segment, or that begin in it
        )

        def __post_init__(self) -> None:
            check_range(self, "segments", least=1, most=10_000)
            check_range(self, "uniform", "decay", least=0, most=1)

    def __init__(self, options: Options, context: Context) -> None:
        self._reference = reference_motion(context)
        self._options = options
        self._segments = _Segments(
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


def boltzmann_draws(
    of_segment: Tensor, returns: Tensor, bits: Tensor, *, sign: float
) -> tuple[Tensor, Tensor]:
    """For each segment, states drawn with replacement by the weights of eq. 3.10, without a wait for
    the device.

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
        segments: int = 20  #: of the motion, from 1, each with a buffer
        size: int = 32  #: m, states per buffer
        uniform: float = 0.2  #: share of segments drawn uniformly (eq. 3.9)
        decay: float = 0.9  #: of the running average of returns, per rollout, in [0, 1]
        by: By = "visits"  #: as of :class:`Importance`
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
        self._segments = _Segments(
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


class ClipStart(InitialStates):
    """The clip's beginning: where somebody who is asked to perform the skill begins it.

    Episodes begin within the first `window` s, so that they are not all the same one.
    """

    episode_fields = EPISODE_FIELDS

    @dataclass(frozen=True)
    class Options:
        window: float = 0.1  #: s; 0 begins at the first frame always

        def __post_init__(self) -> None:
            check_range(self, "window", least=0)

    def __init__(self, options: Options, context: Context) -> None:
        self._reference = reference_motion(context)
        self._window = min(options.window, self._reference.duration)

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        return reference_states(self._reference, streams.uniform(1).squeeze(1) * self._window)


class Phases(InitialStates):
    """Between two phases of the clip, evenly: where a part of it is judged by itself."""

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
    """Any time of the clip but those from which a body that is let go, in the clip's state and at the height
    that training uses, lands outside of the bounds (:func:`~understudy_characters.letting_go.let_go`).

    Nobody can follow the clip from most of these. How many they are, the run's page says.
    """

    episode_fields = EPISODE_FIELDS

    def __init__(self, options: None, context: Context) -> None:
        self._reference = reference_motion(context)
        found = fall_of(context)
        times = torch.from_numpy(found.times[~found.bad]).float()
        if not len(times):
            raise ConfigError(
                "initial_states 'spacetime/flyable': whoever begins in this clip lands beside it, wherever it "
                "begins. Repair the clip (understudy motion check CLIP --fix OUT)."
            )
        self._times = times.to(context.device)
        self._apart = self._reference.duration / len(found.times)

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        drawn, within = streams.uniform(2).unbind(1)
        row = (drawn * len(self._times)).long().clamp(max=len(self._times) - 1)
        # half a step to either side, as the start there stands for these
        time = self._times[row] + (within - 0.5) * self._apart
        return reference_states(self._reference, time.clamp(0.0, self._reference.duration))


def fall_of(context: Context) -> LettingGo:
    """What becomes of the task's character that is let go in the states of its clip."""
    scene = context.need_scene(CharacterScene, "initial_states 'spacetime/flyable'")
    motion = context.need_section("motion", Motion, "initial_states 'spacetime/flyable'")
    return context.once("let_go", lambda: let_go(motion.clip, scene.character, motion.floor))


class Evolved(InitialStates):
    """The states into which the initial states of another run have evolved, each as often."""

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
