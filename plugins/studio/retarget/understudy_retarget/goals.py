"""What the source's motion asks of the target: key points on its own limbs, and turns of its segments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

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

_NONE = np.zeros(3)
_SHORTEST = 1e-3
"""m: what is shorter has no direction."""
_TURNED, _BENT = 0.35, 0.8
"""rad that shoulders or a spine, and a neck, are turned by at least in a zero pose whose chest is."""
_TALL = 0.25
"""Of the trunk's length what a chest's shoulders are above its joint at least for that to say how the chest stands."""


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
        for shoulder in (f"{side}_shoulder" for side in SIDES):
            if shoulder in target.points and shoulder not in self.points:  # of one arm
                place = torch.from_numpy(target.at_rest(shoulder) - target.at_rest("pelvis"))
                turn = self.turns.get("chest", self.turns["pelvis"])
                self.points[shoulder] = self.points["pelvis"] + rotations.rotate(turn, place)

    def _upright(self, segment: str, start: str, end: str) -> Tensor:
        """From `start` to `end`, as the source leans against how it stands in its zero pose."""
        source, target = self._source, self._target
        theirs, ours = source.between(start, end), target.between(start, end)
        turned = _turn(source, target, segment)
        if end == "chest":  # straightened, where the zero pose's chest is turned
            above = target.above_joint("chest")
            ours = ours - above + _chest_turn(source, target).apply(above)
        length = float(np.linalg.norm(ours))
        ours = turned.apply(ours)
        body = _quaternion(Rotation.from_matrix(target.axes) * turned.inv())
        world = rotations.multiply(self.turns[segment], body)  # from forward, left, up
        leaning = rotations.inverse_rotate(world, self._at(end) - self._at(start))
        turn = rotations.multiply(world, _quaternion(_shortest_turn(theirs, ours)))
        return length / source.length(start, end) * rotations.rotate(turn, leaning)

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
    their bones parallel, forearms after the upper arms that they hang on, and legs so that knees bend ahead. A foot is spread as its leg is, and turned about
    the leg, not pitched: both stand on their soles; the target's is put on its sole if it is not in the zero pose. A
    forearm of unknown direction is parallel to the upper arm. So are shoulders, where the target's chest is turned.
    """
    turn = _turn(source, target, segment)
    axes = Rotation.from_matrix(source.axes) * turn * Rotation.from_matrix(target.axes).inv()
    return _quaternion(axes)


def _turn(source: Figure, target: Figure, segment: str) -> Rotation:
    """Of the target's segment in the zero pose, forward, left, up, to how it is when the source is in its own."""
    side, _, name = segment.partition("_")
    if segment in ("chest", "head"):
        return _chest_turn(source, target)
    if name == "foot" and side in target.flat:
        ahead = _direction(source, segment) * [1.0, 1.0, 0.0]
        down = _direction(source, f"{side}_shin") * [0.0, 1.0, 1.0]
        yaw = _shortest_turn(np.array([1.0, 0.0, 0.0]), ahead)
        return _shortest_turn(np.array([0.0, 0.0, -1.0]), down) * yaw * target.flat[side]
    if name == "foot":
        spread = _bone_turn(source, target, f"{side}_shin", [0.0, 1.0, 1.0])
        return spread * _bone_turn(source, target, segment, [1.0, 1.0, 0.0], spread)
    if name == "forearm":
        known = BONES[segment][1] in source.points
        upper = f"{side}_upper_arm"
        above = _turn(source, target, upper)
        return _bone_turn(source, target, segment, theirs=segment if known else upper, above=above)
    if name == "upper_arm":
        return _bone_turn(source, target, segment, above=_chest_turn(source, target))
    if name in ("thigh", "shin"):
        turn = _bone_turn(source, target, segment)
        along, axis = (
            turn.apply(v) for v in (_direction(target, segment), target.knees.get(side, _NONE))
        )
        level, left = (v - (v @ along) * along for v in (axis, np.array([0.0, 1.0, 0.0])))
        more = _shortest_turn(level if level @ left > 0.0 else -level, left)
        sure = min(np.linalg.norm(level), np.linalg.norm(left)) > 0.5
        return more * turn if sure and more.magnitude() > _TURNED else turn
    return _bone_turn(source, target, segment) if segment in BONES else Rotation.identity()


