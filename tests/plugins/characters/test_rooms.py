"""Scenes of boxes with a camera: what is read, what is refused, and what the camera sees."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from understudy.errors import FileError
from understudy_characters.room_drawing import add_camera
from understudy_characters.rooms import Camera, read_room, seen_from

CHAIR = {
    "label": "chair",
    "centre": [2.0, 1.0, 0.5],
    "size": [0.5, 0.6, 1.0],
    "heading": math.pi / 2,
}
#: Cameras: one that looks along x, and one as a detector reports it.
AHEAD = {"position": [0, 0, 1], "look_at": [1, 0, 1], "fov": 50}
DETECTED = {
    "position": [0, 0, 1],
    "rotation": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    "intrinsics": [[50, 0, 32], [0, 55, 24], [0, 0, 1]],
}
TABLE = {"label": "table", "centre": [2.0, 2.5, 0.4], "size": [1.0, 0.5, 0.8], "heading": 0.0}


def scene(folder: Path, **changes: Any) -> Path:
    camera = {"position": [2.0, 4.0, 1.5], "look_at": [2.0, 1.0, 0.5], "fov": 60, "size": [64, 48]}
    path = folder / "room.json"
    path.write_text(json.dumps({"camera": camera, "objects": [CHAIR, TABLE], **changes}))
    return path


def test_an_object_becomes_the_origin(tmp_path: Path) -> None:
    """The chair faces +y, where the table stands 1.5 m away: in its frame that is ahead, along x."""
    seen = read_room(scene(tmp_path), "chair")
    boxes, camera = seen_from(seen, seen.labelled("chair")[0])
    (table,) = boxes
    assert table.centre == pytest.approx((1.5, 0.0, 0.4))
    assert table.heading == pytest.approx(-math.pi / 2)
    assert camera.position == pytest.approx([3.0, 0.0, 1.5])
    ahead = camera.rotation[:, 2]
    assert ahead == pytest.approx(np.array([-3.0, 0.0, -1.0]) / math.sqrt(10))
    assert np.linalg.det(camera.rotation) == pytest.approx(1.0)
    assert camera.focal[1] == pytest.approx(24 / math.tan(math.radians(30)))


def test_a_detectors_camera_is_taken_as_it_is(tmp_path: Path) -> None:
    turn = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]  # looks along +y
    camera = {
        "position": [0, 0, 1],
        "rotation": turn,
        "intrinsics": [[50, 0, 32], [0, 55, 24], [0, 0, 1]],
    }
    found = read_room(scene(tmp_path, camera={**camera, "size": [64, 48]})).camera
    assert (found.focal, found.centre) == ((50, 55), (32, 24))
    bent = [[1, 0, 0], [0, 0, 1], [0, -1, 0.5]]
    with pytest.raises(FileError, match="rotation is no rotation"):
        read_room(scene(tmp_path, camera={**camera, "rotation": bent}))


def test_a_detectors_camera_sees_in_the_right_pixel() -> None:
    """A ball 0.5 m to the right of it, 0.4 m below and 3 m ahead."""
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # x right, y down, z along +y
    camera = Camera(np.zeros(3), turn, (300.0, 280.0), (180.0, 140.0), (320, 240), None)
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.05] * 3, pos=[0.5, 3, -0.4])
    add_camera(spec, camera)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    renderer = mujoco.Renderer(model, 240, 320)
    renderer.update_scene(data, "photo")
    renderer.enable_segmentation_rendering()
    rows, columns = np.nonzero(renderer.render()[..., 0] == 0)
    renderer.close()
    assert columns.mean() + 0.5 == pytest.approx(300 * 0.5 / 3 + 180, abs=0.5)
    assert rows.mean() + 0.5 == pytest.approx(280 * 0.4 / 3 + 140, abs=0.5)


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"objects": []}, "0 objects"),
        ({"objects": [TABLE]}, "no object with the label chair"),
        ({"objects": [{**CHAIR, "size": [1, 1]}]}, "is not 3 numbers"),
        ({"objects": [{**CHAIR, "size": [1, 1, -1]}]}, "is not positive"),
        ({"objects": [{**CHAIR, "centre": [0, 0, math.nan]}]}, "is not 3 numbers"),
        ({"objects": [{**CHAIR, "centre": [10**400, 0, 0]}]}, "too large"),
        ({"camera": {"look_at": [0, 0, 0]}}, "position is missing"),
        ({"camera": {**AHEAD, "photo": "../x.png"}}, "not in the scene's folder"),
        ({"camera": {**AHEAD, "look_at": AHEAD["position"]}}, "looks at itself"),
        *(({"camera": {**AHEAD, "fov": fov}}, "is not between 0 and 180 degrees")
          for fov in (0, 180, -50, 360, 1e-320)),
        ({"camera": {**DETECTED, "intrinsics": [[50, 0, 32]]}}, "intrinsics has 1 rows in place of 3"),
        ({"camera": {**DETECTED, "intrinsics": [[0, 0, 32], [0, 55, 24], [0, 0, 1]]}},
         "a focal length of 0 pixels"),
        ({"camera": {**DETECTED, "rotation": [[1, 0, 0]]}}, "rotation has 1 rows"),
        ({"camera": {**DETECTED, "rotation": [[1, 0, 0], [0, 0, 1], [0, 1, 0]]}},
         "rotation is no rotation"),
    ],
)  # fmt: skip
def test_what_is_no_scene_is_refused(tmp_path: Path, changes: dict[str, Any], why: str) -> None:
    with pytest.raises(FileError, match=why):
        read_room(scene(tmp_path, **changes), "chair")


def test_a_scene_without_end_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "room.json"
    path.write_text("[" * 100_000)
    with pytest.raises(FileError, match="is no scene of boxes with a camera"):
        read_room(path)


@pytest.mark.timeout(20)
def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "room.json")
    with pytest.raises(FileError, match="it is no file"):
        read_room(tmp_path / "room.json")


@pytest.mark.parametrize("above", [3.0, -3.0])
def test_a_camera_may_look_straight_down_or_up(tmp_path: Path, above: float) -> None:
    camera = {"position": [0, 0, above], "look_at": [0, 0, 0], "fov": 60}
    rotation = read_room(scene(tmp_path, camera=camera)).camera.rotation
    assert rotation[:, 2] == pytest.approx([0, 0, -math.copysign(1, above)])
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("chair", "why"),
    [
        ({**CHAIR, "heading": 90.0}, "heading 90 is more than a turn: give it in rad"),
        (
            {**{k: v for k, v in CHAIR.items() if k != "heading"}, "yaw": 1.57},
            "yaw is not read: give an object's heading, in rad",
        ),
    ],
)
def test_a_heading_by_another_unit_or_name_is_refused(
    chair: dict[str, Any], why: str, tmp_path: Path
) -> None:
    """The object would face elsewhere without a word."""
    with pytest.raises(FileError, match=why):
        read_room(scene(tmp_path, objects=[chair]))


def test_beside_a_heading_a_detector_may_say_more(tmp_path: Path) -> None:
    (box,) = read_room(scene(tmp_path, objects=[{**CHAIR, "score": 0.9, "yaw": 1.57}])).boxes
    assert box.heading == pytest.approx(math.pi / 2)
