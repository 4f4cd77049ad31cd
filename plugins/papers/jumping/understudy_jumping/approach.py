"""A run-up and a jump in one episode: where the run-up begins, so that it ends where the jump does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, Fields, InitialStates, Shape
from understudy_characters.initial_states import EPISODE_FIELDS as CLIP_FIELDS
from understudy_characters.initial_states import reference_states
from understudy_characters.scene import CharacterScene, reference_motion
from understudy_jumping.arena import MAT, arena_of
from understudy_jumping.initial_states import EPISODE_FIELDS, Distance, athletes_states, obstacle_at
from understudy_jumping.run_up import takeoff_features
from understudy_jumping.takeoff import Takeoff
from understudy_tensors import rotations
from understudy_tensors.limits import check_angle, limits


class Approach(InitialStates):
    """The clip's state at the time `begin`, turned and moved so that a run-up from there ends where a jump begins, the
    obstacle at `alpha`: where the bank has the run-up's ends, in the clip's frame.

    ``approach_turn`` () rad and ``approach_shift`` (2,) m bring the clip's frame there; ``approach_goal`` (2,) m is where the run-up is
    to end. Friction is a pyramid along the world's axes and does not turn with the clip, so that a run-up ends elsewhere in its turned
    frame: measure `jumping/beside` says where, and `beside` takes it back.
    """

    reads = ("difficulty",)
    episode_fields: Mapping[str, Shape] = {
        **EPISODE_FIELDS, **CLIP_FIELDS, "approach_turn": (), "approach_shift": (2,),
        "approach_goal": (2,),
    }  # fmt: skip
    varies = (f"mocap_pos/{MAT}",)

    @dataclass(frozen=True)
    class Options:
        file: str  #: the bank of the run-up's ends, by its mode, or the folder of the run that has one
        begin: float = 0.5  #: s, time in the clip, as the run-up's own evaluations have it
        alpha: float = (
            -0.05
        )  #: rad, angle of approach: 0 has the obstacle on its left, π/2 in front
        distance: Distance = field(
            default_factory=Distance
        )  #: m, how far from the obstacle it ends
        #: m across the obstacle and along it, by which run-ups end beside their place: the measures beside_x and beside_y
        beside: tuple[float, float] = (0.0, 0.0)

        def __post_init__(self) -> None:
            check_range(self, "begin", least=0)
            check_range(self, "beside", least=-100, most=100)
            check_angle(self, "alpha")

    def __init__(self, options: Options, context: Context) -> None:
        who = "initial_states 'jumping/approach'"
        scene = context.need_scene(CharacterScene, who)
        self._arena, self._distance = arena_of(context, who), options.distance
        self._beside = torch.tensor(options.beside, device=context.device)
        states = athletes_states(options.file, context, scene)
        ends, moving = (states[name].to(context.device) for name in ("qpos", "qvel"))
        self._at, self._dof = at, dof = scene.layout.root_address, scene.layout.root_dof
        root = ends[:, at + 3 : at + 7]
        self._turn = Takeoff(alpha=options.alpha).heading - rotations.heading(root)
        self._end, self._alpha = ends[:, at : at + 2], torch.full_like(self._turn, options.alpha)
        features = takeoff_features(root, moving[:, dof : dof + 6])
        self._features = torch.cat([features, self._alpha.unsqueeze(1)], dim=1)
        reference = reference_motion(context)
        if not reference.loop and options.begin >= (lasts := reference.duration):
            raise ConfigError(
                f"initial_states.begin={options.begin:g} is not possible: the clip lasts {lasts:.4g} s."
            )
        begin = torch.full((1,), options.begin, device=context.device)
        self._begin = reference_states(reference, begin)

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        difficulty = fields["difficulty"]
        count, at, dof = len(self._turn), self._at, self._dof
        row = (streams.uniform(1).squeeze(1) * count).long().clamp(max=count - 1)
        turn, alpha = self._turn[row], self._alpha[row]
        goal = torch.zeros_like(self._end[row])
        goal[:, 0] = -self._distance.at(self._arena.rho(difficulty), alpha)
        shift = goal - self._beside - _in_plane(self._end[row], turn)
        qpos = self._begin["qpos"].repeat(len(row), 1)
        qvel = self._begin["qvel"].repeat(len(row), 1)
        about = rotations.from_heading(turn)
        qpos[:, at : at + 2] = _in_plane(qpos[:, at : at + 2], turn) + shift
        qpos[:, at + 3 : at + 7] = rotations.multiply(about, qpos[:, at + 3 : at + 7])
        qvel[:, dof : dof + 3] = rotations.rotate(about, qvel[:, dof : dof + 3])
        return {
            "qpos": qpos,
            "qvel": qvel,
            "motion_start": self._begin["motion_start"].repeat(len(row)),
            "takeoff_features": self._features[row],
            "approach_turn": turn,
            "approach_shift": shift,
            "approach_goal": goal,
            **obstacle_at(self._arena, difficulty),
        }


class Approached(Fields):
    """Where the clip's root is on an approach: ``approached_position`` (3,) m and ``approached_heading`` () rad, the reference's
    in the world of the obstacle, for the policy of a run-up."""

    reads = ("reference_root_position", "reference_root_heading", "approach_turn", "approach_shift")
    provides: Mapping[str, Shape] = {"approached_position": (3,), "approached_heading": ()}

    def __init__(self, options: None, context: Context) -> None:
        pass

    def compute(
        self,
        reference_root_position: Tensor,
        reference_root_heading: Tensor,
        approach_turn: Tensor,
        approach_shift: Tensor,
    ) -> dict[str, Tensor]:
        level = _in_plane(reference_root_position[:, :2], approach_turn) + approach_shift
        return {
            "approached_position": torch.cat([level, reference_root_position[:, 2:]], dim=1),
            "approached_heading": reference_root_heading + approach_turn,
        }


@limits(index=(0, 1))
def beside(
    ended: Tensor,
    ended_at: Tensor,
    approach_goal: Tensor,
    *,
    index: int = 0,  #: 0: across the obstacle, forward; 1: along it
) -> Tensor:
    """m by which a run-up that ``ended`` did so at ``ended_at`` (N, 3), beside its place; NaN of others."""
    return torch.where(ended != 0, ended_at[:, index] - approach_goal[:, index], torch.nan)


def _in_plane(place: Tensor, turn: Tensor) -> Tensor:
    """Places (N, 2) m of the ground, turned about the vertical by (N,) rad."""
    cosine, sine = turn.cos(), turn.sin()
    x, y = place.unbind(dim=1)
    return torch.stack([cosine * x - sine * y, sine * x + cosine * y], dim=1)
