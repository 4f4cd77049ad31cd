"""Robots' motions as NPZ: what retargeting programs and motion libraries keep in pickles, saved by ``np.savez``.

Arrays are the root's position (F, 3) m, ``root_pos``, ``root_trans``, ``root_trans_offset`` or ``root_position``; its
quaternion (F, 4), ``root_rot``, ``root_quat``, ``root_orn`` or ``root_orientation``, as xyzw, or as wxyz if only so the root
is upright; and the hinges' angles (F, H) rad, ``dof_pos``, ``dof``, ``dofs`` or ``joint_pos``, in the order of the robot's
model, or called by ``joint_names`` or ``dof_names`` (H,). Or they are MuJoCo's ``qpos`` (F, 7 + H), whose quaternion is
wxyz. The rate is ``fps``, ``frequency``, ``frame_rate`` or ``motion_fps``, and must be said. z is up.

The clip is one of angles, as that of :mod:`.angles`. Files with the angles but not the root, and those of Isaac Lab
(``body_pos_w``), which have the hinges in the simulator's own order, are not read.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
import torch

from understudy.errors import FileError
from understudy_motion.clip import ANGLE, Clip
from understudy_motion.limits import check_counts, check_size
from understudy_motion.origin import provenance
from understudy_motion.readers.angles import angle_rotations, in_radians, root_and_angles
from understudy_motion.readers.npz import ZIP_MAGIC, Archive, array_names
from understudy_motion.readers.text import LARGEST
from understudy_motion.reading import UNSAID, ClipReader, ReadOptions, metres_of, no_rate

_NAMES: Mapping[str, tuple[str, ...]] = {
    "position": ("root_pos", "root_trans", "root_trans_offset", "root_position"),
    "quaternion": ("root_rot", "root_quat", "root_orn", "root_orientation"),
    "angles": ("dof_pos", "dof", "dofs", "joint_pos"),
    "rate": ("fps", "frequency", "frame_rate", "motion_fps"),
    "names": ("joint_names", "dof_names"),
}
"""What the arrays are called."""


def _named(what: str, names: Collection[str]) -> str:
    return next((name for name in _NAMES[what] if name in names), "")


class RobotNpzReader(ClipReader):
    """Reads robots' root and angles."""

    fixed = MappingProxyType({"up": "z", "skeleton": None})
    suffixes = (".npz",)

    def recognises(self, head: bytes, path: Path) -> bool:
        if not head.startswith(ZIP_MAGIC):
            return False
        names = array_names(path)
        parts = all(_named(what, names) for what in ("position", "quaternion", "angles"))
        return parts or "qpos" in names

    def read(self, path: Path, options: ReadOptions = UNSAID) -> Clip:
        archive = Archive(path)
        whole = "qpos" in archive.names
        if whole:
            qpos = archive.floats("qpos", None, None)
            check_counts(path, len(qpos), qpos.shape[1] - 6)
            rows = (
                qpos[:, [0, 1, 2, 4, 5, 6, 3, *range(7, qpos.shape[1])]]
                if qpos.shape[1] > 6
                else qpos
            )
        else:
            places = archive.floats(_named("position", archive.names), None, 3)
            turns = archive.floats(_named("quaternion", archive.names), len(places), 4)
            angles = archive.floats(_named("angles", archive.names), len(places), None)
            check_counts(path, len(angles), 1 + angles.shape[1])
            rows = np.concatenate((places, turns, angles), axis=1)
        if rows.shape[1] < 8:
            raise FileError(
                f"Clip {path}: its qpos has {rows.shape[1]} numbers a frame, and a robot's has 7 of its root and more."
            )
        beyond = np.abs(rows).max(axis=1) > LARGEST
        if beyond.any():
            raise FileError(
                f"Clip {path}: frame {int(beyond.argmax())}: a number is beyond {LARGEST:g}, which no robot has."
            )
        names = self._hinges(path, archive, rows.shape[1] - 7)
        joints = ("root", *(f"{ANGLE}{name}" for name in names))
        check_size(path, len(rows), joints)
        unit = options.unit and metres_of(options.unit)
        position, turn, angles = root_and_angles(path, rows, unit, whole)
        unsaid = np.zeros(len(names), bool)
        angles, assumed = in_radians(path, angles, names, options.angles, unsaid)
        rate = options.rate or self._rate(path, archive)
        return Clip(
            name=path.stem,
            times=torch.arange(len(rows), dtype=torch.float64) / rate,
            root_position=torch.from_numpy(position.copy()),
            rotations=angle_rotations(turn, angles),
            joint_names=joints,
            loop=bool(options.loop),
            assumed=assumed,
            **provenance(path, archive.content),
        )

    @staticmethod
    def _hinges(path: Path, archive: Archive, count: int) -> tuple[str, ...]:
        named = _named("names", archive.names)
        names = archive.texts(named) if named else ()
        names = names[1:] if len(names) == count + 1 else names  # the root's own joint is first
        if named and (len(names) != count or len(set(names)) != count):
            raise FileError(
                f"Clip {path}: it has {count} angles, and {len(set(names))} names of them in '{named}'."
            )
        return names or tuple(str(n + 1) for n in range(count))

    @staticmethod
    def _rate(path: Path, archive: Archive) -> float:
        said = _named("rate", archive.names)
        if not said:
            raise FileError(
                f"Clip {path}: it does not say its frame rate; give motion.rate (--source-rate)."
            )
        rate = archive.number(said)
        why = no_rate(rate) if rate > 0.0 else "frames per second are above 0"
        if why:
            raise FileError(
                f"Clip {path}: '{said}' is {rate:g}, and {why}. Or give motion.rate (--source-rate)."
            )
        return rate
