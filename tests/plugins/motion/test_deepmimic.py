"""The DeepMimic reader: conventions on a clip written here, and damage of every kind."""

from __future__ import annotations

import copy
import json
import math
import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from understudy.errors import FileError
from understudy.setup.plugins import installed
from understudy_motion import library
from understudy_motion.kinematics import forward_kinematics, tip_positions
from understudy_motion.readers import deepmimic
from understudy_motion.reading import ReadOptions
from understudy_tensors import rotations

HALF = math.sqrt(0.5)
FUZZ = settings(
    max_examples=150,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


def row(duration: float = 0.1, x: float = 0.0, knee: float = -0.5) -> list[Any]:
    """A standing pose turned a quarter left (the file's +y is up), with a bent right knee."""
    one = [1.0, 0.0, 0.0, 0.0]
    turned = [HALF, 0.0, HALF, 0.0]
    right = [*one, knee, *one, *one, 0.3]
    left = [*one, 0.0, *one, *one, 0.0]
    return [duration, x, 0.9, 0.25, *turned, *one, *one, *right, *left]


def document() -> dict[str, Any]:
    return {"Loop": "wrap", "Frames": [row(), row(0.2, 0.1), row(0.0, 0.3)]}


def write(folder: Path, content: object) -> Path:
    path = folder / "clip.txt"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def test_axes_times_and_licence(tmp_path: Path) -> None:
    (tmp_path / "LICENSE").write_text("\n  MIT License \nmore")
    clip = deepmimic.DeepMimicReader().read(write(tmp_path, document()))
    torch.testing.assert_close(clip.times, torch.tensor([0.0, 0.1, 0.3], dtype=torch.float64))
    assert clip.root_position[1].tolist() == [0.1, -0.25, 0.9]
    assert rotations.heading(clip.rotations[0, 0]).item() == pytest.approx(math.pi / 2)
    knee = clip.rotations[0, clip.joint_names.index("right_knee")]
    assert rotations.to_exponential_map(knee).tolist() == pytest.approx([0.0, 0.5, 0.0])
    assert clip.loop
    assert clip.name == "clip"
    assert len(clip.sha256) == 64
    assert clip.licence == "MIT License; see LICENSE beside the clip"


def test_harmless_variations(tmp_path: Path) -> None:
    text = json.dumps(document(), indent=1).replace("\n", "\r\n")
    expected = deepmimic.DeepMimicReader().read(write(tmp_path, document())).rotations
    path = tmp_path / "crlf.txt"
    path.write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert torch.equal(deepmimic.DeepMimicReader().read(path).rotations, expected)
    flipped = document()
    flipped["Frames"][1][4:8] = [-value for value in flipped["Frames"][1][4:8]]
    torch.testing.assert_close(
        deepmimic.DeepMimicReader().read(write(tmp_path, flipped)).rotations, expected
    )


def test_the_figure_is_the_released_humanoid(tmp_path: Path) -> None:
    clip = deepmimic.DeepMimicReader().read(write(tmp_path, document()))
    clip = replace(clip, rotations=torch.tensor([1.0, 0.0, 0.0, 0.0]).expand(3, 13, 4))
    positions, world = forward_kinematics(clip)
    tips = tip_positions(clip, positions, world)
    heights = positions[0, :, 2] - 0.9
    assert heights[clip.joint_names.index("right_ankle")].item() == pytest.approx(-0.832)
    assert heights[clip.joint_names.index("neck")].item() == pytest.approx(0.46)
    assert clip.skeleton is not None
    ends = {name: tips[0, i] - clip.root_position[0] for i, name in enumerate(clip.skeleton.tips)}
    assert ends["neck"][2].item() == pytest.approx(0.74)
    assert ends["left_elbow"].tolist() == pytest.approx([-0.024, 0.183, 0.236 + 0.2435 - 0.534])
    assert ends["right_ankle"].tolist() == pytest.approx([0.13, -0.085, -0.882])


@pytest.mark.parametrize(
    ("content", "is_clip"),
    [
        ({"Loop": "wrap", "Frames": []}, True),
        ({"Frames": [], "Loop": "wrap"}, True),
        ({"Skeleton": {"Joints": []}}, False),
        ({"asset": {}, "nodes": []}, False),
        ([{"Frames": []}], False),
    ],
)
def test_only_its_own_json_is_recognised(tmp_path: Path, content: object, is_clip: bool) -> None:
    path = write(tmp_path, content)
    assert deepmimic.DeepMimicReader().recognises(path.read_bytes(), path) is is_clip


@pytest.mark.parametrize(
    ("said", "given", "loops"),
    [
        (True, None, True),
        ("Wrap", None, True),
        ("NONE", None, False),
        (None, True, True),
        ("?", False, False),
    ],
)
def test_whether_it_loops_may_be_said_in_other_words(
    tmp_path: Path, said: object, given: bool | None, loops: bool
) -> None:
    content = {"Loop": said, **{"Frames": document()["Frames"]}}
    if said is None:
        del content["Loop"]
    clip = deepmimic.DeepMimicReader().read(write(tmp_path, content), ReadOptions(loop=given))
    assert clip.loop is loops


def broken(frame: int, column: int, value: object) -> dict[str, Any]:
    content = document()
    content["Frames"][frame][column] = value
    return content


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "not valid JSON"),
        ("[" * 200_000, "nested too deeply|not valid JSON"),
        ("[]", "no 'Loop' and 'Frames'"),
        ({"Loop": "wrap", "frames": []}, "Did you mean 'frames'"),
        ({"Loop": "sometimes", "Frames": []}, "'Loop' must be"),
        ({"Loop": ["wrap"], "Frames": []}, "'Loop' must be"),
        ({"Frames": [row(), row()]}, "'Loop' must be .* motion.loop"),
        ({"Loop": "none", "Frames": {}}, "not a list"),
        ({"Loop": "none", "Frames": []}, "0 frames"),
        ({"Loop": "none", "Frames": [row()]}, "1 frames"),
        ({"Loop": "none", "Frames": [row(), row()[:-1]]}, "frame 1: .* not 43 numbers"),
        ({"Loop": "none", "Frames": [row(), 3]}, "frame 1: .* not int"),
        (broken(1, 17, "1.0"), "frame 1: right_hip quaternion x is not a number"),
        (broken(1, 20, True), "frame 1: right_knee angle is not a number"),
        (broken(1, 20, None), "right_knee angle is not a number"),
        (broken(1, 20, [0.0]), "right_knee angle is not a number"),
        (broken(1, 20, math.nan), "NaN is not a number"),
        (broken(1, 20, -math.inf), "-Infinity is not a number"),
        (json.dumps(document()).replace("0.25", "1e999"), "frame 0: root position z is not finite"),
        (broken(1, 2, 10**400), "too large"),
        (json.dumps(document()).replace("0.25", "9" * 5000), "not valid JSON"),
        (broken(1, 1, 1e300), "frame 1: root position is more than"),
        (broken(1, 0, 0.0), "frame 1: duration is 0 s"),
        (broken(0, 0, -0.1), "frame 0: duration"),
        (broken(1, 0, 1e-300), "frame 2: time does not increase"),
        (broken(2, 8, 7.0), "frame 2: chest quaternion is not unit"),
        (broken(1, 8, 0.0), "frame 1: chest quaternion is not unit"),
    ],
)
def test_damage_is_named(tmp_path: Path, content: object, message: str) -> None:
    path = write(tmp_path, content)
    with pytest.raises(FileError, match=message) as caught:
        deepmimic.DeepMimicReader().read(path)
    assert str(path) in str(caught.value)


