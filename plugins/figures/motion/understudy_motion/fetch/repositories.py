"""Authors' repositories whose clips for DeepMimic's humanoid are known by name: DeepMimic's (Peng et al. 2018), and that of
the athletic jumping paper (Yin et al. 2021)."""

from __future__ import annotations

import re
from dataclasses import dataclass

_RAW, _PAGES = "https://raw.githubusercontent.com", "https://github.com"


@dataclass(frozen=True)
class Repository:
    """A repository of clips, each of them one file, ``NAME.txt``."""

    name: str  #: owner and repository
    version: str  #: branch or commit
    below: str  #: the folder of its clips
    pattern: str  #: of a clip's name
    FOLDER: str  #: below ``motions``, where its clips go
    LICENCE: str
    ATTRIBUTION: str

    @property
    def OFFICIAL(self) -> str:
        """The address of its files."""
        return f"{_RAW}/{self.name}/{self.version}"

    @property
    def PAGE(self) -> str:
        """Where people look its clips up."""
        return f"{_PAGES}/{self.name}/tree/{self.version}/{self.below}"

    def clips(self, text: str) -> list[str]:
        """The clip that `text` names (``humanoid3d_walk``), none if it is no name of this repository."""
        found = re.fullmatch(rf"(?:{self.FOLDER}/)?({self.pattern})", text)
        return [found[1]] if found else []

    def files(self, clip: str) -> tuple[str, ...]:
        """The names of the clip's files."""
        return (f"{clip}.txt",)

    def addresses(self, clip: str, file: str, base: str) -> tuple[str, str]:
        """Where a `file` of the clip may be below `base`: in the repository's folder, or flat."""
        return f"{base}/{self.below}/{file}", f"{base}/{file}"


DEEPMIMIC = Repository(
    "xbpeng/DeepMimic",
    "master",
    "data/motions",
    "humanoid3d_[a-z0-9_]{1,60}",
    FOLDER="deepmimic",
    LICENCE="MIT License, copyright (c) 2018 Xue Bin Peng",
    ATTRIBUTION="Xue Bin Peng, Pieter Abbeel, Sergey Levine, Michiel van de Panne. DeepMimic: Example-guided deep "
    "reinforcement learning of physics-based character skills. ACM Transactions on Graphics 37(4), 2018.",
)
JUMP = Repository(
    "arpspoof/Jump",
    "73b0c3ddf336ad341897d2fb7965c26060b18160",
    "data/motions/beyond",
    "VC5_[A-Za-z0-9_]{1,60}",
    FOLDER="jump",
    LICENCE="MIT License, copyright (c) 2021 arpspoof",
    ATTRIBUTION="Zhiqi Yin, Zeshi Yang, Michiel van de Panne, KangKang Yin. Discovering diverse athletic jumping "
    "strategies. ACM Transactions on Graphics 40(4), 2021.",
)