def _chest_turn(source: Figure, target: Figure) -> Rotation:
    """What makes the target's chest parallel to the source's, if it is turned in the zero pose: by its shoulders; then by
    its neck, or, where one of the two has no head, by how its shoulders stand above its joint."""
    turn = Rotation.identity()
    spines = [figure.above_joint("chest") for figure in (source, target)]
    for ends in (("right_shoulder", "left_shoulder"), ("chest", "head")):
        if all(end in figure.points for end in ends for figure in (source, target)):
            theirs, ours = source.between(*ends), turn.apply(target.between(*ends))
            more = _shortest_turn(ours, theirs)
            if min(np.linalg.norm(theirs), np.linalg.norm(ours)) > _SHORTEST and (
                more.magnitude() > (_TURNED if ends[0] != "chest" else _BENT)
            ):
                turn = more * turn
    headless = not all("head" in figure.points for figure in (source, target))
    if headless and all(
        "pelvis" in figure.points
        and np.linalg.norm(spine) > _TALL * figure.length("pelvis", "chest")
        for figure, spine in zip((source, target), spines, strict=True)
        if "chest" in figure.points
    ):
        more = _shortest_turn(turn.apply(spines[1]), spines[0])
        turn = more * turn if more.magnitude() > _TURNED else turn
    return turn


def _direction(figure: Figure, bone: str) -> np.ndarray:
    """(3,) of length 1, or 0 if it is not known: forward, left, up, in the zero pose."""
    if not all(end in figure.points for end in BONES[bone]):
        return np.zeros(3)
    along = figure.between(*BONES[bone])
    return along / max(float(np.linalg.norm(along)), 1e-9)


def _bone_turn(
    source: Figure,
    target: Figure,
    bone: str,
    directions: Sequence[float] = (1.0, 1.0, 1.0),
    before: Rotation | None = None,
    *,
    theirs: str = "",
    above: Rotation | None = None,
) -> Rotation:
    """The turn that makes the target's bone parallel to the source's, or to `theirs` of it, in the zero pose, if `before`
    is applied after it; `above` is how what it hangs on is turned. Only these directions (forward, left, up) count."""
    above = Rotation.identity() if above is None else above
    pairs = ((source, BONES[theirs or bone]), (target, BONES[bone]))
    if not all(end in figure.points for figure, ends in pairs for end in ends):
        return above
    wanted = source.between(*pairs[0][1])
    wanted = (wanted if before is None else before.inv().apply(wanted)) * directions
    ours = above.apply(target.between(*pairs[1][1])) * directions
    if min(np.linalg.norm(wanted), np.linalg.norm(ours)) < _SHORTEST:
        return above
    return _shortest_turn(ours, wanted) * above


def _shortest_turn(start: np.ndarray, end: np.ndarray) -> Rotation:
    if min(np.linalg.norm(start), np.linalg.norm(end)) < 1e-9:
        return Rotation.identity()
    return Rotation.align_vectors(end, start)[0]


def _quaternion(rotation: Rotation) -> Tensor:
    return torch.from_numpy(rotation.as_quat(scalar_first=True))


def _ratio(source: Figure, target: Figure, bones: tuple[str, ...]) -> float:
    """The target's lengths in the source's."""
    pairs = [BONES[f"{side}_{bone}"] for side in SIDES for bone in bones]
    return sum(target.length(*p) for p in pairs) / sum(source.length(*p) for p in pairs)


def _unit(vectors: Tensor) -> Tensor:
    return vectors / torch.linalg.vector_norm(vectors, dim=-1, keepdim=True).clamp(min=1e-9)