def test_what_is_not_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for path in (tmp_path, tmp_path / "absent.txt", Path("a\0b")):
        with pytest.raises(FileError):
            deepmimic.DeepMimicReader().read(path)
    binary = tmp_path / "binary.txt"
    binary.write_bytes(bytes(range(256)))
    with pytest.raises(FileError, match="not valid JSON"):
        deepmimic.DeepMimicReader().read(binary)
    monkeypatch.setattr(deepmimic, "MAX_BYTES", 100)
    with pytest.raises(FileError, match="larger than"):
        deepmimic.DeepMimicReader().read(write(tmp_path, document()))


@FUZZ
@given(data=st.data())
def test_damaged_text_never_raises_anything_else(tmp_path: Path, data: st.DataObject) -> None:
    content = bytearray(json.dumps(document()).encode())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        piece = data.draw(st.sampled_from([b"", b"-", b"9", b"e", b"[", b"]", b",", b"\xff", b'"']))
        content[at : at + data.draw(st.integers(0, 30))] = piece
    path = tmp_path / "fuzz.txt"
    path.write_bytes(bytes(content))
    try:
        clip = deepmimic.DeepMimicReader().read(path)
    except FileError:
        return
    assert clip.rotations.isfinite().all()
    assert clip.duration > 0


JSON_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=5,
)


