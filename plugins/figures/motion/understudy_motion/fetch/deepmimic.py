"""The clips of DeepMimic (Peng et al. 2018) for its humanoid: their names, addresses and terms.

A clip ``humanoid3d_NAME`` is one file, ``data/motions/humanoid3d_NAME.txt`` of the authors' repository.
"""

from __future__ import annotations

import re

OFFICIAL = "https://raw.githubusercontent.com/xbpeng/DeepMimic/master"
PAGE = "https://github.com/xbpeng/DeepMimic/tree/master/data/motions"  #: where people look its clips up
FOLDER = "deepmimic"
LICENCE = "MIT License, copyright (c) 2018 Xue Bin Peng"
ATTRIBUTION = (
    "Xue Bin Peng, Pieter Abbeel, Sergey Levine, Michiel van de Panne. DeepMimic: Example-guided deep "
    "reinforcement learning of physics-based character skills. ACM Transactions on Graphics 37(4), 2018."
)

_CLIP = re.compile(r"(?:deepmimic/)?(humanoid3d_[a-z0-9_]{1,60})")


def clips(text: str) -> list[str]:
    """The clip that `text` names (``humanoid3d_walk``), none if it is no name of this collection."""
    found = _CLIP.fullmatch(text)
    return [found[1]] if found else []


def files(clip: str) -> tuple[str, ...]:
    """The names of the clip's files."""
    return (f"{clip}.txt",)


def addresses(clip: str, file: str, base: str = OFFICIAL) -> tuple[str, str]:
    """Where a `file` of the clip may be below `base`: in the repository's folder, or flat."""
    return f"{base}/data/motions/{file}", f"{base}/{file}"
