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


#: m: lengths of a chair's box, and how far from the floor a detector may see its lower side.
_LENGTHS, _OFF = (0.2, 3.0), 0.2


def _check_chair(box: Box, number: int) -> None:
    """Refuse a chair of no chair's size, or one that does not stand on the floor: its scene is in other units, or has
    its floor elsewhere.

    Raises
    ------
    FileError
        if it is that.
    """
    (least, most), longest = _LENGTHS, max(box.size)
    if not least <= longest <= most:
        raise FileError(
            f"room.chair={number}: this chair is {longest:.3g} m long, and chairs are {least:g} to {most:g} m. Give the "
            "scene's lengths in m."
        )
    low = box.centre[2] - 0.5 * box.size[2]
    if abs(low) > _OFF:
        raise FileError(
            f"room.chair={number}: this chair begins {abs(low):.2f} m {'above' if low > 0 else 'below'} the floor. A "
            "scene has its floor at z = 0, and an object's centre is the middle of its box: correct the scene."
        )


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
        _check_chair(chairs[options.chair], options.chair)
        self.boxes, self.camera = seen_from(scene, chairs[options.chair])
        middle = (0.0, 0.0, chairs[options.chair].centre[2])
        if taken := next((box for box in self.boxes if box.holds(middle)), None):
            raise FileError(
                f"room.chair={options.chair}: the middle of this chair is within a {taken.label or 'box'} of the scene, so nobody can "
                "sit there. Correct the scene, or take another chair."
            )

    def add(self, spec: mujoco.MjSpec) -> None:
        add_boxes(spec, self.boxes)
