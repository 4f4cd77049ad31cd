"""A skeleton seen as a human body: where its parts are, and how they stand in its zero pose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from understudy_motion.clip import Skeleton
from understudy_retarget.anatomy import SIDES, Parts, path_up, rest_positions
from understudy_tensors import rotations

BONES: Mapping[str, tuple[str, str]] = {
    f"{side}_{bone}": (f"{side}_{start}", f"{side}_{end}")
    for side in SIDES
    for bone, start, end in (
        ("thigh", "hip", "knee"),
        ("shin", "knee", "ankle"),
        ("foot", "ankle", "toe"),
        ("upper_arm", "shoulder", "elbow"),
        ("forearm", "elbow", "wrist"),
    )
}
"""By segment of the body: the points that it joins. Besides these there are pelvis, chest, head."""


@dataclass(frozen=True)
class Place:
    """A point fixed to a joint's frame."""

    joint: int
    offset: np.ndarray  #: (3,) m

    def track(self, positions: Tensor, turns: Tensor) -> Tensor:
        """(F, 3) m: where it is, if the joints are at `positions` (F, J, 3), turned by (F, J, 4)."""
        offset = torch.from_numpy(self.offset)
        return positions[:, self.joint] + rotations.rotate(turns[:, self.joint], offset)


class Figure:
    """The points and segments of a skeleton's body.

    A point is where the part's joint is; a wrist, an ankle or a toe that is no joint is the tip of
    the joint before it, and the head is always one. The pelvis is the point between the hips, the
    chest that between the shoulders. Missing parts are missing here.

    Parameters
    ----------
    skeleton, parts
        whose figure it is.
    stood
        (3, 3): where forward, left and up are, as columns, in the frame of the root of a zero pose that stands.
    """

    def __init__(self, skeleton: Skeleton, parts: Parts, stood: np.ndarray | None = None) -> None:
        self.skeleton, self.parts = skeleton, parts
        self.stood = np.eye(3) if stood is None else stood
        self.rest = rest_positions(skeleton)
        #: By part.
        self.points: dict[str, Place] = {}
        for part, chain in parts.items():
            if part not in ("pelvis", "chest", "head"):
                self.points[part] = self._origin(chain[0])
        for end, before in (("ankle", "knee"), ("toe", "ankle"), ("wrist", "elbow")):
            for side in SIDES:
                self._add_tip(f"{side}_{end}", f"{side}_{before}")
        self._add_tip("head", "head")
        for middle, outer in (("pelvis", "hip"), ("chest", "shoulder")):
            pair = [f"{side}_{outer}" for side in SIDES]
            if all(part in self.points for part in pair):
                joint = parts[middle][0]
                between = np.mean([self.at_rest(part) for part in pair], axis=0)
                self.points[middle] = Place(joint, between - self.rest[joint])
        #: By segment: the joint that carries it.
        self.segments: dict[str, int] = {
            part: parts[part][-1] for part in ("pelvis", "chest", "head") if part in parts
        }
        for segment, (start, end) in BONES.items():
            if start in parts and (segment.endswith("foot") or self.ends_at(start)):
                self.segments[segment] = parts[start][-1]
            elif start in self.points and end in self.points:
                self.segments[segment] = self.points[end].joint
        #: (3, 3): columns forward, left and up of the zero pose.
        self.axes = self._body_axes(known=stood is not None)
        #: By side: how a foot is turned from the zero pose, in these axes, to be flat on the floor and point ahead; feet
        #: that are so in the zero pose are left out.
        self.flat: dict[str, Rotation] = {}
        #: By side: the axis (3,) about which a knee bends, in these axes, where it is known.
        self.knees: dict[str, np.ndarray] = {}

    def _origin(self, joint: int) -> Place:
        """A joint's origin, as a point of what the joint hangs on."""
        return Place(max(0, self.skeleton.parents[joint]), self.skeleton.offsets[joint])

    def _add_tip(self, part: str, before: str) -> None:
        if part in self.points or before not in self.parts:
            return
        joint = self.parts[before][-1]
        tip = self.skeleton.tips.get(self.skeleton.joint_names[joint])
        if tip is not None:
            self.points[part] = Place(joint, np.asarray(tip, dtype=np.float64))

    def ends_at(self, part: str) -> bool:
        """Whether nothing is known of the limb beyond the part's joint but how that turns."""
        joint = self.parts[part][-1]
        name = self.skeleton.joint_names[joint]
        return joint not in self.skeleton.parents and name not in self.skeleton.tips

    def at_rest(self, part: str) -> np.ndarray:
        """(3,) m: the point in the zero pose, in the root's frame."""
        place = self.points[part]
        return self.rest[place.joint] + place.offset

    def between(self, start: str, end: str) -> np.ndarray:
        """(3,) m: from one point to another in the zero pose: forward, left and up."""
        return self.axes.T @ (self.at_rest(end) - self.at_rest(start))

    def above_joint(self, part: str) -> np.ndarray:
        """(3,) m: from the joint that carries a segment to its point in the zero pose: forward, left and up; 0 if there is
        none."""
        if part not in self.points or part not in self.segments:
            return np.zeros(3)
        return self.axes.T @ (self.at_rest(part) - self.rest[self.segments[part]])

    def length(self, start: str, end: str) -> float:
        """m, in the zero pose."""
        return float(np.linalg.norm(self.at_rest(end) - self.at_rest(start)))

    def carriers(self, segment: str) -> list[int]:
        """The joints that turn the segment against the one before it, the last one first."""
        last = self.segments[segment]
        if segment not in BONES:
            return [last]
        chain = self.parts.get(BONES[segment][0], (last,))
        path = list(path_up(self.skeleton, last))
        return path[: path.index(chain[0]) + 1] if chain[0] in path else [last]

    def _legs(self) -> np.ndarray:
        """(3,) m: from the middle of the ankles to the pelvis, in the root's frame; 0 if one of them is missing."""
        ankles = [f"{side}_ankle" for side in SIDES]
        if not all(part in self.points for part in ("pelvis", *ankles)):
            return np.zeros(3)
        return self.at_rest("pelvis") - np.mean([self.at_rest(part) for part in ankles], axis=0)

    def _body_axes(self, known: bool) -> np.ndarray:
        up = self.stood[:, 2]
        if "pelvis" in self.points and "chest" in self.points:
            trunk = self.at_rest("chest") - self.at_rest("pelvis")
            legs = self._legs()
            stands = known and legs @ up > 0.9 * max(float(np.linalg.norm(legs)), 1e-6)  # if bent
            if not stands and trunk @ up < 0.7 * np.linalg.norm(trunk):  # a zero pose that lies
                axis = int(np.argmax(np.abs(trunk)))
                up = np.sign(trunk[axis]) * np.eye(3)[axis]
        left = self.stood[:, 1]
        for part in ("hip", "shoulder"):
            pair = [f"{side}_{part}" for side in SIDES]
            if all(p in self.points for p in pair):
                left = self.at_rest(pair[0]) - self.at_rest(pair[1])
                break
        level = left - (left @ up) * up
        if np.linalg.norm(level) < 1e-6 * np.linalg.norm(left):  # a zero pose that tells nothing
            level = np.eye(3)[(int(np.argmax(np.abs(up))) + 2) % 3]
        left = level / np.linalg.norm(level)
        return np.column_stack((np.cross(left, up), left, up))
