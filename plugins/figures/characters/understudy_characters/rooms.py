"""Rooms: furniture and walls that a detector found, as boxes, and the camera that saw them.

A scene is a JSON file::

    {"camera": {"position": [x, y, z], "look_at": [x, y, z], "fov": degrees,
                "photo": "room.png", "size": [width, height]},
     "objects": [{"label": "chair", "centre": [x, y, z], "size": [length, width, height],
                  "heading": rad}, ...]}

in metres, z up, the floor at 0; an object's ``size`` runs along its own x, y and z, and x is where it
faces. In place of ``look_at`` and ``fov`` a detector's ``rotation`` (3 x 3, from the camera's frame, x right,
y down, z ahead, to the world's) and ``intrinsics`` (3 x 3, pixels) may be given.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from understudy.errors import FileError
from understudy.folders import read
from understudy_characters.staging import make_solid

__all__ = ["Box", "Camera", "RoomScene", "add_boxes", "read_room", "seen_from"]

#: Objects that a scene may have; a detector reports some dozens.
MOST = 64
#: By which detectors name an object's direction; without its heading it would face along x.
_OTHER_HEADINGS = {"angle", "orientation", "quaternion", "rotation", "theta", "yaw"}
_TURN = 6.3  #: rad, the most that a heading is
_LARGEST = 1 << 24  #: bytes of its file
_COLOURS = {
    "wall": (0.86, 0.84, 0.8, 1.0),
    "table": (0.6, 0.45, 0.32, 1.0),
    "chair": (0.72, 0.52, 0.34, 1.0),
    "sofa": (0.45, 0.5, 0.6, 1.0),
}
_OTHER = (0.62, 0.64, 0.6, 1.0)


@dataclass(frozen=True)
class Box:
    """An oriented box on its own heading, m and rad, in the frame of the scene."""

    label: str
    centre: tuple[float, float, float]
    size: tuple[float, float, float]
    heading: float

    def holds(self, point: tuple[float, float, float]) -> bool:
        """Whether a `point` of the scene is within the box."""
        x, y, z = (p - c for p, c in zip(point, self.centre, strict=True))
        cosine, sine = math.cos(self.heading), math.sin(self.heading)
        own = (cosine * x + sine * y, cosine * y - sine * x, z)
        return all(2 * abs(a) < size for a, size in zip(own, self.size, strict=True))


@dataclass(frozen=True)
class Camera:
    """A pinhole camera: position (3,) m, rotation (3, 3) from its frame (x right, y down, z ahead) to the scene's, focal
    lengths and centre in pixels."""

    position: np.ndarray
    rotation: np.ndarray
    focal: tuple[float, float]
    centre: tuple[float, float]
    size: tuple[int, int]  #: width, height
    photo: Path | None


@dataclass(frozen=True)
class RoomScene:
    """What was seen, in the frame in which it was measured."""

    boxes: tuple[Box, ...]
    camera: Camera

    def labelled(self, label: str) -> tuple[Box, ...]:
        """The objects of this label, in the order of the file."""
        return tuple(box for box in self.boxes if box.label == label)


def read_room(path: Path, needs: str | None = None) -> RoomScene:
    """The scene of a file.

    Parameters
    ----------
    path
        of the JSON file; a photo lies in its folder or below
    needs
        a label of which there must be an object

    Raises
    ------
    FileError
        if it is missing, no such JSON, lacks what is needed, or has numbers that are none.
    """
    try:
        data = json.loads(read(path, _LARGEST))
        boxes = tuple(_box(item) for item in data["objects"])
        camera = _camera(data["camera"], path.parent)
    except (
        OSError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError
    ) as error:  # fmt: skip
        reason = f"{error.args[0]} is missing" if isinstance(error, KeyError) else str(error)
        raise FileError(f"{path} is no scene of boxes with a camera: {reason}.") from error
    if not 0 < len(boxes) <= MOST:
        raise FileError(f"{path} has {len(boxes)} objects; a scene has 1 to {MOST}.")
    scene = RoomScene(boxes, camera)
    if needs is not None and not scene.labelled(needs):
        raise FileError(f"{path} has no object with the label {needs}.")
    return scene


def _numbers(value: Any, count: int) -> tuple[float, ...]:
    found = tuple(float(number) for number in value)
    if len(found) != count or not all(math.isfinite(n) and abs(n) < 1e4 for n in found):
        raise ValueError(f"{value} is not {count} numbers")
    return found


def _box(item: Mapping[str, Any]) -> Box:
    centre, size = _numbers(item["centre"], 3), _numbers(item["size"], 3)
    if min(size) <= 0:
        raise ValueError(f"size {list(size)} is not positive")
    unread = sorted(_OTHER_HEADINGS & item.keys())
    if "heading" not in item and unread:
        raise ValueError(f"{unread[0]} is not read: give an object's heading, in rad about z")
    (heading,) = _numbers([item.get("heading", 0.0)], 1)
    if abs(heading) > _TURN:
        raise ValueError(f"heading {heading:g} is more than a turn: give it in rad")
    return Box(str(item["label"]), centre, size, heading)  # type: ignore[arg-type]


def _camera(item: Mapping[str, Any], folder: Path) -> Camera:
    position = np.array(_numbers(item["position"], 3))
    width, height = (int(n) for n in _numbers(item.get("size", (960, 540)), 2))
    if not (16 <= width <= 4096 and 16 <= height <= 4096):
        raise ValueError(f"a picture of {width} x {height} pixels is not possible")
    if "rotation" in item:
        rotation, inside = _matrix(item, "rotation"), _matrix(item, "intrinsics")
        turned = np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-3
        if not turned or np.linalg.det(rotation) < 0:
            raise ValueError("rotation is no rotation")
        focal, centre = (inside[0, 0], inside[1, 1]), (inside[0, 2], inside[1, 2])
    else:
        rotation = _looking(np.array(_numbers(item["look_at"], 3)) - position)
        (fov,) = _numbers([item["fov"]], 1)
        if not 1e-3 <= fov < 180:  # less is no angle to compute with
            raise ValueError(f"fov {fov:g} is not between 0 and 180 degrees")
        length = 0.5 * height / math.tan(math.radians(fov) / 2)
        focal, centre = (length, length), (0.5 * width, 0.5 * height)
    if not all(1e-3 <= length <= 1e6 for length in focal):
        raise ValueError(f"a focal length of {min(focal):g} pixels is not possible")
    photo = _photo(item["photo"], folder) if item.get("photo") is not None else None
    return Camera(position, rotation, focal, centre, (width, height), photo)


def _matrix(item: Mapping[str, Any], name: str) -> np.ndarray:
    rows = [_numbers(row, 3) for row in item[name]]
    if len(rows) != 3:
        raise ValueError(f"{name} has {len(rows)} rows in place of 3")
    return np.array(rows)


def _looking(ahead: np.ndarray) -> np.ndarray:
    """The rotation of a camera that looks `ahead`, level."""
    distance = np.linalg.norm(ahead)
    if distance < 1e-6:
        raise ValueError("the camera looks at itself: look_at is its position")
    ahead = ahead / distance
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) < 1e-6:  # straight up or down: y is the picture's top
        right = np.cross(ahead, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(ahead, right), ahead], axis=1)


def _photo(name: Any, folder: Path) -> Path:
    """Below `folder` as it is named, so that a copy of the folder's files is found, too."""
    path, below = folder / str(name), Path(str(name))
    inside = not below.is_absolute() and ".." not in below.parts
    if not inside or not path.resolve().is_relative_to(folder.resolve()) or not path.is_file():
        raise ValueError(f"the photo {name} is not in the scene's folder")
    return path


