"""What a skill's action is: servo targets, in the units of the clip that it imitates."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.options import check_range
from understudy.task import Actuation, Context, box
from understudy_characters.scene import CharacterScene, reference_motion

#: Times at which the clip is looked at.
_SAMPLES = 256


def units(context: Context, least: float) -> tuple[Tensor, Tensor]:
    """Of the servo targets of the clip: their mean (U,) and their spread (U,), at least `least`, rad."""
    reference = reference_motion(context)
    times = torch.linspace(0.0, reference.duration, _SAMPLES, device=context.device)
    targets = reference.sample(times * (1 - 1e-6))["reference_joint_targets"]
    return targets.mean(dim=0), targets.std(dim=0).clamp(min=least)


class AroundClip(Actuation):
    """Servo targets: the mean of the clip's, plus the action times their spread over the clip.

    "The signal for controlling the humanoid joints" (section 4) is left open. An action of 0 holds the
    middle of the motion, one of 1 goes as far as the clip does, joint by joint. Both are constants, so
    a controller that acts in another task needs no clock.

    With a `lag` they follow first order what the policy asks, from what the servos were last told, of whichever
    controller: targets that jump 60 times a second shake the ankles, which a pose reward does not see.
    """

    @dataclass(frozen=True)
    class Options:
        #: rad, least unit of the action: what an action of 1 is for joints that the clip keeps
        #: still
        least: float = 0.15
        #: s, time constant with which targets follow the action; null follows at once
        lag: float | None = None

        def __post_init__(self) -> None:
            check_range(self, "least", most=100)
            check_range(self, "least", "lag", above=0)

    def __init__(self, options: Options, context: Context) -> None:
        scene = context.need_scene(CharacterScene, "actuation 'sitting/around_clip'")
        self._middle, self._unit = units(context, options.least)
        self.action_space = box(scene.layout.num_actuators)
        if options.lag is not None:
            self.reads = ("ctrl",)
            self._gain = -math.expm1(-context.control_dt / options.lag)

    def control(self, action: Tensor, ctrl: Tensor | None = None) -> Tensor:
        asked = self._middle + self._unit * action
        return asked if ctrl is None else ctrl + self._gain * (asked - ctrl)
