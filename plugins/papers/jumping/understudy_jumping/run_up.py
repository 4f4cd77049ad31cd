"""The run-up (thesis, section 4.6.1): a clip is imitated up to the take-off, whose features are wanted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Actuation, Context, Fields, InitialStates, Shape, box
from understudy_characters.initial_states import EPISODE_FIELDS, reference_states
from understudy_characters.parts import REACH, Fall
from understudy_characters.scene import CharacterScene, reference_motion
from understudy_tensors import rotations


class Beginnings(InitialStates):
    """The clip's state at a time drawn uniformly from `begin` to `end` s; at `begin` in evaluations."""

    episode_fields = EPISODE_FIELDS

    @dataclass(frozen=True)
    class Options:
        #: s, where the clip's part begins: of the curved sprint, when it starts to run
        begin: float = 0.5
        end: float = 3.1  #: s, where the clip's part ends: shortly before the take-off

        def __post_init__(self) -> None:
            check_range(self, "begin", least=0)
            check_range(self, "end", least=self.begin)

    def __init__(self, options: Options, context: Context) -> None:
        self._reference, self._options = reference_motion(context), options
        self._share = 0.0 if context.evaluating else 1.0

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        begin, end = self._options.begin, self._options.end
        time = begin + self._share * (end - begin) * streams.uniform(1).squeeze(1)
        return reference_states(self._reference, time)


class OffsetTargets(Actuation):
    """The action is added to the reference's joint targets, rad."""

    reads = ("reference_joint_targets",)

    def __init__(self, options: None, context: Context) -> None:
        scene = context.need_scene(CharacterScene, "actuation 'jumping/offset_targets'")
        self.action_space = box(scene.layout.num_actuators, REACH)

    def control(self, action: Tensor, reference_joint_targets: Tensor) -> Tensor:
        return reference_joint_targets + action


class Arrival(Fields):
    """The take-off at the end of a run-up, and how near it is to what is wanted.

    - ``arrived`` () bool: the clip's time of take-off has come
    - ``runup_features`` (4,): v_z m/s, ω_x, ω_y, ω_z rad/s of the root, as
      :class:`~understudy_jumping.takeoff.Takeoff` has them
    - ``takeoff_match`` (): r_G = exp(-‖ω - ω̄‖₁ / 3 - 0.7 (v_z - v̄_z)²) (eq. 4.12); without the last
      term (eq. 4.13) where no `v_z` is wanted
    - ``takeoff_rest`` (): exp(-`rest` (0.7 ‖v - v̄‖² + 50 (h - h̄)²)), how near the root's velocity v,
      forward and up, m/s, and its height h, m, are to the clip's. "The remaining dimensions of the
      take-off states stay the same as in the original reference run" (section 4.8), which has no
      equation. Without it run-ups learn to fall into the features, the foot in the air.
    """

    reads = ("motion_time", "qpos", "qvel")
    provides: Mapping[str, Shape] = {
        "arrived": (),
        "runup_features": (4,),
        "takeoff_match": (),
        "takeoff_rest": (),
    }

    @dataclass(frozen=True)
    class Options:
        at: float = 3.328  #: s, above 0: time of the take-off in the clip
        v_z: float | None = -2.4  #: m/s, v̄_z, the velocity that is wanted; null: any (eq. 4.13)
        #: rad/s, ω̄, the angular velocity that is wanted (eq. 4.12)
        omega: tuple[float, float, float] = (-3.0, -3.0, 1.0)
        rest: float = (
            1.0  #: how much the root's other velocities and its height count; 0: not at all
        )

        def __post_init__(self) -> None:
            check_range(self, "at", above=0)
            check_range(self, "v_z", "omega", least=-1e3, most=1e3)
            check_range(self, "rest", least=0, most=1e3)

    def __init__(self, options: Options, context: Context) -> None:
        layout = context.need_scene(CharacterScene, "fields 'jumping/arrival'").layout
        self._at, self._dof, self._options = layout.root_address, layout.root_dof, options
        self._omega = torch.tensor(options.omega, device=context.device)
        self._time = options.at - 0.5 * context.control_dt
        self._clip = torch.zeros(1, 3, device=context.device)
        if options.rest:
            at = torch.full((1,), options.at, device=context.device)
            clip = reference_states(reference_motion(context), at)
            self._clip = self._root(clip["qpos"], clip["qvel"])

    def compute(self, motion_time: Tensor, qpos: Tensor, qvel: Tensor) -> dict[str, Tensor]:
        features = takeoff_features(
            qpos[:, self._at + 3 : self._at + 7], qvel[:, self._dof : self._dof + 6]
        )
        away = (features[:, 1:] - self._omega).abs().sum(dim=1) / 3.0
        if self._options.v_z is not None:
            away = away + 0.7 * (features[:, 0] - self._options.v_z).square()
        forward, up, height = (self._root(qpos, qvel) - self._clip).square().unbind(dim=1)
        rest = 0.7 * (forward + up) + 50.0 * height
        return {
            "arrived": motion_time >= self._time,
            "runup_features": features,
            "takeoff_match": torch.exp(-away),
            "takeoff_rest": torch.exp(-self._options.rest * rest),
        }

    def _root(self, qpos: Tensor, qvel: Tensor) -> Tensor:
        """(N, 3): the root's velocity forward and up, m/s, and its height, m."""
        ahead = rotations.from_heading(-rotations.heading(qpos[:, self._at + 3 : self._at + 7]))
        linear = rotations.rotate(ahead, qvel[:, self._dof : self._dof + 3])
        return torch.stack([linear[:, 0], linear[:, 2], qpos[:, self._at + 2]], dim=1)


def takeoff_features(rotation: Tensor, velocity: Tensor) -> Tensor:
    """(N, 4): v_z, ω_x, ω_y, ω_z, from the root's `rotation` (N, 4) and its `velocity` (N, 6) in
    ``qvel``: linear in the world, angular in its own frame."""
    ahead = rotations.from_heading(-rotations.heading(rotation))
    linear = rotations.rotate(ahead, velocity[:, :3])
    angular = rotations.rotate(ahead, rotations.rotate(rotation, velocity[:, 3:]))
    return torch.stack([-linear[:, 1], angular[:, 0], angular[:, 2], -angular[:, 1]], dim=1)


def arrived(arrived: Tensor) -> Tensor:
    """The take-off has come; to be used with ``outcome: success``."""
    return arrived


class FellRunning:
    """A fall (``characters/fall``) while the run-up acts, the first of policies in sequence: the clip's time comes to the
    take-off of who lies there, too, and a jump ends on the back."""

    Options = Fall.Options

    def __init__(self, options: Fall.Options, context: Context) -> None:
        self._fall = Fall(options, context)

    def __call__(
        self, xpos: Tensor, xmat: Tensor, reference_link_clearances: Tensor, stage: Tensor
    ) -> Tensor:
        return self._fall(xpos, xmat, reference_link_clearances) & (stage == 0)


def match(succeeded: Tensor, takeoff_match: Tensor, takeoff_rest: Tensor) -> Tensor:
    """r_G, once, at the take-off, by how much the rest is as in the clip."""
    return succeeded * takeoff_match * takeoff_rest
