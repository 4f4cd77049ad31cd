"""Memories of any field: ``reads`` says which, and ``provides`` names the fields that are kept.

Several of a kind in one task need different names: ``provides: {timer: seconds_on_seat}``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.options import check_range
from understudy.running.soundness import rows
from understudy.task import Context, Memory, Shape
from understudy_terms.shaped import Shaped, check_shape


class Timer(Memory):
    """Seconds for which ``condition`` has held without a break; 0 where it does not hold.

    It counts control periods at whose end the condition holds.
    """

    reads = ("condition",)
    keeps = {"timer": ()}

    def __init__(self, options: None, context: Context) -> None:
        self._dt = context.control_dt

    def begin(self, condition: Tensor) -> dict[str, Tensor]:
        return {"timer": torch.zeros_like(condition, dtype=torch.float32)}

    def advance(self, kept: Mapping[str, Tensor], condition: Tensor) -> dict[str, Tensor]:
        return {"timer": torch.where(condition != 0, kept["timer"] + self._dt, 0.0)}


class Latch(Memory):
    """``value`` as it was at the end of the first control period at which ``condition`` held.

    ``held`` is 1 from then on; before, it and ``latched`` are 0.
    """

    reads = ("value", "condition")

    Options = Shaped

    def __init__(self, options: Shaped, context: Context) -> None:
        self.keeps: Mapping[str, Shape] = {"latched": options.shape, "held": ()}

    def begin(self, value: Tensor, condition: Tensor) -> dict[str, Tensor]:
        nothing = {"latched": torch.zeros_like(value), "held": torch.zeros_like(condition).float()}
        return self.advance(nothing, value, condition)

    def advance(
        self, kept: Mapping[str, Tensor], value: Tensor, condition: Tensor
    ) -> dict[str, Tensor]:
        now = (condition != 0) & (kept["held"] == 0)
        return {
            "latched": torch.where(rows(now, value), value, kept["latched"]),
            "held": torch.where(now, 1.0, kept["held"]),
        }


class RunningMean(Memory):
    """Mean of ``value`` over the control periods of the episode so far; 0 before the first."""

    reads = ("value", "episode_step")

    Options = Shaped

    def __init__(self, options: Shaped, context: Context) -> None:
        self.keeps: Mapping[str, Shape] = {"mean": options.shape}

    def begin(self, value: Tensor, episode_step: Tensor) -> dict[str, Tensor]:
        return {"mean": torch.zeros_like(value, dtype=torch.float32)}

    def advance(
        self, kept: Mapping[str, Tensor], value: Tensor, episode_step: Tensor
    ) -> dict[str, Tensor]:
        share = rows(1.0 / episode_step.clamp(min=1), value)
        return {"mean": kept["mean"] + (value - kept["mean"]) * share}


class Roughness(Memory):
    """How rough a movement was: the mean size of the `order`-th derivative of ``value`` over the episode's control periods so far, in
    its unit per s^`order`, by differences; 0 before there is any.

    Sizes are along the last axis, so that ``xpos`` (bodies, 3) m gives the mean jerk of all bodies, m/s³.
    """

    reads = ("value", "episode_step")

    @dataclass(frozen=True)
    class Options:
        shape: tuple[
            int, ...
        ]  #: shape of the value, without N: [15, 3] for the positions of 15 bodies
        order: int = 3  #: of the derivative, from 1 to 4: 1 velocity, 2 acceleration, 3 jerk

        def __post_init__(self) -> None:
            check_shape(self)
            check_range(self, "order", least=1, most=4)
            if not self.shape:
                raise ValueError("shape=[] is not possible: give the value's, such as [3].")

    def __init__(self, options: Options, context: Context) -> None:
        self._order, self._scale = options.order, context.control_dt**-options.order
        #: of the newest value, then of those before
        self._weights = [(-1) ** k * math.comb(options.order, k) for k in range(options.order + 1)]
        self.keeps: Mapping[str, Shape] = {
            "roughness": (),
            "values_before": (options.order, *options.shape),
        }

    def begin(self, value: Tensor, episode_step: Tensor) -> dict[str, Tensor]:
        nothing = torch.zeros_like(episode_step, dtype=torch.float32)
        return {"roughness": nothing, "values_before": torch.stack([value] * self._order, dim=1)}

    def advance(
        self, kept: Mapping[str, Tensor], value: Tensor, episode_step: Tensor
    ) -> dict[str, Tensor]:
        before, mean = kept["values_before"], kept["roughness"]
        change = value + sum(w * before[:, k] for k, w in enumerate(self._weights[1:]))
        size = self._scale * torch.linalg.vector_norm(change, dim=-1)
        count = (
            episode_step - self._order + 1
        )  # of differences that do not reach back before the episode
        now = mean + (size.reshape(len(value), -1).mean(dim=1) - mean) / count.clamp(min=1)
        return {
            "roughness": torch.where(count > 0, now, mean),
            "values_before": torch.cat([value.unsqueeze(1), before[:, :-1]], dim=1),
        }


class Extremes(Memory):
    """The least and the greatest ``value`` (N,) at the ends of the episode's control periods so far; at first, its first
    value. Measures, which read values at the end of a decision, miss those within it."""

    reads = ("value",)
    keeps = {"least": (), "most": ()}

    def __init__(self, options: None, context: Context) -> None:
        pass

    def begin(self, value: Tensor) -> dict[str, Tensor]:
        return {"least": value.float(), "most": value.float()}

    def advance(self, kept: Mapping[str, Tensor], value: Tensor) -> dict[str, Tensor]:
        return {"least": kept["least"].minimum(value), "most": kept["most"].maximum(value)}


class RedrawnTarget(Memory):
    """A point drawn uniformly in a box, and drawn again after a while or once it is reached.

    With neither option, it stays for the episode.
    """

    @dataclass(frozen=True)
    class Options:
        low: tuple[float, ...]  #: the box's lower corner, in the target's unit
        high: tuple[float, ...]  #: the box's other corner, in the target's unit
        every: float | None = None  #: seconds after which it is drawn again
        #: Distance of ``position``, another field that is read, from the target at which the target
        #: is drawn again.
        within: float | None = None

        def __post_init__(self) -> None:
            check_range(self, "every", "within", above=0)
            if len(self.low) != len(self.high) or not self.low:
                raise ValueError(f"high={self.high} is not possible: it must be as long as low.")

    def __init__(self, options: Options, context: Context) -> None:
        self._options, self._dt = options, context.control_dt
        self._low = torch.tensor(options.low, device=context.device)
        self._size = torch.tensor(options.high, device=context.device) - self._low
        self.uniforms = len(options.low)
        self.reads = ("position",) if options.within is not None else ()
        self.keeps: Mapping[str, Shape] = {"target": (self.uniforms,), "target_age": ()}

    def begin(self, uniforms: Tensor, position: Tensor | None = None) -> dict[str, Tensor]:
        return {"target": self._low + uniforms * self._size, "target_age": uniforms[:, 0] * 0.0}

    def advance(
        self, kept: Mapping[str, Tensor], uniforms: Tensor, position: Tensor | None = None
    ) -> dict[str, Tensor]:
        options, age = self._options, kept["target_age"] + self._dt
        again = torch.zeros_like(age, dtype=torch.bool)
        if options.every is not None:
            again = again | (age >= options.every - 0.5 * self._dt)
        if options.within is not None and position is not None:
            again = again | ((position - kept["target"]).norm(dim=1) <= options.within)
        drawn = self.begin(uniforms)
        return {
            "target": torch.where(again.unsqueeze(1), drawn["target"], kept["target"]),
            "target_age": torch.where(again, 0.0, age),
        }


class History(Memory):
    """The last K values of ``value``, one per control period, the newest first: (K, …).

    An episode begins with its first value K times.
    """

    reads = ("value",)

    @dataclass(frozen=True)
    class Options:
        length: int  #: K, how many values are kept, from 1 to 10000
        shape: tuple[int, ...] = ()  #: shape of the value, without N: [3] for a position

        def __post_init__(self) -> None:
            check_range(self, "length", least=1, most=10_000)
            check_shape(self)

    def __init__(self, options: Options, context: Context) -> None:
        self._length = options.length
        self.keeps: Mapping[str, Shape] = {"history": (options.length, *options.shape)}

    def begin(self, value: Tensor) -> dict[str, Tensor]:
        return {"history": torch.stack([value] * self._length, dim=1)}

    def advance(self, kept: Mapping[str, Tensor], value: Tensor) -> dict[str, Tensor]:
        return {"history": torch.cat([value.unsqueeze(1), kept["history"][:, :-1]], dim=1)}
