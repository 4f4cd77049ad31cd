"""Writes this product's own formats; :mod:`understudy_motion.readers.table` describes them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from understudy.errors import FileError
from understudy_motion.clip import Clip
from understudy_motion.readers.table import FORMAT, PROVENANCE, QUATERNION, ROOT_POSITION, VERSION
from understudy_motion.writing import ClipWriter, Shape


class NpzWriter(ClipWriter):
    """Writes everything a clip has."""

    suffix = ".npz"

    def write(self, clip: Clip, path: Path, shapes: Sequence[Shape] = ()) -> None:
        arrays = {
            "format": FORMAT,
            "version": VERSION,
            "name": clip.name,
            "loop": clip.loop,
            **{field: getattr(clip, field) for field in PROVENANCE},
            "joint_names": list(clip.joint_names),
            "times": clip.times.numpy(),
            "root_position": clip.root_position.numpy(),
            "rotations": clip.rotations.numpy(),
        }
        if clip.skeleton is not None:
            tips = clip.skeleton.tips
            arrays |= {
                "parents": np.array(clip.skeleton.parents),
                "offsets": clip.skeleton.offsets,
                "tip_joints": np.array(list(tips), dtype=np.str_),
                "tips": np.array(list(tips.values()), dtype=np.float64).reshape(-1, 3),
            }
        with path.open("wb") as file:
            np.savez_compressed(file, **arrays)


class CsvWriter(ClipWriter):
    """Writes a table of named columns, with all digits."""

    suffix = ".csv"

    def write(self, clip: Clip, path: Path, shapes: Sequence[Shape] = ()) -> None:
        for name in clip.joint_names:
            wrong = not name or name != name.strip() or any(c in ',"#' or c < " " for c in name)
            if wrong or name[0] in "=+-@":  # a spreadsheet would compute what a stranger wrote
                raise FileError(
                    f"Clip {clip.source}: joint {name!r} cannot be a column of a table: names there "
                    "have no commas, quotes, hashes, no blanks around them, and none of = + - @ before them."
                )
        columns = ["time", *ROOT_POSITION]
        columns += [f"{name}.{part}" for name in clip.joint_names for part in QUATERNION]
        rows = np.concatenate(
            (
                clip.times.numpy()[:, None],
                clip.root_position.numpy(),
                clip.rotations.numpy().reshape(clip.num_frames, -1),
            ),
            axis=1,
        )
        with path.open("w", encoding="utf-8", newline="\n") as file:
            file.write("# units: s, m; z up, x forward; quaternions wxyz, relative to the parent\n")
            file.write(f"# loop: {str(clip.loop).lower()}\n")
            file.write(f"# licence: {' '.join(clip.licence.split())}\n")
            file.write(",".join(columns) + "\n")
            np.savetxt(file, rows, fmt="%.17g", delimiter=",")
