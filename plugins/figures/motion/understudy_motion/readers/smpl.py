"""NPZ clips of the SMPL family of bodies, as AMASS publishes them (Mahmood et al., ICCV 2019).

``poses`` (F, 3 J) holds a rotation vector per joint, the root's first: 22 joints of the body, then
those of SMPL (24), SMPL-H (52) or SMPL-X (55); or the parts stand apart as ``root_orient``,
``pose_body``, ``pose_jaw``, ``pose_eye`` and ``pose_hand``, of which the body is enough. Joints may have an axis of their own, and be
rotation matrices, six numbers of these, or quaternions (:mod:`understudy_motion.readers.turns`), each also flat: (F, J, 3),
(F, J, 3, 3), (F, 9 J), (F, 6 J), …. ``trans`` (F, 3) is in metres. An axis of a batch of one
clip, or of one person, is left out. The rate is ``mocap_framerate``, ``mocap_frame_rate``, ``mocap_fps``, ``frame_rate``, ``framerate`` or ``fps``. The body model's own
names of these arrays (``global_orient``, ``body_pose``, ``transl``, …) are read as well.

The body's own frames have y up, z forward and x left and are parallel in the T-pose; the world has
z up, as in AMASS, unless y is given, which is asked for where the body would stand then and lies else.

The body model is not needed, and is not here: instead of the lengths that it would give this person,
the clip has the skeleton of :data:`OFFSETS`, a nominal adult of 1.7 m. ``trans`` is taken for the
pelvis, from which it differs by the body's pelvis in its model, a constant (some 0.2 m).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from understudy.errors import FileError
from understudy_motion.clip import Clip, Skeleton
from understudy_motion.limits import check_size, checked_skeleton
from understudy_motion.origin import provenance
from understudy_motion.readers import turns
from understudy_motion.readers.frames import check_sizes, to_world
from understudy_motion.readers.npz import ZIP_MAGIC, Archive, array_names
from understudy_motion.reading import UNSAID, ClipReader, ReadOptions, metres_of, no_rate
from understudy_tensors import rotations

_SIDES = ("left", "right")

BODY: tuple[str, ...] = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle",
    "right_ankle", "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head",
    "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
)  # fmt: skip
FACE = ("jaw", "left_eye", "right_eye")
FINGERS = tuple(
    f"{side}_{finger}{joint}"
    for side in _SIDES
    for finger in ("index", "middle", "pinky", "ring", "thumb")
    for joint in (1, 2, 3)
)
JOINTS: Mapping[int, tuple[str, ...]] = {
    len(names): names
    for names in (
        BODY,
        (*BODY, "left_hand", "right_hand"),
        (*BODY, *FINGERS),
        (*BODY, *FACE, *FINGERS),
    )
}
"""Joint names of the body alone, SMPL, SMPL-H and SMPL-X, by their number."""
_COUNTS = {*JOINTS, *(number - 1 for number in JOINTS)}
"""Joints of ``poses``, with and without the root."""

PARTS: Mapping[str, int] = {"root_orient": 1, "pose_body": 21, "pose_jaw": 1, "pose_eye": 2, "pose_hand": 30}  # fmt: skip
"""Joints of the arrays that may stand for ``poses``, in its order."""

HALVES: Mapping[str, tuple[str, str]] = {
    "pose_eye": ("leye_pose", "reye_pose"),
    "pose_hand": ("left_hand_pose", "right_hand_pose"),
}
"""Arrays that may stand for a part, a side each."""

UPRIGHT = 0.8
"""Least part along y of the body's own up, on average, by which it may stand in a world with y up."""
BENT = 0.05
"""rad that knees and elbows bend together by, at least, to tell a rotation from its inverse."""
HIGH = 0.3
"""m above the floor that a standing body's pelvis is at least."""
_SMPL = 23
"""Joints of ``body_pose`` where it is SMPL's own, which has hands."""
RATES = ("mocap_framerate", "mocap_frame_rate", "frame_rate", "framerate", "fps", "mocap_fps")
NAMES: Mapping[str, tuple[str, ...]] = {
    "poses": ("pose", "full_pose", "fullpose", "smpl_poses"),
    "root_orient": ("global_orient",),
    "pose_body": ("body_pose",),
    "pose_jaw": ("jaw_pose",),
    "trans": ("transl", "translation", "smpl_trans", "root_trans", "root_translation"),
}
"""Other names of the arrays."""
_LENGTH, _MOST_LEFT_OUT = "mocap_time_length", 20.5
"""How long AMASS' clips last, s; and of how many frames one is left at least."""
_SAME = 0.005
"""What equal rates, and equal lengths, differ by at most, of themselves."""
_SCALE = "smpl_scaling"
"""What AIST++ has ``smpl_trans`` multiplied by, so that it is not in metres."""


