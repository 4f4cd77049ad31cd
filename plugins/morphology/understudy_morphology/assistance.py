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
        stiffness: float = 200.0  #: N/m, kp(0)
        ratio: float = 0.75
        lessons: int = 3
        lesson_seconds: float = 3.0
        velocity: float = 1.0  #: m/s
        ramp: float = 0.5  #: s

        def __post_init__(self) -> None:
            check_range(self, "stiffness", least=0)
            check_range(self, "ratio", above=0, most=1)
            check_range(self, "lessons", least=1)
            check_range(self, "lesson_seconds", "ramp", above=0)

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


def stable_pd(
    error: Tensor, rate: Tensor, kp: Tensor, kd: Tensor, mass: float, dt: float
) -> Tensor:
    """The force, N, of a PD controller that acts on the state at the end of the step of `dt` s.

    With p = error + dt · rate and the acceleration a = -(kp p + kd rate) / (mass + kd dt) it is

        f = -kp p - kd (rate + dt a)

    which stays stable however large the gains are (Tan, Liu and Turk 2011).
    """
    explicit = kp * (error + dt * rate) + kd * rate
    return -explicit / (1.0 + kd * dt / mass)


class HelpedTorques(Actuation):
    """The action is each hinge's share of its largest torque; the hand of God acts in every sub-step.

    Sideways it is a PD controller on the root's distance from the line y = 0; forward only the damping
    acts, towards the target velocity. Both are stable PD.
    """

    reads = ("qpos", "qvel", "assistance", "target_velocity")
    every = "substep"

    @dataclass(frozen=True)
    class Options:
        damping: float = 1.0  #: s, kd / kp

        def __post_init__(self) -> None:
            check_range(self, "damping", least=0)

    def __init__(self, options: Options, context: Context) -> None:
        scene = context.need_scene(WalkerScene, "actuation 'morphology.helped_torques'")
        self.action_space = box(scene.joints)
        self._damping, self._mass = options.damping, scene.root_mass
        self._dt = context.control_dt / context.substeps

    def control(
        self,
        action: Tensor,
        qpos: Tensor,
        qvel: Tensor,
        assistance: Tensor,
        target_velocity: Tensor,
    ) -> Tensor:
        kp, kd = assistance, self._damping * assistance
        none = torch.zeros_like(kp)
        too_fast = qvel[:, 0] - target_velocity
        forward = stable_pd(none, too_fast, none, kd, self._mass, self._dt)
        sideways = stable_pd(qpos[:, 1], qvel[:, 1], kp, kd, self._mass, self._dt)
        return torch.cat([torques(action), torch.stack([forward, sideways], dim=1)], dim=1)


def torques(action: Tensor) -> Tensor:
    """(N, J) shares of the largest torques, in [-1, 1]."""
    return action.clamp(-1.0, 1.0)
