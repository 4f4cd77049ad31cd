"""Joint targets that never jump."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.options import check_range
from understudy.task import Actuation, Context, Shape, box
from understudy_characters.scene import CharacterScene


class SmoothTargets(Actuation):
    """Targets of all servos that go a share of the way to the action in every control period."""

    reads = ("smooth_targets",)
    every = "period"

    @dataclass(frozen=True)
    class Options:
        share: float = 0.5  #: of the new target in what is held, above 0, at most 1

        def __post_init__(self) -> None:
            check_range(self, "share", above=0, most=1)

    def __init__(self, options: Options, context: Context) -> None:
        scene = context.need_scene(CharacterScene, "actuation 'balance/smooth_targets'")
        self.action_space = box(scene.layout.num_actuators)
        self.keeps: Mapping[str, Shape] = {"smooth_targets": (scene.layout.num_actuators,)}
        self._share = options.share

    def begin(self, smooth_targets: Tensor) -> dict[str, Tensor]:
        return {"smooth_targets": torch.zeros_like(smooth_targets)}

    def advance(self, action: Tensor, smooth_targets: Tensor) -> dict[str, Tensor]:
        return {"smooth_targets": torch.lerp(smooth_targets, action, self._share)}

    def control(self, action: Tensor, smooth_targets: Tensor) -> Tensor:
        return smooth_targets