OFFSETS: Mapping[str, tuple[str, tuple[float, float, float]]] = {
    "hip": ("pelvis", (0.06, -0.08, 0.0)),
    "spine1": ("pelvis", (0.0, 0.11, -0.03)),
    "knee": ("hip", (0.04, -0.38, 0.0)),
    "spine2": ("spine1", (0.0, 0.13, 0.02)),
    "ankle": ("knee", (-0.01, -0.42, -0.03)),
    "spine3": ("spine2", (0.0, 0.06, 0.0)),
    "foot": ("ankle", (0.03, -0.05, 0.12)),
    "neck": ("spine3", (0.0, 0.21, -0.03)),
    "collar": ("spine3", (0.07, 0.12, -0.02)),
    "head": ("neck", (0.0, 0.09, 0.05)),
    "shoulder": ("collar", (0.11, 0.04, -0.01)),
    "elbow": ("shoulder", (0.26, 0.0, -0.02)),
    "wrist": ("elbow", (0.25, 0.0, 0.0)),
    "hand": ("wrist", (0.09, 0.0, 0.0)),
    "jaw": ("head", (0.0, 0.0, 0.02)),
    "eye": ("head", (0.03, 0.06, 0.06)),
    "index1": ("wrist", (0.1, 0.0, 0.02)),
    "middle1": ("wrist", (0.1, 0.0, 0.0)),
    "ring1": ("wrist", (0.1, 0.0, -0.02)),
    "pinky1": ("wrist", (0.08, -0.01, -0.04)),
    "thumb1": ("wrist", (0.04, -0.01, 0.03)),
    **{
        f"{finger}{joint}": (f"{finger}{joint - 1}", (0.03, 0.0, 0.0))
        for finger in ("index", "middle", "pinky", "ring")
        for joint in (2, 3)
    },
    "thumb2": ("thumb1", (0.02, 0.0, 0.02)),
    "thumb3": ("thumb2", (0.02, 0.0, 0.02)),
}
"""By joint, without its side: its parent and where it is in the parent's frame, m, x left, y up,
z forward. Those of the left side; on the right x changes its sign. Estimates, to a centimetre."""

TIPS: Mapping[str, tuple[float, float, float]] = {
    "head": (0.0, 0.17, 0.0),
    "foot": (0.0, 0.0, 0.07),
    "hand": (0.08, 0.0, 0.0),
    **{f"{finger}3": (0.02, 0.0, 0.0) for finger in ("index", "middle", "pinky", "ring", "thumb")},
}
"""Crown, toes and fingertips, as in :data:`OFFSETS`."""


