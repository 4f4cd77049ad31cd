"""Living space (section 8): a room around the chair, as :mod:`understudy_characters.rooms` reads it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco

from understudy.errors import FileError
from understudy.inputs import Inputs
from understudy.options import check_range
from understudy.setup.registry import Registry
from understudy_characters.rooms import Box, add_boxes, read_room, seen_from
from understudy_characters.surroundings import Surroundings

EXAMPLE = Path(__file__).parent / "room.json"
CHAIR = "chair"
#: Share of a chair's box below its seat, and the range of seats' heights, m.
_SEAT, _SEATS = 0.5, (0.38, 0.55)


def chair_sizes(box: Box) -> dict[str, float]:
    """Options of the section ``chair`` for a chair of this box."""
    length, width, height = box.size
    seat = min(max(_SEAT * height, _SEATS[0]), _SEATS[1])
    sizes = {"seat_height": seat, "width": width, "depth": length, "back": max(height - seat, 0.05)}
    return {name: round(min(max(size, 0.2), 1.4), 3) for name, size in sizes.items()}


@dataclass(frozen=True)
class RoomOptions:
    """Which room, and which of its chairs."""

    file: str | None = None  #: path of a scene; null is the embedded example
    chair: int = 0  #: which of its chairs is sat upon

    def __post_init__(self) -> None:
        check_range(self, "chair", least=0)


class Room(Surroundings):
    """Everything in the room but the chair, as boxes that one runs into.

    "We then align the observed scene with the simulated environment using the detected chair and its
    estimated 3D position and orientation" (section 8).
    """

    def __init__(self, options: RoomOptions, registry: Registry, inputs: Inputs) -> None:
        path = Path(options.file) if options.file else EXAMPLE

        def files() -> list[Path]:
            photo = read_room(path, CHAIR).camera.photo
            return [path] if photo is None else [path, photo]

        scene = read_room(inputs.file(f"room.file={options.file}", files), CHAIR)
        chairs = scene.labelled(CHAIR)
        if options.chair >= len(chairs):
            raise FileError(
                f"room.chair={options.chair}: the scene has {len(chairs)} chairs, from 0."
            )
        self.boxes, self.camera = seen_from(scene, chairs[options.chair])
        middle = (0.0, 0.0, chairs[options.chair].centre[2])
        if taken := next((box for box in self.boxes if box.holds(middle)), None):
            raise FileError(
                f"room.chair={options.chair}: the middle of this chair is within a {taken.label or 'box'} of the scene, so nobody can "
                "sit there. Correct the scene, or take another chair."
            )

    def add(self, spec: mujoco.MjSpec) -> None:
        add_boxes(spec, self.boxes)
