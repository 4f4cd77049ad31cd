"""What the source's motion asks of the target: key points on its own limbs, and turns of its segments."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from understudy_motion.clip import Clip
from understudy_motion.kinematics import forward_kinematics
from understudy_retarget import feet
from understudy_retarget.anatomy import SIDES
from understudy_retarget.feet import Contacts, Sole
from understudy_retarget.figure import BONES, Figure
from understudy_tensors import rotations

_SHORTEST = 1e-3
"""m: what is shorter has no direction."""


class Goals:
    """Key points by part, (F, 3) m, and turns by segment of the body, (F, 4), world, float64.

    Parameters
    ----------
    clip
        the motion, not looping.
    source
        the clip's figure.
    target
        the character's figure, which has legs.
    scale
        of travel and height; None takes the ratio of the legs.
    """

    def __init__(self, clip: Clip, source: Figure, target: Figure, scale: float | None) -> None:
        self.times = clip.times
        self._source, self._target = source, target
        self._positions, self._world = forward_kinematics(clip)
        #: By segment of the body: its rotation.
        self.turns = {
            segment: rotations.multiply(self._world[:, joint], _alignment(source, target, segment))
            for segment, joint in source.segments.items()
            if segment in target.segments
        }
        self.scale = scale or _ratio(source, target, ("thigh", "shin"))
        #: By part.
        self.points: dict[str, Tensor] = {}
        self._trunk()
        for side in SIDES:
            for bone in ("thigh", "shin", "upper_arm", "forearm"):
                self._limb(f"{side}_{bone}")
            if f"{side}_toe" in target.points and f"{side}_foot" in self.turns:
                toe = target.at_rest(f"{side}_toe") - target.at_rest(f"{side}_ankle")
                self.points[f"{side}_toe"] = self.points[f"{side}_ankle"] + rotations.rotate(
                    self.turns[f"{side}_foot"], torch.from_numpy(toe)
                )

    def _trunk(self) -> None:
        source, target = self._source, self._target
        self.points["pelvis"] = self.scale * self._at("pelvis")
        for side in SIDES:
            across = target.at_rest(f"{side}_hip") - target.at_rest("pelvis")
            turned = rotations.rotate(self.turns["pelvis"], torch.from_numpy(across))
            self.points[f"{side}_hip"] = self.points["pelvis"] + turned
        for segment, start, end in (("pelvis", "pelvis", "chest"), ("chest", "chest", "head")):
            spans = all(p in f.points for p in (start, end) for f in (source, target))
            spans = spans and start in self.points and segment in self.turns
            if spans and min(f.length(start, end) for f in (source, target)) > _SHORTEST:
                self.points[end] = self.points[start] + self._upright(segment, start, end)
        if "chest" in self.points:
            width = target.length("left_shoulder", "right_shoulder")
            across = _unit(self._at("left_shoulder") - self._at("right_shoulder"))
            self.points["left_shoulder"] = self.points["chest"] + 0.5 * width * across
            self.points["right_shoulder"] = self.points["chest"] - 0.5 * width * across

    def _upright(self, segment: str, start: str, end: str) -> Tensor:
        """From `start` to `end`, as the source leans against how it stands in its zero pose."""
        source, target = self._source, self._target
        theirs, ours = source.between(start, end), target.between(start, end)
        body = _quaternion(Rotation.from_matrix(target.axes))
        world = rotations.multiply(self.turns[segment], body)  # from forward, left, up
        leaning = rotations.inverse_rotate(world, self._at(end) - self._at(start))
        turn = rotations.multiply(world, _quaternion(_shortest_turn(theirs, ours)))
        return (
            target.length(start, end) / source.length(start, end) * rotations.rotate(turn, leaning)
        )

    def _limb(self, bone: str) -> None:
        start, end = BONES[bone]
        if all(p in f.points for p in (start, end) for f in (self._source, self._target)):
            along = _unit(self._at(end) - self._at(start))
            self.points[end] = self.points[start] + self._target.length(start, end) * along

    def _at(self, part: str) -> Tensor:
        """(F, 3) m: the point of the source."""
        return self._source.points[part].track(self._positions, self._world)

    def foot(self, side: str) -> tuple[Tensor, Tensor]:
        """The ankle (F, 3) and the rotation (F, 4) of what carries the sole."""
        segment = f"{side}_foot" if f"{side}_foot" in self.turns else f"{side}_shin"
        return self.points[f"{side}_ankle"], self.turns[segment]

    def stand(self, soles: Mapping[str, Sole]) -> dict[str, Contacts]:
        """Move everything up or down so that the floor is at z = 0; returns when feet touch it.

        Contacts are judged by the source's own ankles, which rest as well as they were recorded.
        """
        if not soles:
            return {}
        own = [(*self.foot(side), sole) for side, sole in soles.items()]
        theirs = {
            side: (self.scale * self._at(f"{side}_ankle"), self.foot(side)[1], sole)
            for side, sole in soles.items()
        }
        down = feet.find_floor(self.times, own).at(self.points["pelvis"])
        self.points = {
            part: torch.cat((track[:, :2], track[:, 2:] - down[:, None]), dim=1)
            for part, track in self.points.items()
        }
        floor = feet.find_floor(self.times, list(theirs.values()))
        return {side: feet.contacts(self.times, *foot, floor) for side, foot in theirs.items()}


def _alignment(source: Figure, target: Figure, segment: str) -> Tensor:
    """(4,): from the frame of the target's segment to that of the source's, both in the zero pose.

    The two figures face the same way and stand upright; limbs are turned by the least that makes
    their bones parallel. A foot is spread as its leg is, and turned about the leg, not pitched: both
    stand on their soles. A forearm of unknown direction is parallel to the upper arm.
    """
    side, _, name = segment.partition("_")
    turn = Rotation.identity()
    if name == "foot":
        spread = _bone_turn(source, target, f"{side}_shin", turn, [0.0, 1.0, 1.0])
        turn = spread * _bone_turn(source, target, segment, spread, [1.0, 1.0, 0.0])
    elif segment in BONES:
        known = BONES[segment][1] in source.points
        bone = segment if known else segment.replace("forearm", "upper_arm")
        turn = _bone_turn(source, target, bone, turn, [1.0, 1.0, 1.0])
    axes = Rotation.from_matrix(source.axes) * turn * Rotation.from_matrix(target.axes).inv()
    return _quaternion(axes)


def _bone_turn(
    source: Figure, target: Figure, bone: str, before: Rotation, directions: list[float]
) -> Rotation:
    """The turn that makes the target's bone parallel to the source's in the zero pose if `before` is
    applied after it. Only these directions (forward, left, up) count."""
    ends = BONES[bone]
    if not all(end in figure.points for end in ends for figure in (source, target)):
        return Rotation.identity()
    theirs = before.inv().apply(source.between(*ends)) * directions
    ours = target.between(*ends) * directions
    if min(np.linalg.norm(theirs), np.linalg.norm(ours)) < _SHORTEST:
        return Rotation.identity()
    return _shortest_turn(ours, theirs)


def _shortest_turn(start: np.ndarray, end: np.ndarray) -> Rotation:
    return Rotation.align_vectors(end, start)[0]


def _quaternion(rotation: Rotation) -> Tensor:
    return torch.from_numpy(rotation.as_quat(scalar_first=True))


def _ratio(source: Figure, target: Figure, bones: tuple[str, ...]) -> float:
    """The target's lengths in the source's."""
    pairs = [BONES[f"{side}_{bone}"] for side in SIDES for bone in bones]
    return sum(target.length(*p) for p in pairs) / sum(source.length(*p) for p in pairs)


def _unit(vectors: Tensor) -> Tensor:
    return vectors / torch.linalg.vector_norm(vectors, dim=-1, keepdim=True).clamp(min=1e-9)
