"""The config section ``motion``: which clip a task refers to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from understudy.registry import Registry
from understudy_motion import library
from understudy_motion.clip import Clip


@dataclass(frozen=True)
class MotionOptions:
    name: str | None = "walk"  #: a generated clip, or a file's stem in the data folder
    file: str | None = None  #: path of a clip file; wins over ``name``


class Motion:
    """The chosen clip and where it came from."""

    def __init__(self, options: MotionOptions, registry: Registry) -> None:
        generated = {name: registry.find("clip", name) for name in registry.names("clip")}
        self.clip: Clip = library.load(options.name, options.file, generated)

    def provenance(self) -> dict[str, Any]:
        clip = self.clip
        return {
            "clip": clip.name,
            "source": clip.source,
            "licence": clip.licence,
            "sha256": clip.sha256,
            "seconds": round(float(clip.duration), 4),
        }
