"""Which joint of a skeleton is which part of a body: by the joints' names, else by the tree's shape.

A *part* is a joint of the human body: :data:`PARTS`. Conventions differ in what they call one: some
name a joint (SMPL's ``left_hip``), most the bone that begins there (``lfemur``, ``LeftUpLeg``,
``left_thigh``), and the same word may mean two parts (Mixamo's ``LeftShoulder`` is a clavicle). So of
the words for a part, :data:`WORDS`, the first that the skeleton has counts.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations, pairwise

import numpy as np

from understudy.errors import ConfigError
from understudy_motion.clip import Skeleton

SIDES = ("left", "right")
LEG = ("hip", "knee", "ankle", "toe")
ARM = ("shoulder", "elbow", "wrist")
PARTS: tuple[str, ...] = (
    "pelvis",
    "chest",
    "head",
    *(f"{side}_{part}" for side in SIDES for part in (*LEG, *ARM)),
)

WORDS: Mapping[str, tuple[str, ...]] = {
    "hip": ("upleg", "upperleg", "thigh", "femur", "hip"),
    "knee": ("knee", "lowleg", "lowerleg", "shin", "shank", "tibia", "calf", "leg"),
    "ankle": ("ankle", "foot"),
    "toe": ("toebase", "toes", "toe", "ball", "foot"),
    "shoulder": ("upperarm", "uparm", "humerus", "arm", "shoulder"),
    "elbow": ("elbow", "forearm", "lowerarm", "lowarm", "radius", "ulna"),
    "wrist": ("wrist", "hand"),
    "head": ("head", "skull", "upperneck", "neck"),
    "chest": ("upperchest", "chest", "thorax", "torso", "upperback", "spine"),
}
"""Of each part the words for it, the least ambiguous first. The chest and the pelvis are where the
arms and the legs part; the words for a chest are for figures without arms."""

_SIDE_WORDS = {"left": "left", "l": "left", "right": "right", "r": "right"}
#: What joint names have besides: kinds of things, axes of a robot's hinges, rigs' prefixes.
_NOISE = frozenset(
    (
        "link", "joint", "jnt", "body", "bone", "pitch", "roll", "yaw", "x", "y", "z",
        "mixamorig", "bip", "j", "b", "m", "f", "avg", "def", "armature",
    )
)  # fmt: skip
_KNOWN_WORDS = frozenset(word for words in WORDS.values() for word in words)

Parts = Mapping[str, tuple[int, ...]]
"""By part: its joints, from the first to the last of a chain (a robot's hip is three)."""


def find_parts(skeleton: Skeleton, given: Mapping[str, int], owner: str) -> Parts:
    """The parts of `skeleton`; those `given` are what they are said to be.

    Parameters
    ----------
    skeleton
        a tree of joints, z up.
    given
        joints by part, known beforehand.
    owner
        whose skeleton it is, for errors.

    Raises
    ------
    ConfigError
        two joints could be the same part.
    """
    found: dict[str, tuple[int, ...]] = {part: (joint,) for part, joint in given.items()}
    names = [describe(name) for name in skeleton.joint_names]
    for side in SIDES:
        for limb in (LEG, ARM):
            above: int | None = None
            for part in limb:
                sided = f"{side}_{part}"
                if sided not in found:
                    taken = {joint for chain in found.values() for joint in chain}
                    fitting = (
                        [
                            joint
                            for joint, name in enumerate(names)
                            if name == (side, word)
                            and joint not in taken
                            and (above is None or _hangs_on(skeleton, joint, above))
                        ]
                        for word in WORDS[part]
                    )
                    if joints := next(filter(None, fitting), None):
                        found[sided] = _chain(skeleton, joints, sided, owner)
                if sided in found:
                    above = found[sided][-1]
    for part in ("head", "chest"):
        if part not in found:
            fitting = (
                [j for j, name in enumerate(names) if name == ("", word)] for word in WORDS[part]
            )
            if joints := next(filter(None, fitting), None):
                found[part] = _chain(skeleton, joints, part, owner)
    for limb in (LEG, ARM):
        if not all(f"{side}_{part}" in found for side in SIDES for part in limb[:2]):
            for part, joint in _limbs_by_shape(skeleton, limb is LEG).items():
                found.setdefault(part, (joint,))
    hips = [found[part][0] for side in SIDES if (part := f"{side}_hip") in found]
    shoulders = [found[part][0] for side in SIDES if (part := f"{side}_shoulder") in found]
    if "pelvis" not in given:
        found["pelvis"] = (_common_ancestor(skeleton, hips) if len(hips) == 2 else 0,)
    if "chest" not in given and len(shoulders) == 2:
        found["chest"] = (_common_ancestor(skeleton, shoulders),)
    return found


def describe(name: str) -> tuple[str, str]:
    """Side ("" in the middle) and word of a joint's name, in lower case without what says nothing.

    ``mixamorig:LeftUpLeg``, ``robot/left_up_leg`` and ``left_up_leg_link`` are ("left", "upleg"), ``lfemur`` is
    ("left", "femur"), ``Bip01 R Calf`` is ("right", "calf").
    """
    tokens = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", re.split("[:/|]", name)[-1])
    words = [token.lower() for token in tokens]
    side = next((_SIDE_WORDS[word] for word in words if word in _SIDE_WORDS), "")
    word = "".join(word for word in words if word not in _SIDE_WORDS and word not in _NOISE)
    if not side and word not in _KNOWN_WORDS:
        for prefix, meant in _SIDE_WORDS.items():
            if word.startswith(prefix) and word.removeprefix(prefix) in _KNOWN_WORDS:
                return meant, word.removeprefix(prefix)
    return side, word


def rest_positions(skeleton: Skeleton) -> np.ndarray:
    """(J, 3) m: where the joints are when all rotations are the identity, the root at the origin."""
    positions = np.zeros_like(skeleton.offsets)
    for joint, parent in enumerate(skeleton.parents[1:], start=1):
        positions[joint] = positions[parent] + skeleton.offsets[joint]
    return positions


def path_up(skeleton: Skeleton, joint: int) -> Iterator[int]:
    """The joint and all that it hangs on, up to the root."""
    while joint >= 0:
        yield joint
        joint = skeleton.parents[joint]


def _hangs_on(skeleton: Skeleton, joint: int, above: int) -> bool:
    return joint != above and above in path_up(skeleton, joint)


def _common_ancestor(skeleton: Skeleton, joints: Sequence[int]) -> int:
    first, second = (list(path_up(skeleton, joint)) for joint in joints)
    return next(joint for joint in first if joint in second and joint not in joints)


def _chain(skeleton: Skeleton, joints: list[int], part: str, owner: str) -> tuple[int, ...]:
    for upper, lower in pairwise(joints):
        if not _hangs_on(skeleton, lower, upper):
            names = skeleton.joint_names
            raise ConfigError(
                f"{owner}: its {part} may be '{names[upper]}' or '{names[lower]}'; say which with "
                f"--map {part}={names[upper]}."
            )
    return tuple(joints)


# ---------------------------------------------------------------------- by shape


def _limbs_by_shape(skeleton: Skeleton, legs: bool) -> dict[str, int]:
    """The joints of the two legs, or of the two arms, from where they are in the zero pose.

    Limbs are two branches of one joint, about equally long and mirrored left and right; legs end
    lowest, arms reach farthest to the sides. Their two long bones meet at the knee or the elbow.
    """
    positions = rest_positions(skeleton)
    pairs = list(_mirrored_branches(skeleton, positions))
    if not pairs:
        return {}
    ends = [np.mean([branch[-1] for branch in pair.points], axis=0) for pair in pairs]
    lowest = int(np.argmin([end[2] for end in ends]))
    if legs:
        chosen = pairs[lowest]
    else:
        legs_too = {joint for branch in pairs[lowest].branches for joint in branch}
        others = [p for p in pairs if not legs_too & {j for branch in p.branches for j in branch}]
        if not others:
            return {}
        chosen = max(others, key=lambda pair: pair.length)
    found = {}
    for branch, points in zip(chosen.branches, chosen.points, strict=True):
        side = "left" if points[-1][1] > positions[chosen.joint][1] else "right"
        for part, joint in zip(LEG if legs else ARM, _long_bones(branch, points), strict=False):
            found[f"{side}_{part}"] = joint
    return found


class _Pair:
    """Two mirrored branches of one joint: their joints, and those joints' positions and tips."""

    def __init__(
        self, joint: int, branches: list[list[int]], points: list[np.ndarray], length: float
    ) -> None:
        self.joint, self.branches, self.points, self.length = joint, branches, points, length


def _mirrored_branches(skeleton: Skeleton, positions: np.ndarray) -> Iterator[_Pair]:
    children: list[list[int]] = [[] for _ in skeleton.parents]
    for joint, parent in enumerate(skeleton.parents[1:], start=1):
        children[parent].append(joint)

    def points(branch: list[int]) -> np.ndarray:
        tip = skeleton.tips.get(skeleton.joint_names[branch[-1]])
        end = [] if tip is None else [positions[branch[-1]] + tip]
        return np.array([*positions[branch], *end])

    def length(branch: list[int]) -> float:
        return float(np.linalg.norm(np.diff(points(branch), axis=0), axis=1).sum())

    longest: dict[int, list[int]] = {}
    for joint in reversed(range(len(skeleton.parents))):
        tails = [longest[child] for child in children[joint]]
        longest[joint] = [joint, *max(([*tail] for tail in tails), key=length, default=[])]
    height = float(np.ptp(positions[:, 2]))
    for joint, below in enumerate(children):
        for one, other in combinations(below, 2):
            branches = [longest[one], longest[other]]
            ends = [points(branch)[-1] - positions[joint] for branch in branches]
            lengths = [length(branch) for branch in branches]
            across = ends[0][1] - ends[1][1]
            if (
                min(lengths) > 0.2 * height
                and abs(lengths[0] - lengths[1]) < 0.15 * max(lengths)
                and ends[0][1] * ends[1][1] < 0.0
                and np.linalg.norm(ends[0] - ends[1] - [0.0, across, 0.0]) < 0.2 * max(lengths)
            ):
                yield _Pair(joint, branches, [points(b) for b in branches], max(lengths))


def _long_bones(branch: list[int], points: np.ndarray) -> list[int]:
    """The joints where the limb's two long bones begin, and those after them."""
    bones = np.linalg.norm(np.diff(points, axis=0), axis=1)
    first = int(np.argmax(bones[:-1] + bones[1:])) if len(bones) > 1 else 0
    return branch[first:]
