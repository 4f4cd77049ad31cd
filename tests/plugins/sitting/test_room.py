"""Living space: a room around the chair."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from sitting_tasks import build

from understudy.command.cli import main
from understudy.errors import FileError, UnderstudyError
from understudy.inputs import Inputs
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import installed
from understudy_characters.room_drawing import draw
from understudy_characters.rooms import Box, read_room
from understudy_characters.scene import CharacterScene
from understudy_sitting import room_command
from understudy_sitting.room import EXAMPLE, Room, RoomOptions, chair_sizes


def test_a_chairs_box_says_how_large_it_is() -> None:
    sizes = chair_sizes(Box("chair", (0, 0, 0.45), (0.44, 0.5, 0.9), 0.0))
    assert sizes == {"seat_height": 0.45, "width": 0.5, "depth": 0.44, "back": 0.45}


def test_a_run_keeps_the_photo_of_its_room(tmp_path: Path) -> None:
    """Also where the scene's folder is reached through a link."""
    real, linked, kept = (tmp_path / name for name in ("real", "linked", "kept"))
    (real / "photos").mkdir(parents=True)
    Image.new("RGB", (64, 48), (10, 20, 30)).save(real / "photos" / "p.png")
    linked.symlink_to(real)
    (linked / "room.json").write_text(json.dumps({
        "camera": {"position": [0, 0, 1], "look_at": [1, 0, 1], "fov": 50, "photo": "photos/p.png"},
        "objects": [{"label": "chair", "centre": [2, 1, 0.5], "size": [0.5, 0.6, 1]}],
    }))  # fmt: skip
    options = RoomOptions(file=str(linked / "room.json"))
    inputs, registry = Inputs(), installed().registry
    Room(options, registry, inputs)
    inputs.copy(kept)
    shutil.rmtree(real)
    photo = Room(options, registry, inputs).camera.photo
    assert photo is not None
    assert photo.is_relative_to(kept)
    assert Image.open(photo).getpixel((0, 0)) == (10, 20, 30)


def test_a_chair_within_a_wall_is_refused(tmp_path: Path) -> None:
    (tmp_path / "room.json").write_text(json.dumps({
        "camera": {"position": [0, 0, 1], "look_at": [1, 0, 1], "fov": 50},
        "objects": [{"label": "chair", "centre": [2, 1, 0.45], "size": [0.5, 0.5, 0.9], "heading": 0.3},
                    {"label": "wall", "centre": [0, 1, 1.2], "size": [0.1, 6, 2.4], "heading": 1.57},
                    {"label": "chair", "centre": [2, 2, 0.45], "size": [0.5, 0.5, 0.9]}],
    }))  # fmt: skip
    file = str(tmp_path / "room.json")
    with pytest.raises(
        FileError, match=r"room\.chair=0: the middle of this chair is within a wall"
    ):
        Room(RoomOptions(file), installed().registry, Inputs())
    assert len(Room(RoomOptions(file, chair=1), installed().registry, Inputs()).boxes) == 2


def test_the_example_room_is_in_the_way() -> None:
    """Its furniture collides with the figure, and the chair stands free."""
    built = build("experiment=sitting/sit", "num_worlds=2", "+room={}")
    room = built.context.need_section("room", Room, "the test")
    assert len(room.boxes) == len(read_room(EXAMPLE).boxes) - 1
    model = built.environment.parts.simulator.model  # type: ignore[attr-defined]
    geom = model.geom("room_0")
    assert geom.conaffinity[0] & model.geom("root").contype[0]
    for box in room.boxes:
        away = math.hypot(box.centre[0], box.centre[1]) - 0.5 * math.hypot(*box.size[:2])
        assert away > 0.4 or box.label == "wall"
    built.environment.reset()
    assert built.environment.step(built.environment.action).rewards.isfinite().all()


@pytest.mark.usefixtures("fine_films")
def test_shadows_in_the_example_room_have_no_specks() -> None:
    """Dark pixels between bright ones, in rows: the figure and the furniture have a few at their edges."""
    built = build("experiment=sitting/sit", "num_worlds=1", "+room={}")
    room = built.context.need_section("room", Room, "the test")
    assert isinstance(built.scene, CharacterScene)
    built.environment.reset()
    at_the_side = built.environment.table["qpos"].clone().numpy()
    at_the_side[:, :2] = (2.0, 0.5)
    try:
        (frame,) = draw(built.scene, at_the_side, room.camera)
    except UnderstudyError as error:
        pytest.skip(str(error))
    grey = frame.astype(float).mean(axis=2)
    specks = grey[:, 1:-1] + 30 < np.minimum(grey[:, :-2], grey[:, 2:])
    assert int(specks.sum()) < 300


def test_a_room_whose_name_has_an_apostrophe_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the command made of it was an override that nobody could read."""
    scene = tmp_path / "o'brien.json"
    scene.write_bytes(EXAMPLE.read_bytes())
    found: list[str] = []

    def noted(run: str, overrides: list[str]) -> None:
        found.extend(overrides)
        raise FileError("noted")

    monkeypatch.setattr(room_command, "open_skill", noted)
    words = ["sitting/meta", str(tmp_path / "room.mp4"), "--scene", str(scene)]
    assert main(["sitting", "room", *words]) == 2
    words = ["experiment=sitting/whole", "initial_states=sitting/around_chair", *found]
    room = load_experiment(words).sections["room"]
    assert isinstance(room, RoomOptions)
    assert room.file == str(scene)


@pytest.mark.parametrize(
    ("centre", "size", "why"),
    [
        ([0, 0, 450], [500, 500, 900], r"900 m long, and chairs are 0\.2 to 3 m"),
        ([0, 0, 2.45], [0.5, 0.5, 0.9], r"2\.00 m above the floor"),
        ([0, 0, 0], [0.5, 0.5, 0.9], r"0\.45 m below the floor.*middle of its box"),
    ],
)
def test_a_chair_elsewhere_or_of_another_unit_is_refused(
    centre: list[float], size: list[float], why: str, tmp_path: Path
) -> None:
    """It was put on the floor, and cut to a chair's size, without a word."""
    (tmp_path / "room.json").write_text(json.dumps({
        "camera": {"position": [3, 0, 1], "look_at": [1, 0, 1], "fov": 50},
        "objects": [{"label": "chair", "centre": centre, "size": size}],
    }))  # fmt: skip
    with pytest.raises(FileError, match=why):
        Room(RoomOptions(str(tmp_path / "room.json")), installed().registry, Inputs())
