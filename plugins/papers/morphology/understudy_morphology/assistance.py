"""The hand of God: forces on the root that keep it on its line and at its speed, less and less.

Thesis, section 6.4.1, after Yu, Turk and Liu 2018 (section 4): a stable PD controller of stiffness
kp(z) = 200 - 200 z and damping kd = kp at difficulty z.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.options import check_range
from understudy.task import Actuation, Context, Fields, box
from understudy_morphology.figure import DAMPED
from understudy_morphology.scene import WalkerScene


class Guidance(Fields):
    """How stiff the help is at this moment, and how fast the walker should go.

    ``assistance`` (N,) N/m: kp(z) = stiffness · (1 - z) at the episode's difficulty z. It lessens within
    an episode, so that each has a foretaste of the next lessons: after every `lesson_seconds` by the
    factor `ratio`, `lessons` - 1 times, and never below what it is at the task's own difficulty. So it is
    constant in evaluations, and in trainings that have arrived.

    ``target_velocity`` (N,) m/s rises linearly from 0 within the first `ramp` seconds.
    """

    reads = ("difficulty", "episode_time")
    provides = {"assistance": (), "target_velocity": ()}

    @dataclass(frozen=True)
    class Options:
        stiffness: float = 200.0  #: N/m, from 0: kp(0), the whole help
        ratio: float = 0.75  #: factor of the help from one lesson to the next, in (0, 1]
        lessons: int = 3  #: how many lessons an episode has, from 1
        lesson_seconds: float = 3.0  #: s, above 0, that each of these lasts
        velocity: float = 1.0  #: m/s, velocity that the walker should have after the ramp
        ramp: float = 0.5  #: s, above 0, in which the target velocity rises from 0

        def __post_init__(self) -> None:
            check_range(self, "stiffness", least=0, most=1e8)
            check_range(self, "ratio", above=0, most=1)
            check_range(self, "lessons", least=1, most=1000)
            check_range(self, "lesson_seconds", "ramp", above=0)
            check_range(self, "velocity", least=-1e3, most=1e3)

    def __init__(self, options: Options, context: Context) -> None:
        self._options = options
        self._least = options.stiffness * (1.0 - context.difficulty)

    def compute(self, difficulty: Tensor, episode_time: Tensor) -> dict[str, Tensor]:
        options = self._options
        # half a millisecond: the time is a float32 multiple of the control period
        lesson = torch.floor((episode_time + 5e-4) / options.lesson_seconds)
        lessened = torch.pow(options.ratio, lesson.clamp(max=options.lessons - 1.0))
        return {
            "assistance": (options.stiffness * (1.0 - difficulty) * lessened).clamp(
                min=self._least
            ),
            "target_velocity": options.velocity * (episode_time / options.ramp).clamp(max=1.0),
        }


class HelpedTorques(Actuation):
    """The action is each hinge's share of its largest torque; beside it, the gains of the hand of God.

    It holds the root's place sideways (the line y = 0) and its rotation (upright, facing x) by PD, and
    damps its velocity towards the target forward. The controllers are part of the model
    (:data:`~understudy_morphology.figure.HELP`) and act in every physics step.
    """

    reads = ("assistance", "target_velocity")

    @dataclass(frozen=True)
    class Options:
        #: m²/rad, the stiffness of rotation (N m/rad) over that of places (N/m). Yu et al. push alone: 0.
        rotation: float = 1.0

        def __post_init__(self) -> None:
            check_range(self, "rotation", least=0)

    def __init__(self, options: Options, context: Context) -> None:
        scene = context.need_scene(WalkerScene, "actuation 'morphology/helped_torques'")
        self.action_space = box(scene.joints)
        self._rotation = options.rotation

    def control(self, action: Tensor, assistance: Tensor, target_velocity: Tensor) -> Tensor:
        push, rotation = DAMPED * assistance * target_velocity, self._rotation * assistance
        gains = [push, assistance, assistance, rotation, rotation, rotation]
        return torch.cat([torques(action), torch.stack(gains, dim=1)], dim=1)


def torques(action: Tensor) -> Tensor:
    """(N, J) shares of the largest torques, in [-1, 1]."""
    return action.clamp(-1.0, 1.0)
