"""What a motion is to the auto-encoder, frame by frame: of a simulated character and of a clip alike."""

from __future__ import annotations

import math
from collections.abc import Mapping

import mujoco
import numpy as np
import torch
from torch import Tensor

from understudy.errors import RunError
from understudy.task import Context, Fields, Shape
from understudy_characters.reference import ReferenceMotion
from understudy_characters.scene import CharacterScene
from understudy_characters.state import character_state
from understudy_motion.clip import Clip

#: The fields of :func:`~understudy_characters.state.character_state` that features are made of.
READS = ("root_position", "link_positions", "link_linear_velocities", "link_angular_velocities")


def frame_features(
    root_position: Tensor,
    link_positions: Tensor,
    link_linear_velocities: Tensor,
    link_angular_velocities: Tensor,
) -> Tensor:
    """(N, 3 L + 5): the links' places in the heading frame, m; the root's height, its velocity along the
    heading frame, m/s, and its turn about the vertical, rad/s."""
    root = torch.cat(
        [
            root_position[:, 2:],
            link_linear_velocities[:, 0],
            link_angular_velocities[:, 0, 2:],
        ],
        dim=1,
    )
    return torch.cat([link_positions.flatten(1), root], dim=1)


class MotionFeatures(Fields):
    """``motion_features`` (3 L + 5,), as :func:`frame_features`; of the humanoid 50 numbers."""

    reads = READS
    provides: Mapping[str, Shape] = {"motion_features": (0,)}

    def __init__(self, options: None, context: Context) -> None:
        layout = context.need_scene(CharacterScene, "fields 'styles/features'").layout
        self.provides = {"motion_features": (3 * len(layout.link_names) + 5,)}

    def compute(self, **fields: Tensor) -> Mapping[str, Tensor]:
        return {"motion_features": frame_features(**fields)}


def clip_features(
    clip: Clip, scene: CharacterScene, dt: float, least: int, name: str = ""
) -> Tensor:
    """(F, 3 L + 5) of the character in `scene` moving as `clip`, every `dt` s; a looping clip goes on
    for `least` frames, so that windows of so many begin at each of its phases. `name` is what
    it is called where it is refused.

    Raises
    ------
    RunError
        a clip that does not loop has fewer.
    """
    frames = math.floor(clip.duration / dt)
    if clip.loop:
        frames = max(frames, least) + least
    if frames < least:
        raise RunError(
            f"Clip {name or clip.source} has {frames} frames at {1 / dt:g} Hz, and a window has {least}. "
            "Leave the clip out, or make windows shorter (job.window, fields.gram.frames)."
        )
    reference = ReferenceMotion(clip, scene.character, scene.layout, control_dt=dt)
    found = reference.sample(torch.arange(frames) * dt)
    return frame_features(**_fields(scene, found["reference_qpos"], found["reference_qvel"]))


def _fields(scene: CharacterScene, qpos: Tensor, qvel: Tensor) -> dict[str, Tensor]:
    """What the simulator would show of these states."""
    model, data = scene.model, mujoco.MjData(scene.model)
    names = ("xpos", "xmat", "xipos", "cvel", "subtree_com")
    seen: dict[str, list[np.ndarray]] = {name: [] for name in names}
    for position, velocity in zip(qpos.double().numpy(), qvel.double().numpy(), strict=True):
        data.qpos[:], data.qvel[:] = position, velocity
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        for name in names:
            seen[name].append(getattr(data, name).copy())
    arrays = {name: torch.from_numpy(np.stack(rows)).float() for name, rows in seen.items()}
    state = character_state(scene.layout.to(torch.device("cpu")), qpos=qpos, **arrays)
    return {name: state[name] for name in READS}
