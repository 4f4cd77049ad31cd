"""How natural poses and movements are, as a reward and as measures (thesis, figure 4.8)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from understudy.errors import ConfigError, RunError
from understudy.task import Context, Memory, Shape
from understudy_characters.scene import CharacterScene
from understudy_pose_vae.job import POSES, trained_poses
from understudy_tensors import rotations
from understudy_tensors.limits import limits


@limits(limit=(1e-9, 1e3))
def naturalness(
    offset_norm: Tensor,
    offset_limit: Tensor | None = None,
    *,
    limit: float = 48.0,  #: rad, c_offset, used where no curriculum gives it (section 4.6.1)
) -> Tensor:
    """r_naturalness = 1 - clip((‖a_offset‖₁ / c_offset)², 0, 1) (eq. 4.3).

    c_offset, in rad, is the field ``offset_limit`` where a curriculum provides it, else `limit`; section
    4.6.1 has 48 at the easiest and 15 at the hardest. For a reward at the end of an episode only, let
    `offset_norm` be its mean so far (memory ``running_mean``, ``reads: {offset_norm: MEAN}``). Where no
    pose auto-encoder gives a pose, it may be how far the servos' targets are from the pose that the
    figure has.
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
        scene = context.need_scene(CharacterScene, "measure 'pose_vae/distance'")
        trained = trained_poses(options.run, context)
        names = scene.layout.joint_names
        shared = [name for name in names if name in trained.joints]
        if not shared:
            raise ConfigError(f"{options.run} has no joint that {scene.character.name} has.")
        given = Path(options.run) / POSES
        said = [file] if (file := given.with_name("run.json")).is_file() else []  # of what clips
        kept = context.inputs.file(f"poses of {options.run}", lambda: [given, *said])
        if not kept.is_file():
            raise RunError(f"{options.run} has no poses to compare with; finish it first.")
        own = [trained.joints.index(name) for name in shared]
        found = learned_poses(kept, len(trained.joints))[:, own]
        poses = rotations.normalize(torch.from_numpy(found))
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


def learned_poses(file: Path, joints: int) -> np.ndarray:
    """The poses (P, joints, 4) float32 that an auto-encoder learned from.

    Raises
    ------
    RunError
        if the file holds anything else.
    """
    try:
        with np.errstate(over="ignore"):
            # mapped, since a header can claim any size: one larger than the file is refused
            found = np.lib.format.open_memmap(file, mode="r")
            if found.dtype.kind == "f" and found.shape[1:] == (joints, 4) and len(found):
                poses = found.astype(np.float32)
                if (np.abs(np.linalg.norm(poses, axis=2) - 1.0) < 0.1).all():
                    return poses
        reason = f"it holds {found.dtype} of shape {found.shape}"
    except Exception as error:  # numpy raises whatever its parsing of damage raises
        reason = " ".join(str(error).split())[:200]
    raise RunError(
        f"{file} is damaged: it should hold poses of {joints} unit quaternions, and {reason}; train "
        "the auto-encoder again."
    )


class Jerk(Memory):
    """``jerk`` () m/s³, the mean over the character's links and the episode so far of how large the third
    derivative of their positions is, by differences over control periods; 0 before the third."""

    reads = ("xpos", "episode_step")

    def __init__(self, options: None, context: Context) -> None:
        layout = context.need_scene(CharacterScene, "memory 'pose_vae/jerk'").layout
        self._links = layout.link_bodies.to(context.device)
        self._dt = context.control_dt
        self.keeps: Mapping[str, Shape] = {"jerk": (), "past": (3, len(self._links), 3)}

    def begin(self, xpos: Tensor, episode_step: Tensor) -> dict[str, Tensor]:
        at = xpos[:, self._links]
        return {"jerk": torch.zeros_like(at[:, 0, 0]), "past": torch.stack([at] * 3, dim=1)}

    def advance(
        self, kept: Mapping[str, Tensor], xpos: Tensor, episode_step: Tensor
    ) -> dict[str, Tensor]:
        at, past = xpos[:, self._links], kept["past"]
        one, two, three = past.unbind(1)  # periods ago
        size = (at - 3.0 * (one - two) - three).norm(dim=2).mean(1) / self._dt**3
        count = episode_step - 2  # of differences that the episode has had
        mean = kept["jerk"] + (size - kept["jerk"]) / count.clamp(min=1)
        return {
            "jerk": torch.where(count > 0, mean, 0.0),
            "past": torch.cat([at.unsqueeze(1), past[:, :2]], dim=1),
        }