@FUZZ
@given(frame=st.integers(0, 2), column=st.integers(0, 43), value=JSON_VALUES)
def test_damaged_values_never_raise_anything_else(
    tmp_path: Path, frame: int, column: int, value: object
) -> None:
    content = copy.deepcopy(document())
    content["Frames"][frame][column] = value
    try:
        clip = deepmimic.DeepMimicReader().read(write(tmp_path, content))
    except FileError:
        return
    assert clip.rotations.isfinite().all()


def real_clips() -> list[Path]:
    folder = library.data_folder()
    found = sorted(folder.glob("motions/*/*.txt")) if folder else []
    return [path for path in found if not path.stem.endswith("character")]


@pytest.mark.skipif(
    not real_clips(), reason="no recorded clips: UNDERSTUDY_DATA is not set and ../shared is absent"
)
def test_every_recorded_clip_loads(monkeypatch: pytest.MonkeyPatch) -> None:
    for path in real_clips():
        clip = deepmimic.DeepMimicReader().read(path)
        assert 0.3 < clip.duration < 60.0, path
        assert 10.0 < clip.frame_rate < 130.0, path
        assert 0.0 < clip.root_position[:, 2].median() < 2.0, path
    monkeypatch.setenv("UNDERSTUDY_DATA", os.fspath(real_clips()[0].parents[2]))
    assert library.load(real_clips()[0].stem, None, installed().registry).source == str(
        real_clips()[0]
    )


def test_a_million_frames_are_refused_at_once(tmp_path: Path) -> None:
    path = tmp_path / "long.txt"
    frame = json.dumps(row(), separators=(",", ":"))
    path.write_text('{"Loop":"none","Frames":[' + ",".join([frame] * 10**6) + "]}")
    began = time.process_time()
    with pytest.raises(FileError, match=r"long\.txt: larger than"):
        deepmimic.DeepMimicReader().read(path)
    path.write_text('{"Loop":"none","Frames":[' + ",".join(["[]"] * 10**6) + "]}")
    with pytest.raises(FileError, match="1000000 frames; a clip has from 2 to"):
        deepmimic.DeepMimicReader().read(path)
    assert time.process_time() - began < 5.0


def test_the_largest_allowed_file_loads_in_seconds(tmp_path: Path) -> None:
    short = [1, 0, 1, 0]
    for _, width in deepmimic.JOINTS:
        short += [1, 0, 0, 0] if width == 4 else [0]
    frame = json.dumps(short, separators=(",", ":"))
    frames = min(deepmimic.MAX_FRAMES, deepmimic.MAX_BYTES // (len(frame) + 1) - 1)
    path = tmp_path / "long.txt"
    path.write_text('{"Loop":"none","Frames":[' + ",".join([frame] * frames) + "]}")
    began = time.perf_counter()
    assert deepmimic.DeepMimicReader().read(path).num_frames == frames
    assert time.perf_counter() - began < 20.0