def seen_from(scene: RoomScene, origin: Box) -> tuple[list[Box], Camera]:
    """All other boxes and the camera in the frame of `origin`, which is on the floor below it, with x where it faces."""
    cosine, sine = math.cos(-origin.heading), math.sin(-origin.heading)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    floor = np.array([origin.centre[0], origin.centre[1], 0.0])

    def placed(box: Box) -> Box:
        x, y, z = (turn @ (np.array(box.centre) - floor)).tolist()
        return Box(box.label, (x, y, z), box.size, box.heading - origin.heading)

    camera = scene.camera
    moved = Camera(
        turn @ (camera.position - floor), turn @ camera.rotation,
        camera.focal, camera.centre, camera.size, camera.photo,
    )  # fmt: skip
    return [placed(box) for box in scene.boxes if box is not origin], moved


def add_boxes(spec: mujoco.MjSpec, boxes: Iterable[Box]) -> None:
    """Add boxes that a figure runs into, as ``room_0`` and so on."""
    for number, box in enumerate(boxes):
        geom = spec.worldbody.add_geom(
            name=f"room_{number}", type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[0.5 * length for length in box.size], pos=box.centre,
            quat=[math.cos(box.heading / 2), 0, 0, math.sin(box.heading / 2)],
            rgba=_COLOURS.get(box.label, _OTHER),
        )  # fmt: skip
        make_solid(geom)
        geom.condim = 3