class SmplReader(ClipReader):
    """Reads the NPZ files of AMASS, and their like of the SMPL family."""

    suffixes = (".npz",)

    def recognises(self, head: bytes, path: Path) -> bool:
        if not head.startswith(ZIP_MAGIC):
            return False
        names = array_names(path)
        return any(_named(part, names) for part in ("poses", "root_orient", "pose_body"))

    def read(self, path: Path, options: ReadOptions = UNSAID) -> Clip:
        archive = Archive(path)
        vectors = _poses(path, archive)
        num_frames, num_joints = vectors.shape[:2]
        check_size(path, num_frames, JOINTS[num_joints])
        where = _named("trans", archive.names) or "trans"
        shape = archive.shape(where) if where in archive.names else ()
        wanted, single = [num_frames, 3], _single(shape)
        if single is not None:
            wanted.insert(single, 1)
        places = archive.floats(where, *wanted)
        scale = archive.number(_SCALE) if _SCALE in archive.names and not options.unit else 1.0
        if not 1e-6 < scale < 1e6:
            raise FileError(
                f"Clip {path}: its {_SCALE} of {scale:g} is no scale. Give motion.unit (--unit)."
            )
        translation = places.reshape(num_frames, 3) * metres_of(options.unit or "m") / scale
        high = None if options.unit else translation[:, 1 if options.up == "y" else 2]
        check_sizes(path, vectors, high)
        rate = options.rate or _rate(path, archive, num_frames)
        if options.up is None and _stands_in_y(vectors[:, 0], translation):
            raise FileError(
                f"Clip {path}: its figure stands in a world with y up, or lies in one with z up; give motion.up=y or z "
                "(--up)."
            )
        up = options.up or "z"
        joint_names = JOINTS[num_joints]
        rotation = rotations.from_exponential_map(torch.from_numpy(to_world(vectors, "y")))
        if up == "z":  # the root's turn is from the body's frame, y up, to a world with z up
            rotation[:, 0] = _into_z_up(vectors[:, 0])
        return Clip(
            name=path.stem,
            times=torch.arange(num_frames, dtype=torch.float64) / rate,
            root_position=torch.from_numpy(to_world(translation, up)),
            rotations=rotation,
            joint_names=joint_names,
            loop=bool(options.loop),
            skeleton=_skeleton(path, joint_names),
            **provenance(path, archive.content),
        )


def _poses(path: Path, archive: Archive) -> np.ndarray:
    """(F, J, 3) rotation vectors in the body's frames.

    Six numbers a joint may be rows of its matrix or columns, which makes the one rotation the inverse of the other:
    it is the one by which knees and elbows bend as a person's do. Quaternions may begin or end with their real
    part: it is the one by which joints turn less.
    """
    body = _named("poses", archive.names) or _named("pose_body", archive.names) or ""
    found = turns.layout(archive.shape(body), _COUNTS) if body else None
    poses = _poses_of(path, archive, first=False)
    if not found or found[2] not in (4, 6) or not poses.size:
        return poses
    other = _poses_of(path, archive, first=True)
    if found[2] == 4:
        least, own = (np.linalg.norm(p[:, 1:], axis=2).mean() for p in (other, poses))
        return other if least < own else poses
    more = _bend(other) - _bend(poses)
    if np.abs(other - poses).max() > BENT > abs(more):
        raise FileError(
            f"Clip {path}: whether its six numbers a joint are rows or columns of matrices cannot be told, since its "
            "knees and elbows do not bend; write rotation vectors."
        )
    return other if more > 0.0 else poses


def _bend(poses: np.ndarray) -> float:
    """rad by which knees and elbows bend together, on average, the right way."""
    at = {name: poses[:, BODY.index(name)] for name in BODY[:22]}
    legs = at["left_knee"][:, 0] + at["right_knee"][:, 0]
    return float((legs + at["right_elbow"][:, 1] - at["left_elbow"][:, 1]).mean())


def _poses_of(path: Path, archive: Archive, first: bool) -> np.ndarray:
    """(F, J, 3), `first` as :func:`.turns.vectors` has it."""
    whole = _named("poses", archive.names)
    poses = (
        _vectors(path, archive, whole, _COUNTS, first) if whole else _of_parts(path, archive, first)
    )
    root = _named("root_orient", archive.names)
    if whole and root and poses.shape[1] // 3 not in JOINTS and poses.shape[1] // 3 + 1 in JOINTS:
        orient = _vectors(path, archive, root, (1,), first)  # of the body alone
        if len(orient) == len(poses) and orient.shape[1] == 3:
            poses = np.concatenate((orient, poses), axis=1)
    joints, rest = divmod(poses.shape[1], 3)
    if rest or joints not in JOINTS:
        known = ", ".join(str(3 * known) for known in JOINTS)
        raise FileError(
            f"Clip {path}: {poses.shape[1]} pose values per frame are no body of the SMPL family "
            f"({known})."
        )
    return poses.reshape(len(poses), joints, 3)


