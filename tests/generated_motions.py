"""Generated clips, played on the humanoid's model: where everything is, and what bears it."""

from __future__ import annotations

from functools import cached_property

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray

from understudy_characters.character import Character
from understudy_characters.layout import layout_of
from understudy_characters.state import Poses
from understudy_humanoid.character import BODIES, build_spec
from understudy_motion.clip import Clip
from understudy_tensors import rotations

Array = NDArray[np.float64]

MODEL = build_spec().compile()
CHARACTER = Character("humanoid", MODEL)
LAYOUT = layout_of(CHARACTER)
FOOT = next(row for row in BODIES if row.name == "right_ankle")
#: Corners of the sole in the foot's frame, rear ones first: right, left, right, left.
_CORNERS = np.array(
    [
        [FOOT.centre[0] + x * FOOT.size[0], y * FOOT.size[1], FOOT.centre[2] - FOOT.size[2]]
        for x in (-1, 1)
        for y in (-1, 1)
    ]
)
_Y = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)


class Played:
    """A clip's frames on the model; F frames."""

    def __init__(self, clip: Clip) -> None:
        self.clip, self.times = clip, clip.times.numpy()
        self.qpos = CHARACTER.qpos(clip).numpy()
        data = mujoco.MjData(MODEL)
        found: dict[str, list[Array]] = {name: [] for name in ("xpos", "xquat", "com")}
        for qpos in self.qpos:
            data.qpos[:] = qpos
            mujoco.mj_kinematics(MODEL, data)
            mujoco.mj_comPos(MODEL, data)
            found["xpos"].append(data.xpos.copy())
            found["xquat"].append(data.xquat.copy())
            found["com"].append(data.subtree_com[1].copy())
        self.xpos, self.xquat, self.com = (np.array(values) for values in found.values())

    @cached_property
    def clearance(self) -> Array:
        """(F, L) m of each link above the floor."""
        found = Poses(CHARACTER, LAYOUT).state(torch.from_numpy(self.qpos))
        return found["link_clearances"].numpy()

    @property
    def supported(self) -> NDArray[np.bool_]:
        """(F,) whether anything touches the floor."""
        return self.clearance.min(axis=1) < 1e-3

    def sole(self, side: str) -> Array:
        """(F, 4, 3) m: the corners of a sole, world."""
        body = MODEL.body(f"{side}_ankle").id
        turned = rotations.to_matrix(torch.from_numpy(self.xquat[:, body])).numpy()
        return self.xpos[:, None, body] + np.einsum("fij,cj->fci", turned, _CORNERS)

    def hand(self, side: str) -> Array:
        """(F, 3) m: the lowest point of a hand, world."""
        return self.xpos[:, MODEL.body(f"{side}_wrist").id] - [0.0, 0.0, 0.04]

    def angle(self, joint: str) -> Array:
        """(F,) rad: the joint's turn about its y axis; knees bend positively, elbows negatively."""
        row = self.clip.joint_names.index(joint)
        return rotations.twist_angle(self.clip.rotations[:, row], _Y).numpy()


def resting(points: Array, height: float = 5e-4) -> list[slice]:
    """The stretches of frames in which a point (F, 3) is on the floor."""
    down = np.concatenate([[False], points[:, 2] < height, [False]])
    edges = np.flatnonzero(np.diff(down.astype(int)))
    return [slice(*pair) for pair in edges.reshape(-1, 2)]


def largest_slide(points: Array) -> float:
    """How far, m, a point (F, 3) gets over the floor while it is on it."""
    return max((np.ptp(points[s, :2], axis=0).max() for s in resting(points)), default=0.0)
