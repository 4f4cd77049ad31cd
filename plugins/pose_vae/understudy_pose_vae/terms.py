"""How natural poses are, as a reward and as a measure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from understudy.errors import ConfigError, RunError
from understudy.task import Context
from understudy_basics import rotations
from understudy_characters.scene import CharacterScene
from understudy_pose_vae.job import POSES, trained_poses


def naturalness(
    offset_norm: Tensor, offset_limit: Tensor | None = None, *, limit: float = 48.0
) -> Tensor:
    """r_naturalness = 1 - clip((‖a_offset‖₁ / c_offset)², 0, 1) (eq. 4.3).

    c_offset, in rad, is the field ``offset_limit`` where a curriculum provides it, else `limit`; section
    4.6.1 has 48 at the easiest and 15 at the hardest. For a reward at the end of an episode only, let
    `offset_norm` be its mean so far (memory ``running_mean``, ``reads: {offset_norm: MEAN}``).
    """
    most = limit if offset_limit is None else offset_limit
    return 1 - ((offset_norm / most) ** 2).clamp(0.0, 1.0)


class PoseDistance:
    """Degrees, a joint's mean, from the pose to the nearest that the auto-encoder of ``run`` learned from.

    Nearest by the joints' rotation matrices' first and last columns; the character's joints that the
    clips lack do not count.
    """

    @dataclass(frozen=True)
    class Options:
        run: str  #: folder of the run that trained the auto-encoder

    def __init__(self, options: Options, context: Context) -> None:
        assert context.registry is not None
        scene = context.need_scene(CharacterScene, "measure 'pose_vae/distance'")
        trained = trained_poses(options.run, context.registry, context.device)
        names = scene.layout.joint_names
        shared = [name for name in names if name in trained.joints]
        if not shared:
            raise ConfigError(f"{options.run} has no joint that {scene.character.name} has.")
        try:
            found = np.load(runs_file(options.run), allow_pickle=False)
        except (OSError, ValueError) as error:
            raise RunError(
                f"{options.run} has no poses to compare with; finish it first."
            ) from error
        own = [trained.joints.index(name) for name in shared]
        poses = rotations.normalize(torch.from_numpy(found[:, own].astype(np.float32)))
        self._poses = poses.to(context.device)
        self._known = rotations.tangent_normal(self._poses).flatten(1)
        self._rows = torch.tensor([names.index(name) for name in shared], device=context.device)
        rests = scene.character.rest_rotations.as_quat(scalar_first=True)[1:]
        self._rests = torch.from_numpy(rests).float().to(context.device)[self._rows]

    def __call__(self, joint_rotations: Tensor) -> Tensor:
        turned, rests = joint_rotations[:, self._rows], self._rests
        pose = rotations.multiply(rotations.multiply(rests, turned), rotations.conjugate(rests))
        seen = rotations.tangent_normal(pose).flatten(1)
        nearest = torch.cdist(seen, self._known).argmin(1)
        angle = rotations.angle_between(pose, self._poses[nearest]).mean(1)
        return angle * (180 / math.pi)


def runs_file(run: str) -> str:
    """Where the run folder `run` has the poses that it learned from."""
    return f"{run}/{POSES}"
