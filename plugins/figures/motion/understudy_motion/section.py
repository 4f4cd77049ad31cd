"""The config section ``motion``: which clip a task refers to."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import torch

from understudy.errors import ConfigError
from understudy.inputs import Inputs
from understudy.options import check_range
from understudy.setup.registry import Registry
from understudy_motion import library
from understudy_motion.clip import Clip
from understudy_motion.editing import close_loop, evenly_spaced, shift
from understudy_motion.keyframes import keyframed
from understudy_motion.reading import AngleUnit, Axis, ReadOptions, Unit

__all__ = ["Floor", "Motion"]

Floor = Literal["lowest", "standing"]


@dataclass(frozen=True)
class MotionOptions:
    name: str | None = "walk"  #: a generated clip, or a file's stem in the data folder
    file: str | None = None  #: path of a clip file; wins over ``name``
    #: Of a generated clip, for example ``{speed: 1.4}``; none changes its defaults.
    parameters: dict[str, Any] = field(default_factory=dict)
    unit: Unit | None = None  #: of a file's lengths, where the file does not say
    up: Axis | None = None  #: a file's vertical axis, where the file does not say
    skeleton: str | None = None  #: path of the ASF of an AMC file; None takes the one beside it
    angles: AngleUnit | None = None  #: of a file's angles, where the file does not say
    loop: bool | None = None  #: whether a file's motion repeats; None takes the file's word
    rate: float | None = None  #: a file's frames per second, where its frames have no times
    #: Seconds on either side of the seam over which a clip's end is led into its beginning, so that it repeats
    #: without a jerk; None leaves both as they are.
    close_loop: float | None = None
    #: What of the figure's motion is put on the floor: its lowest point, or the median of its lowest ones
    #: while something carries it, so that one deep pose does not raise all others.
    floor: Floor = "lowest"
    #: So many poses of the clip, evenly spaced, with straight lines in between; None leaves it as it is.
    keys: int | None = None

    def __post_init__(self) -> None:
        check_range(self, "keys", least=2)
        check_range(self, "close_loop", above=0.0)


#: m from the origin beyond which a clip is brought there: float32, in which worlds are simulated, has steps of 8 µm at 100
#: m, and of 8 mm at 100 km, as deep as feet sink in.
_FAR = 100.0


def _near(clip: Clip) -> Clip:
    """`clip`, moved in the plane so that it begins at the origin where it begins far away, as in a map's coordinates."""
    x, y = clip.root_position[0, :2].tolist()
    if (away := math.hypot(x, y)) <= _FAR:
        return clip
    warnings.warn(
        f"Clip {clip.name} begins {away:.4g} m from the origin; here it begins there, since numbers are coarse so far away.",
        stacklevel=3,
    )
    return shift(clip, torch.tensor([-x, -y, 0.0], dtype=clip.root_position.dtype))


def _closed(clip: Clip, seconds: float, loop: bool | None) -> Clip:
    """`clip`, made to repeat over so many `seconds`; ConfigError if it has not got them, or is said not to `loop`."""
    asked = f"motion.close_loop={seconds:g} is not possible"
    if loop is False:
        raise ConfigError(f"{asked} beside motion.loop=false. Leave one of them out.")
    least, most = clip.duration / (clip.num_frames - 1), 0.5 * clip.duration
    if not least - 1e-9 <= seconds <= most + 1e-9:
        raise ConfigError(
            f"{asked}: the clip {clip.name} lasts {clip.duration:.4g} s, {least:.4g} s a frame. Give between a frame and "
            f"half of the clip: {least:.4g} to {most:.4g}."
        )
    return close_loop(clip, seconds)


class Motion:
    """The chosen clip and where it came from."""

    def __init__(self, options: MotionOptions, registry: Registry, inputs: Inputs) -> None:
        self.floor: Floor = options.floor
        skeleton = None
        if (given := options.skeleton) is not None:
            skeleton = inputs.file(f"motion.skeleton={given}", lambda: [Path(given)])
        reading = ReadOptions(
            options.unit, options.up, skeleton, options.loop, options.rate, options.angles
        )
        name, file = options.name, options.file
        if file is not None or name not in registry.names("clip"):
            asked = f"motion.name={name}" if file is None else f"motion.file={file}"
            file = str(
                inputs.file(asked, lambda: library.files(name, options.file, registry, reading))
            )
        self.clip: Clip = _near(library.load(name, file, registry, options.parameters, reading))
        if options.close_loop is not None:
            self.clip = _closed(evenly_spaced(self.clip), options.close_loop, options.loop)
        if (keys := options.keys) is not None:
            if keys > (most := self.clip.num_frames):
                raise ConfigError(
                    f"motion.keys={keys} is not possible: the clip {self.clip.name} has {most} frames. Give fewer."
                )
            self.clip = keyframed(self.clip, keys)

    def provenance(self) -> dict[str, Any]:
        clip = self.clip
        fetched = {"url": clip.url, "attribution": clip.attribution}
        return {
            "clip": clip.name,
            "source": clip.source,
            "licence": clip.licence,
            "sha256": clip.sha256,
            **{key: text for key, text in fetched.items() if text},
            "seconds": round(float(clip.duration), 4),
        }
