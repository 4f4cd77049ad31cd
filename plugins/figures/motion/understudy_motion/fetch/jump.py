"""The captured run-ups and jumps of the athletic jumping paper (Yin et al. 2021), for DeepMimic's humanoid.

A clip ``VC5_NAME`` is one file, ``data/motions/beyond/VC5_NAME.txt`` of the authors' repository.
"""

from __future__ import annotations

import re

_COMMIT = "73b0c3ddf336ad341897d2fb7965c26060b18160"
OFFICIAL = f"https://raw.githubusercontent.com/arpspoof/Jump/{_COMMIT}"
#: where people look its clips up
PAGE = f"https://github.com/arpspoof/Jump/tree/{_COMMIT}/data/motions/beyond"
FOLDER = "jump"
LICENCE = "MIT License, copyright (c) 2021 arpspoof"
ATTRIBUTION = (
    "Zhiqi Yin, Zeshi Yang, Michiel van de Panne, KangKang Yin. Discovering diverse athletic jumping "
    "strategies. ACM Transactions on Graphics 40(4), 2021."
)

_CLIP = re.compile(r"(?:jump/)?(VC5_[A-Za-z0-9_]{1,60})")


def clips(text: str) -> list[str]:
    """The clip that `text` names (``VC5_sprint__curves_03``), none if it is no name of this collection."""
    found = _CLIP.fullmatch(text)
    return [found[1]] if found else []


def files(clip: str) -> tuple[str, ...]:
    """The names of the clip's files."""
    return (f"{clip}.txt",)


def addresses(clip: str, file: str, base: str = OFFICIAL) -> tuple[str, str]:
    """Where a `file` of the clip may be below `base`: in the repository's folder, or flat."""
    return f"{base}/data/motions/beyond/{file}", f"{base}/{file}"