def _of_parts(path: Path, archive: Archive, first: bool) -> np.ndarray:
    """(F, 3 J) of :data:`PARTS`: the body, with its hands where they are there, and with both a face too."""
    found: dict[str, list[np.ndarray]] = {}
    for part, joints in PARTS.items():
        name = _named(part, archive.names)
        if name or part in ("root_orient", "pose_body"):
            sizes = (joints, _SMPL) if part == "pose_body" else (joints,)
            values = _vectors(path, archive, name or part, sizes, first)
            if part == "pose_body" and values.shape[1] == 3 * _SMPL:
                joints = _SMPL  # with its hands
            optional = part not in ("root_orient", "pose_body")
            if values.shape[1] != 3 * joints and (values.shape[1] or not optional):
                raise FileError(
                    f"Clip {path}: array '{name}': {values.shape[1]} values per frame, and it "
                    f"should have {3 * joints}."
                )
            found[part] = [values] if values.shape[1] else []
        elif set(HALVES.get(part, ("",))) <= archive.names:
            sides = [_vectors(path, archive, side, (joints // 2,), first) for side in HALVES[part]]
            # Others are coefficients of the model's own hands, which are not here.
            found[part] = sides if all(2 * v.shape[1] == 3 * joints for v in sides) else []
    body = found["root_orient"] + found["pose_body"]
    hands = found.get("pose_hand", []) if body[-1].shape[1] != 3 * _SMPL else []
    jaw, eyes = (found.get(part, []) for part in ("pose_jaw", "pose_eye"))
    kept = [*body, *(jaw + eyes if hands and jaw and eyes else []), *hands]
    if len({len(values) for values in kept}) != 1:
        raise FileError(f"Clip {path}: its arrays of poses differ in their number of frames.")
    return np.concatenate(kept, axis=1)


def _named(name: str, names: Collection[str]) -> str | None:
    """What the array `name` is called among `names`, None if it is not there."""
    return next((n for n in (name, *NAMES.get(name, ())) if n in names), None)


def _vectors(
    path: Path, archive: Archive, name: str, joints: Collection[int], first: bool
) -> np.ndarray:
    """(F, 3 J) rotation vectors of an array of one of so many `joints`, in any layout of :mod:`.turns`; what is in
    none of them as it is, a frame a row."""
    shape = archive.shape(name)
    found = turns.layout(shape, joints)
    if found is None:
        # In its order numbers would go to other joints.
        if sum(size != 1 for size in shape) > 2 and shape[-1] != 3:
            raise FileError(
                f"Clip {path}: array '{name}': its shape is {shape}; write it as (frames, joints, 3), the three numbers of a "
                "rotation vector last."
            )
        values = archive.floats(name, *([None] * max(2, len(shape))))
        frames = max(shape[:2]) if _single(shape) is not None else len(values)
        return values.reshape(frames, math.prod(values.shape) // max(frames, 1))
    values = archive.floats(name, *shape).reshape(found)
    return turns.vectors(path, name, values, first).reshape(found[0], 3 * found[1])


def _single(shape: tuple[int, ...]) -> int | None:
    """Which of the first two of three axes has a size of 1, as of a batch of one clip or one person."""
    return shape[:2].index(1) if len(shape) == 3 and 1 in shape[:2] else None


def _rate(path: Path, archive: Archive, frames: int) -> float:
    lower = {name.lower(): name for name in archive.names}
    names = [lower[name] for name in RATES if name in lower]
    if not names:
        raise FileError(
            f"Clip {path}: it does not say its frame rate; give motion.rate (--source-rate)."
        )
    try:
        found = {name: archive.number(name) for name in names}
    except FileError as error:
        raise FileError(f"{error} Or give motion.rate (--source-rate).") from error
    for name, rate in found.items():
        if not 0.0 < rate <= 1e6:
            raise FileError(f"Clip {path}: '{name}' is {rate:g}, no number of frames per second.")
        if why := no_rate(rate):
            raise FileError(
                f"Clip {path}: '{name}' is {rate:g}, and {why}. Or give motion.rate (--source-rate)."
            )
    rate = found[names[0]]
    if max(found.values()) > (1.0 + _SAME) * min(found.values()):
        said = ", ".join(f"{name} {rate:g}" for name, rate in found.items())
        raise FileError(
            f"Clip {path}: it says two frame rates, {said}; give motion.rate (--source-rate), the right one."
        )
    _check_length(path, archive, frames, rate)
    return rate


def _check_length(path: Path, archive: Archive, frames: int, rate: float) -> None:
    """Refuse a clip that lasts a whole number of times less than its length, s: of its frames each second or fourth was
    kept, say, and the rate is that of all. One that was cut shorter is so by any other number."""
    try:
        length = archive.number(_LENGTH) if _LENGTH in archive.names else 0.0
    except FileError:  # nothing else is taken from it
        return
    times = length * rate / max(frames, 1)
    whole = math.ceil(times - _SAME * times) if times < _MOST_LEFT_OUT else 0
    # After the last frame that was kept, up to all but one of those to the next were left out; and some
    # writers' lengths are those between frames.
    less = whole / max(frames, 1)
    if whole >= 2 and less < 0.25 and whole - times <= less + _SAME * whole:
        raise FileError(
            f"Clip {path}: its {frames} frames at {rate:g} a second last {frames / rate:.4g} s, and its {_LENGTH} is "
            f"{length:.4g} s, as if one frame of {whole} were left; give motion.rate (--source-rate), {rate / whole:.4g} "
            f"if that is so, else {rate:g}."
        )


def _stands_in_y(vectors: np.ndarray, places: np.ndarray) -> bool:
    """Whether a body with these rotations and places (F, 3) of its root is upright, and higher, where y is up."""
    if not len(vectors):
        return False
    up = Rotation.from_rotvec(vectors).apply([0.0, 1.0, 0.0]).mean(axis=0)
    _, y, z = np.median(places, axis=0)
    return bool(up[1] > UPRIGHT and y > max(z, HIGH))


def _into_z_up(vectors: np.ndarray) -> torch.Tensor:
    """The root's rotation (F, 4) from our body frame, of its rotation (F, 3) from the body's own."""
    ours = torch.tensor([0.5, -0.5, -0.5, -0.5], dtype=torch.float64)  # x, y, z -> y, z, x
    return rotations.multiply(rotations.from_exponential_map(torch.from_numpy(vectors)), ours)


def _skeleton(path: Path, joint_names: tuple[str, ...]) -> Skeleton:
    parents, offsets = [-1], [np.zeros(3)]
    tips = {}
    for name in joint_names:
        side, part = _split(name)
        mirror = np.array([-1.0 if side == "right" else 1.0, 1.0, 1.0])
        if part in OFFSETS:
            parent, offset = OFFSETS[part]
            sided = f"{side}_{parent}"
            parents.append(joint_names.index(sided if sided in joint_names else parent))
            offsets.append(to_world(mirror * offset, "y"))
        if part in TIPS:
            tips[name] = to_world(mirror * TIPS[part], "y")
    return checked_skeleton(path, joint_names, parents, np.stack(offsets), tips)


def _split(name: str) -> tuple[str, str]:
    """Side ("" for the middle) and name without it."""
    side, _, part = name.partition("_")
    return (side, part) if side in _SIDES else ("", name)
