"""Where dressing begins."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, InitialStates
from understudy_dressing.person import PersonScene
from understudy_dressing.sleeve import SleeveScene
from understudy_dressing.terms import neutral


class Track(InitialStates):
    """The person neutral, and before it the hanging sleeve, which goes in a straight line to the shoulder
    (section 8.3). The gripper floats there by itself: nothing slows it down."""

    @dataclass(frozen=True)
    class Options:
        #: m, world frame: between these the gripper begins, uniformly (the 2018 code's gown)
        low: tuple[float, float, float] = (0.7, -0.42, -0.3)
        high: tuple[float, float, float] = (0.8, 0.21, 0.2)  #: m
        end: tuple[float, float, float] = (0.1, -0.21, 0.1)  #: m, where it is after `seconds`
        seconds: float = 12.5  #: until it arrives (2018 code: 250 decisions of 0.05 s)
        noise: float = 0.01  #: rad and rad/s, uniform, of pose and velocity

        def __post_init__(self) -> None:
            check_range(self, "seconds", above=0)
            check_range(self, "noise", least=0, most=1)
            for name in ("low", "high", "end"):
                check_range(self, name, least=-3, most=3)
            if any(a > b for a, b in zip(self.low, self.high, strict=True)):
                raise ValueError(f"low={self.low} is not possible: high={self.high} is below it.")

    def __init__(self, options: Options, context: Context) -> None:
        self.options = options
        who = "initial_states 'dressing/track'"
        self._pose = neutral(context.need_scene(PersonScene, who)).to(context.device)
        sleeve = context.need_scene(SleeveScene, who)
        settled = context.once("dressing/settled", sleeve.settled)
        self._settled = torch.tensor(settled, dtype=torch.float32, device=context.device)
        low, high, end = (
            torch.tensor(t, dtype=torch.float32, device=context.device)
            for t in (options.low, options.high, options.end)
        )
        self._low, self._high, self._end = low, high, end

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        hinges = len(self._pose)
        drawn = streams.uniform(3 + 2 * hinges)
        gripper = self._low + drawn[:, :3] * (self._high - self._low)
        noise = self.options.noise * (2.0 * drawn[:, 3:] - 1.0)
        speed = (self._end - gripper) / self.options.seconds
        cloth = self._settled + gripper.unsqueeze(1)
        return {
            "qpos": torch.cat([self._pose + noise[:, :hinges], gripper], dim=1),
            "qvel": torch.cat([noise[:, hinges:], speed], dim=1),
            "cloth_position": cloth,
            "cloth_velocity": speed.unsqueeze(1).expand_as(cloth).contiguous(),
        }
