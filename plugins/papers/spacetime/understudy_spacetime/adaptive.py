"""Bounds whose size adapts during training: what section 3.6 names as future work."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy import distributed
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, Curriculum, Rollout, Shape, State
from understudy_spacetime.segments import of_segments


class AdaptiveBounds(Curriculum):
    """Bounds begin `widest` times as large as they are meant to be, and each segment's tighten as the
    policy gets through it: wide where the motion is still hard, tight where it is not.

    After a rollout, a segment in which fewer than `fail_rate` of the decisions ended in a failure
    multiplies its scale by 1 - `rate`, one in which more did by 1 + `rate`, within [1, `widest`].
    Evaluations have the bounds as they are meant to be.
    """

    rollout_fields = ("phase",)

    @dataclass(frozen=True)
    class Options:
        widest: float = 2.0  #: how many times as large bounds may be, from 1
        segments: int = 20  #: how many segments the motion has, from 1
        #: share of decisions that end in a failure, below which a segment's bounds tighten; 0.02 is
        #: an episode of 1.7 s at 30 Hz
        fail_rate: float = 0.02
        rate: float = 0.02  #: share by which a rollout changes a segment's bounds

        def __post_init__(self) -> None:
            check_range(self, "widest", least=1)
            check_range(self, "segments", least=1, most=10_000)
            check_range(self, "fail_rate", above=0, most=1)
            check_range(self, "rate", above=0, most=0.5)

    def __init__(self, options: Options, context: Context) -> None:
        self._options = options
        first = 1.0 if context.evaluating else options.widest
        self._scales = torch.full((options.segments,), first, device=context.device)
        self._worlds = context.num_worlds
        self.provides: Mapping[str, Shape] = {"bound_scales": (options.segments,)}

    def begin(self, streams: WorldStreams) -> dict[str, Tensor]:
        return {"bound_scales": self._scales.expand(self._worlds, -1)}

    def update(self, rollout: Rollout) -> dict[str, float]:
        options = self._options
        of_segment = of_segments(rollout.fields["phase"].flatten(), options.segments)
        failed = (of_segment & rollout.failed.flatten()).sum(1).float()
        failed, visits = distributed.total(torch.stack([failed, of_segment.sum(1).float()]))
        share = failed / visits.clamp(min=1.0)
        change = torch.where(share < options.fail_rate, 1.0 - options.rate, 1.0 + options.rate)
        change = torch.where(visits > 0, change, 1.0)
        self._scales.copy_((self._scales * change).clamp(1.0, options.widest))
        return {"bound_scale": float(self._scales.mean()), "widest": float(self._scales.max())}

    def stage(self) -> str:
        return f"bounds × {float(self._scales.mean()):.2f}"

    def state_dict(self) -> State:
        return {"scales": self._scales.clone()}

    def load_state_dict(self, state: State) -> None:
        self._scales.copy_(state["scales"])
