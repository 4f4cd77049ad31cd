"""The poses of a set of clips, whatever their formats, as features; some clips are held out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from understudy import random
from understudy.errors import FileError
from understudy.setup.registry import Registry
from understudy_characters.fitting import worn
from understudy_motion import library
from understudy_motion.clip import Clip
from understudy_motion.mirror import mirrored
from understudy_motion.origin import RECORD_SUFFIX, terms_of
from understudy_motion.reading import ReadOptions, readers
from understudy_pose_vae.features import PoseFeatures


@dataclass(frozen=True)
class PoseSet:
    """Rotations (P, J, 4) and features (P, D), learned from and held out."""

    poses: Tensor
    features: Tensor
    held_out_poses: Tensor
    held_out_features: Tensor
    sources: Mapping[str, Any]


def read_poses(
    named: Sequence[str],
    features: PoseFeatures,
    registry: Registry,
    reading: ReadOptions,
    *,
    mirror: bool,
    held_out: float,
    seed: int,
) -> PoseSet:
    """Every frame of the clips `named`, and their mirror images; which clips are held out, the share
    `held_out` of them but at least one, depends on `seed`. Of a single clip it is its end.

    Raises
    ------
    FileError
        there is no clip of a name, one cannot be read, or it lacks a joint of the character.
    """
    clips = [worn(clip, features.character) for clip in _clips(named, registry, reading)]
    images = [[clip, *([mirrored(clip)] if mirror else [])] for clip in clips]
    poses = [torch.cat([c.rotations[:, 1:] for c in pair]) for pair in images]
    if len(poses) == 1:
        cut = max(2, round(len(poses[0]) * held_out))
        learned, judged = [poses[0][:-cut]], [poses[0][-cut:]]
    else:
        count = max(1, round(len(poses) * held_out))
        order = torch.randperm(len(poses), generator=random.generator(seed, "pose_vae/held_out"))
        kept = set(order[:count].tolist())
        learned = [p for row, p in enumerate(poses) if row not in kept]
        judged = [p for row, p in enumerate(poses) if row in kept]
    if sum(map(len, learned)) < 2:
        raise FileError("job.clips: these clips have too few poses to learn from.")
    train, test = torch.cat(learned).float(), torch.cat(judged).float()
    licences = sorted({clip.licence for clip in clips})
    sources = {
        "poses": {"clips": list(named), "files": len(clips), "licences": licences},
        "clips": terms_of(clips),
    }
    return PoseSet(train, features.of(train), test, features.of(test), sources)


def _clips(named: Sequence[str], registry: Registry, reading: ReadOptions) -> Iterator[Clip]:
    for name in named:
        folder = _folder(name)
        if folder is None:
            try:
                yield library.find(name, registry, reading)
            except FileError as error:
                raise FileError(
                    f"job.clips: {error} Nor is there a folder of this name, here or in $UNDERSTUDY_DATA/motions; "
                    "experiment=pose_vae/generated needs no clips."
                ) from error
            continue
        endings = {s for reader in readers(registry).values() for s in reader.suffixes}
        files = [
            path
            for path in sorted(folder.iterdir())
            if path.suffix in endings
            and not path.stem.endswith("character")
            and not path.name.endswith(RECORD_SUFFIX)
        ]
        if not files:
            raise FileError(f"job.clips: there is no clip in {folder}.")
        for path in files:
            yield library.find(str(path), registry, reading)


def _folder(name: str) -> Path | None:
    """The folder of clips that `name` is the path of, or the name of in the data folder."""
    if Path(name).is_dir():
        return Path(name)
    data = library.data_folder()
    found = data / "motions" / name if data is not None and Path(name).name == name else None
    return found if found is not None and found.is_dir() else None
