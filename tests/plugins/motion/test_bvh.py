"""BVH: the reader's conventions by hand and against scipy, what it recognises, and round trips."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from motion_files import walker, write_bvh
from scipy.spatial.transform import Rotation

from understudy.errors import ConfigError, FileError
from understudy.setup.plugins import installed
from understudy_motion import library
from understudy_motion.clip import Clip, Skeleton
from understudy_motion.readers.bvh import BvhReader
from understudy_motion.reading import AngleUnit, Axis, ReadOptions, Unit
from understudy_motion.writers.bvh import BvhWriter
from understudy_tensors import rotations

TO_WORLD = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])  # (x, y, z) -> (z, x, y)
CASES = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
WRITTEN = ReadOptions(unit="cm", up="y")

TEXT = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Left Leg
  {
    OFFSET 10 -5 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 -80 5
    }
  }
  JOINT Head
  {
    OFFSET 0 60 0
    CHANNELS 1 Yrotation
    End Site
    {
      OFFSET 0 20 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.025
1 90 3  0 0 0  10 20 30  40
1 90 13  0 90 0  -10 -20 -30  50
"""


def read(folder: Path, text: str, unit: Unit | None = None, up: Axis | None = None) -> Clip:
    path = folder / "clip.bvh"
    path.write_text(text, newline="")
    return BvhReader().read(path, ReadOptions(unit=unit, up=up))


def test_conventions(tmp_path: Path) -> None:
    clip = read(tmp_path, TEXT)
    assert clip.joint_names == ("Hips", "Left Leg", "Head")
    assert clip.times.tolist() == pytest.approx([0.0, 0.025])
    assert clip.root_position[1].tolist() == pytest.approx([0.13, 0.01, 0.9])
    assert clip.skeleton is not None
    assert clip.skeleton.parents == (-1, 0, 0)
    assert clip.skeleton.offsets[1].tolist() == pytest.approx([0.0, 0.1, -0.05])
    assert clip.skeleton.tips["Left Leg"].tolist() == pytest.approx([0.05, 0.0, -0.8])
    # A quarter turn about the file's x is one about our y.
    turn = rotations.to_exponential_map(clip.rotations[1, 0])
    assert turn.tolist() == pytest.approx([0.0, np.pi / 2, 0.0])
    assert rotations.to_exponential_map(clip.rotations[0, 2]).tolist() == pytest.approx(
        [0.0, 0.0, np.radians(40.0)]
    )
    assert not clip.loop


@pytest.mark.parametrize("order", ["".join(p) for p in permutations("XYZ")])
def test_any_order_of_channels(tmp_path: Path, order: str) -> None:
    """Upper-case letters in scipy are turns about the turning axes, the last applied first."""
    names = " ".join(f"{axis}rotation" for axis in order)
    text = TEXT.replace("CHANNELS 3 Zrotation Xrotation Yrotation", f"CHANNELS 3 {names}")
    clip = read(tmp_path, text)
    expected = Rotation.from_euler(order, [10, 20, 30], degrees=True).as_matrix()
    ours = rotations.to_matrix(clip.rotations[0, 1]).numpy()
    np.testing.assert_allclose(ours, TO_WORLD @ expected @ TO_WORLD.T, atol=1e-12)


def test_positions_may_follow_rotations_and_be_incomplete(tmp_path: Path) -> None:
    text = TEXT.replace("OFFSET 0 0 0", "OFFSET 7 0 0", 1).replace(
        "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation",
        "CHANNELS 5 Zrotation Xrotation Yrotation Yposition Zposition",
    )
    text = text.replace("1 90 3  0 0 0", "0 0 0 90 3").replace("1 90 13  0 90 0", "0 90 0 90 13")
    clip = read(tmp_path, text)
    assert clip.root_position[1].tolist() == pytest.approx([0.13, 0.07, 0.9])
    torch.testing.assert_close(clip.rotations, read(tmp_path, TEXT).rotations)


def test_white_space_does_not_matter(tmp_path: Path) -> None:
    expected = read(tmp_path, TEXT)
    for text in (
        TEXT.replace("\n", "\r\n"),
        TEXT.replace("  ", "\t\t "),
        TEXT.replace("\n  {", " {").replace("}\n", "}\n\n") + "\n\n",
        TEXT.lower()
        .replace("hips", "Hips")
        .replace("left leg", "Left  Leg")
        .replace("head", "Head"),
        "\ufeff" + TEXT,
    ):
        clip = read(tmp_path, text)
        assert clip.joint_names == expected.joint_names
        assert torch.equal(clip.rotations, expected.rotations)
        assert torch.equal(clip.root_position, expected.root_position)


def test_position_channels_of_joints(tmp_path: Path) -> None:
    moving = TEXT.replace(
        "CHANNELS 3 Zrotation Xrotation Yrotation",
        "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation",
    )
    still = moving.replace("  10 20", "  10 -5 0.05 10 20").replace(
        "  -10 -20", "  10 -5 0 -10 -20"
    )
    torch.testing.assert_close(
        read(tmp_path, still).rotations, read(tmp_path, TEXT).rotations, rtol=0, atol=0
    )
    with pytest.raises(FileError, match="frame 0: joint 'Left Leg' moves against its parent"):
        read(tmp_path, still.replace(" 10 -5 0.05 ", " 10 -6 0 "))


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize(
    ("unit", "per_metre"), [("m", 1), ("cm", 100), ("mm", 1000), ("inch", 39.37)]
)
def test_unit_and_vertical_axis_are_recognised(
    tmp_path: Path, unit: Unit, per_metre: float, up: Axis
) -> None:
    clip = scaled(tmp_path, per_metre, up)
    assert clip.root_position[0, 2] == pytest.approx(0.9, rel=1e-3)
    assert clip.skeleton is not None
    assert clip.skeleton.tips["chest"].tolist() == pytest.approx([0.0, 0.0, 0.55], rel=1e-3)


def scaled(folder: Path, per_metre: float, up: Axis) -> Clip:
    """The walking figure in another unit; with z up, its x and y are those of the file."""
    rows = []
    for line in write_bvh(folder).read_text().splitlines():
        words = line.split()
        if words and words[0] == "OFFSET":
            x, y, z = (float(word) * per_metre / 100.0 for word in words[1:])
            line = f"OFFSET {x} {y} {z}" if up == "y" else f"OFFSET {z} {x} {y}"
        elif words and words[0][0] in "-0123456789":
            x, y, z = (float(word) * per_metre / 100.0 for word in words[:3])
            place = f"{x} {y} {z}" if up == "y" else f"{z} {x} {y}"
            line = " ".join((place, *words[3:]))
        elif up == "z":
            line = line.replace("Zrot", "?rot").replace("Yrot", "Zrot").replace("Xrot", "Yrot")
            line = line.replace("?rot", "Xrot")
        rows.append(line)
    return read(folder, "\n".join(rows))


def test_bones_laid_out_along_x_are_recognised_by_the_first_frame(tmp_path: Path) -> None:
    """Some files' own pose is a star of bones along x; only the motion makes the figure stand."""
    text = TEXT.replace("OFFSET 0 60 0", "OFFSET 60 0 0").replace("OFFSET 0 20 0", "OFFSET 20 0 0")
    text = text.replace("OFFSET 0 -80 5", "OFFSET -80 0 0").replace(
        "OFFSET 10 -5 0", "OFFSET -5 8 9"
    )
    text = text.replace("CHANNELS 1 Y", "CHANNELS 1 Z")
    text = text.replace("0 0 0  10 20 30  40", "90 0 0  0 0 0  0")
    clip = read(tmp_path, text)
    assert clip.root_position[0].tolist() == pytest.approx([0.03, 0.01, 0.9])


def test_what_is_not_plain_is_asked_for(tmp_path: Path) -> None:
    flat = TEXT.replace("OFFSET 0 60 0", "OFFSET 0 60 60").replace("-80 5", "-80 -80")
    with pytest.raises(FileError, match=r"which axis is vertical.*motion\.up=y or z \(--up\)"):
        read(tmp_path, flat)
    with pytest.raises(
        FileError, match=r"unit of length.*motion\.unit, one of m, cm, .*\(--unit\)"
    ):
        read(tmp_path, TEXT.replace("OFFSET 0 -80 5", "OFFSET 0 -9000 5"))
    assert read(tmp_path, flat, up="y").root_position[0, 2] == pytest.approx(0.9)
    assert read(tmp_path, TEXT, unit="inch").root_position[0, 2] == pytest.approx(90 * 0.0254)
    assert read(tmp_path, TEXT, unit="m", up="z").root_position[0].tolist() == [1.0, 90.0, 3.0]
    path = tmp_path / "clip.bvh"
    assert BvhReader().read(path, ReadOptions(rate=50.0, loop=True)).duration == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("Frames: 2", "Frames: 3", "line 26: 3 frames are announced, but 2 lines"),
        ("Frames: 2\n", "Frames: 1\n", "1 frames are announced, but 2 lines"),
        (
            TEXT.partition("MOTION")[2],
            "\nFrames: 0\nFrame Time: 0.025\n",
            "no frame follows MOTION",
        ),
        ("Frames: 2", "Frames: 999999999", "are announced, but 2 lines"),
        ("Frames: 2", "Frames: 1000000000", "1000000000 frames are announced, but 2 lines"),
        ("Frames: 2", "Frames: -6", "after MOTION, and 'Frames' is '-6'"),
        ("Frames: 2", "Frames: two", "'Frames: <count>' and 'Frame Time: <seconds>'"),
        ("Frame Time: 0.025\n", "", "'Frame Time: <seconds>'"),
        ("0.025", "0", "'Frame Time' must be seconds above 0"),
        ("0.025", "-0.025", "'Frame Time' must be seconds above 0 and up to 1, not '-0.025'"),
        ("0.025", "nan", "'Frame Time' must be seconds above 0"),
        ("-30  50", "-30", "line 29: 10 numbers are needed, not 9"),
        ("-30  50", "-30  x50", "line 29: 'x50' is not a number"),
        ("-30  50", "-30  nan", "line 29: 'nan' is not a number"),
        ("1 90 13", "1 9e9 13", "frame 1: root position is more than"),
        ("OFFSET 0 60 0", "OFFSET 0 60", "line 18: OFFSET needs three numbers, not 'CHANNELS'"),
        ("    OFFSET 0 60 0\n", "", "joint 'Head' has no OFFSET"),
        (
            "    OFFSET 0 60 0\n",
            "    OFFSET 0 60 0\n    OFFSET 0 6 0\n",
            "joint 'Head' has two OFFSETs",
        ),
        (
            "CHANNELS 1 Yrotation",
            "CHANNELS 1 Yrotation CHANNELS 1 Yrotation",
            "joint 'Head' has two CHANNELS",
        ),
        ("JOINT Head", "ROOT Head", "line 15: one ROOT is expected"),
        ("JOINT Head", "JOINT", "line 16: a joint has no name"),
        ("JOINT Head", "BONE Head", "line 15: 'BONE' is not part of a joint"),
        ("CHANNELS 1", "CHANNELS 12", "from 0 to 9 CHANNELS, not '12'"),
        ("0.025", "25", "'Frame Time' must be seconds above 0 and up to 1"),
        ("Frame Time: 0.025", "FPS: 0", "'Frame Time' must be seconds above 0"),
        ("CHANNELS 1 Yrotation", "CHANNELS 1 Xscale", "joint 'Head' changes its size"),
        ("CHANNELS 1 Yrotation", "CHANNELS 1 Wrotation", "'wrotation' is not a channel"),
        ("}\nMOTION", "MOTION", "line 24: MOTION comes before the hierarchy is complete"),
        ("}\nMOTION", "}\n}\nMOTION", "'}' stands outside of any joint"),
        ("MOTION", "", "'FRAMES' stands outside of any joint"),
        ("\n1 90 13", "\nx 90 13", "line 29: 'x' is not a number"),
        ("Frames: 2", "Frames:\ntwo", "'Frames: <count>' and 'Frame Time: <seconds>'"),
        (TEXT, TEXT + TEXT, "line 30: a second motion begins here; save each"),
        (TEXT, TEXT + TEXT[TEXT.index("MOTION") :], "line 30: a second motion begins here"),
        ("ROOT Hips", "ROOT Hips\n{\n" * 3, "line 4: one ROOT is expected"),
    ],
)
def test_damage_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in TEXT
    with pytest.raises(FileError, match=message) as caught:
        read(tmp_path, TEXT.replace(old, new, 1), "cm", "y")
    assert str(tmp_path / "clip.bvh") in str(caught.value)


def test_bones_in_position_channels_are_bones(tmp_path: Path) -> None:
    """OFFSETs of zero, and constant positions instead: the same figure."""
    text = TEXT.replace("OFFSET 10 -5 0", "OFFSET 0 0 0").replace("OFFSET 0 60 0", "OFFSET 0 0 0")
    text = text.replace("CHANNELS 3 Z", "CHANNELS 6 Xposition Yposition Zposition Z")
    text = text.replace("CHANNELS 1 Y", "CHANNELS 4 Xposition Yposition Zposition Y")
    text = text.replace("10 20 30  40", "10 -5 0 10 20 30  0 60 0 40")
    text = text.replace("-10 -20 -30  50", "10 -5 0 -10 -20 -30  0 60 0 50")
    assert_same(read(tmp_path, text), read(tmp_path, TEXT))


@pytest.mark.parametrize("displaced", ["0 0 0", "0 0.02 0"])
def test_positions_that_would_make_the_figure_a_point_are_displacements(
    tmp_path: Path, displaced: str
) -> None:
    text = TEXT.replace("CHANNELS 3 Z", "CHANNELS 6 Xposition Yposition Zposition Z")
    text = text.replace("CHANNELS 1 Y", "CHANNELS 4 Xposition Yposition Zposition Y")
    text = text.replace("10 20 30  40", f"{displaced} 10 20 30  {displaced} 40")
    text = text.replace("-10 -20 -30  50", f"{displaced} -10 -20 -30  {displaced} 50")
    assert_same(read(tmp_path, text), read(tmp_path, TEXT), 1e-3)


def below(text: str, node: str, numbers: str) -> str:
    """The figure of `text` below a node of a scene, whose channels have these `numbers`."""
    head, motion = text.removeprefix("HIERARCHY\n").split("MOTION\n")
    rows = motion.splitlines()
    rows[2:] = [f"{numbers} {row}" for row in rows[2:]]
    return "\n".join(("HIERARCHY", node, head.replace("ROOT", "JOINT") + "}", "MOTION", *rows))


STILL_NODE = "ROOT scene\n{\nOFFSET 0 0 0\nCHANNELS 4 Xposition Yposition Zposition Yrotation"


def test_hips_that_travel_below_a_node_are_the_root(tmp_path: Path) -> None:
    assert_same(read(tmp_path, below(TEXT, STILL_NODE, "0 0 0 0")), read(tmp_path, TEXT))
    twice = below(below(TEXT, "ROOT rig\n{\nOFFSET 0 0 0\nCHANNELS 0", ""), STILL_NODE, "0 0 0 0")
    assert_same(read(tmp_path, twice), read(tmp_path, TEXT))


def test_place_and_turn_of_a_node_above_the_hips_are_theirs(tmp_path: Path) -> None:
    """A quarter turn about the file's y takes its z to its x: (1, 90, 13) to (13, 90, -1)."""
    clip = read(tmp_path, below(TEXT, STILL_NODE, "100 10 0 90"))
    assert clip.joint_names[0] == "Hips"
    assert clip.root_position[1].tolist() == pytest.approx([-0.01, 1.13, 1.0])
    quarter = rotations.from_exponential_map(torch.tensor([0.0, 0.0, np.pi / 2]).double())
    alone = read(tmp_path, TEXT)
    expected = rotations.multiply(quarter.expand(2, 4), alone.rotations[:, 0])
    assert rotations.angle_between(clip.rotations[:, 0], expected).max() < 1e-6
    torch.testing.assert_close(clip.rotations[:, 1:], alone.rotations[:, 1:])


def test_a_node_that_turns_its_figure_upright(tmp_path: Path) -> None:
    """The figure is written with z up below a node that turns it by -90° about x, to y up."""
    turned = re.sub(r"OFFSET (\S+) (\S+) (\S+)", r"OFFSET \1 -\3 \2", TEXT).replace("--", "")
    turned = re.sub(r"\n1 90 (\d+)", r"\n1 -\1 90", turned).replace(
        "0 0 0  10 20 30  40", "0 0 0  0 0 0  0"
    )
    node = STILL_NODE.replace("Yrotation", "Xrotation")
    clip = read(tmp_path, below(turned, node, "0 0 0 -90"))
    assert clip.root_position[0].tolist() == pytest.approx([0.03, 0.01, 0.9])
    assert float(clip.root_position[1, 2]) == pytest.approx(0.9)


def test_handles_beside_the_hips_are_no_part_of_the_figure(tmp_path: Path) -> None:
    handle = (
        STILL_NODE + "\nJOINT ik\n{\nOFFSET 0 0 0\nCHANNELS 3 Xposition Yposition Zposition\n}\n"
    )
    assert_same(read(tmp_path, below(TEXT, handle, "0 0 0 0  9 9 9")), read(tmp_path, TEXT))


def assert_same(clip: Clip, expected: Clip, within: float = 1e-9) -> None:
    assert clip.joint_names == expected.joint_names
    torch.testing.assert_close(clip.root_position, expected.root_position, rtol=0, atol=within)
    torch.testing.assert_close(clip.rotations, expected.rotations, rtol=0, atol=1e-9)
    assert clip.skeleton is not None
    assert expected.skeleton is not None
    np.testing.assert_allclose(clip.skeleton.offsets, expected.skeleton.offsets, atol=within)
    assert clip.skeleton.tips.keys() == expected.skeleton.tips.keys()


def test_a_unit_in_metres(tmp_path: Path) -> None:
    """CMU's 1 / 0.45 inch is recognised; any other is taken as a number."""
    assert scaled(tmp_path, 0.45 / 0.0254, "y").root_position[0, 2] == pytest.approx(0.9, rel=1e-3)
    clip = read(tmp_path, TEXT, unit=0.0254 / 0.45)
    assert clip.root_position[0, 2] == pytest.approx(90 * 0.0564444, rel=1e-5)
    with pytest.raises(ConfigError, match="the metres in a unit are above 0"):
        ReadOptions(unit=-1.0)


@pytest.mark.parametrize("said", ["Frame Time: 0\n", "Frame Time:\n", "Frame Time: nan\n", ""])
def test_a_rate_that_is_given_is_enough(tmp_path: Path, said: str) -> None:
    path = tmp_path / "clip.bvh"
    path.write_text(TEXT.replace("Frame Time: 0.025\n", said))
    clip = BvhReader().read(path, ReadOptions(rate=30.0))
    assert clip.times.tolist() == pytest.approx([0.0, 1 / 30])
    with pytest.raises(FileError, match=r"motion\.rate \(--source-rate\)"):
        BvhReader().read(path)


@pytest.mark.parametrize(
    ("encoding", "mark"),
    [("utf-16", ""), ("utf-16-le", ""), ("utf-16-be", "\ufeff"), ("utf-32", ""), ("cp1252", "")],
)
def test_encodings(tmp_path: Path, encoding: str, mark: str) -> None:
    path = tmp_path / "clip.bvh"
    text = TEXT.replace("Head", "Schädel")
    path.write_bytes((mark + text).encode(encoding))
    assert BvhReader().recognises(path.read_bytes()[:4096], path)
    clip = BvhReader().read(path)
    assert clip.joint_names == ("Hips", "Left Leg", "Schädel")
    torch.testing.assert_close(clip.root_position, read(tmp_path, TEXT).root_position)


#: What programs write in place of what the clip here has, right of an arrow; ``\n`` is a line's end.
DIALECTS = r"""
End Site -> End Site LeftFootEnd
End Site -> End Effector
End Site -> EndSite
End Site\n    { -> End\n    {\n
End Site -> End_Effector
End Site -> Site
OFFSET 0 20 0 -> OFFSET 0 20 0\n      CHANNELS 0
OFFSET 0 60 0 -> OFFSET 0,0 60,0 0,0
OFFSET 0 60 0 -> OFFSET 0, 60.0, 0
OFFSET 0 60 0 -> OFFSET 0 60 0 # cm
MOTION -> ; numbers\nMOTION\n# of frames
Frames: 2\n -> Frames: 2\x20
Frames: 2\n ->
Frames: 2 -> Frames 2.0
0.025 -> 2.5e-2 s
Frame Time: 0.025 -> FPS: 40
1 90 3 -> 1; 90; 3;
1 90 3 -> 1 90\n3
Frame Time: 0.025 -> Frame Time: 25 ms
Frame Time: 0.025 -> Frame Time: 1/40
Frame Time: 0.025 -> Frame_Time = 0.025
Frame Time: 0.025 -> Sample Rate: 40
CHANNELS 1 Yrotation -> CHANNELS 1 Yrotation\n    End Site\n    {\n    }
MOTION -> MOTION:
CHANNELS 3 -> CHANNEL 3
Zrotation -> Zrot
JOINT Head -> JOINT "Head"
Yposition -> Y_POSITION
Xposition Yposition Zposition -> Xtranslation Ytranslation Ztranslation
Xposition Yposition Zposition -> tx ty tz
Zrotation Xrotation Yrotation -> rotateZ rotateX rotateY
Zrotation Xrotation Yrotation -> rotationZ rotationX rotationY
CHANNELS 3 -> CHANNELS 3,
HIERARCHY -> HIERARCHY:
HIERARCHY -> \u200bHIERARCHY
Frame Time: 0.025 -> Frame Time: 0.025 # 30 fps?
Frame Time: 0.025 -> Frame Time: 0.025\nFPS: 40
Frame Time: 0.025 -> Frame Time: 0.025\nInterpolation: linear
Frames: 2 -> Take: 1\nFrames: 2
MOTION -> MOTION\n\nMOTION
Frames: 2 -> Frames:\n2
Frames: 2\nFrame Time: 0.025 -> Frames:\n\n2\nFrame Time:\n0.025
Frame Time: 0.025 -> Frame\nTime: 0.025
Frames: 2 -> Frames\n2
Frames: 2 -> Frames: 0
Frames: 2 -> Frames: -1
Frames: 2 -> Frames: +2
Frames: 2 -> Frames: 2 frames
0.025 -> 0.025 sec
0.025 -> 0.025f
0.025 -> 0.025;
0.025 -> 0.025,
0.025 -> 0,025 s
0.025 -> 1.0 / 40.0
0.025 -> 25000us
0.025 -> 25 milliseconds
0.025 -> 40 fps
Frame Time: 0.025 -> Frame Time (s): 0.025
Frame Time: 0.025 -> Frame Time [ms]: 25
Frame Time: 0.025 -> Frame-Time: 0.025
Frame Time: 0.025 -> Frames time: 0.025
Frame Time: 0.025 -> Framerate: 40 fps
Frame Time: 0.025 -> FPS=40.0 Hz
OFFSET 0 60 0 -> OFFSET: 0 60 0
OFFSET 0 60 0 -> OFFSET (0, 60, 0)
OFFSET 0 60 0 -> OFFSET 0,60,0
OFFSET 0 60 0 -> OFFSET 0;60,0;0;
OFFSET 0 -> OFFSET: 0
CHANNELS 3 -> CHANNELS: 3
Zrotation -> "Zrotation"
Zrotation -> Z-rotation
Zrotation Xrotation Yrotation -> zAngle xAngle yAngle
Xposition Yposition Zposition -> Xloc Yloc Zloc
ROOT -> JOINT
JOINT Head -> /* the head */ JOINT Head
JOINT Head -> % the head\n  JOINT Head
MOTION -> -- numbers\nMOTION
"""


def dialects() -> Iterator[str]:
    for line in DIALECTS.strip().splitlines():
        usual, other = line.partition("->")[::2]
        old, new = (side.strip().encode().decode("unicode_escape") for side in (usual, other))
        changed = TEXT.replace(old, new)
        assert changed != TEXT
        yield changed
    yield TEXT.replace("1 90 3 ", "1,0 90 3 ").replace("0.025", "0,025")
    yield "# exported\n\n// by hand\n" + TEXT
    yield "/* made by\n a program */\n% and by hand\n" + TEXT
    yield from (TEXT + "\0", TEXT + "\x1a", "\ufeff\ufeff" + TEXT)
    yield "# of somebody's\n" * 1000 + TEXT
    *above, first, second = TEXT.splitlines()
    for end in ("", ","):
        yield "\n".join((*above, *(",".join(row.split()) + end for row in (first, second))))
    yield "\n".join((*above, f"{first} {second}"))
    for end in (
        "Exported by a program 3.1",
        "END",
        "\nEVENTS 2\nFootDown 0.1\nFootUp 0.4",
        "---- end",
    ):
        yield TEXT.rstrip("\n") + f"\n\n{end}\n"
        yield TEXT.replace("Frames: 2\n", "").rstrip("\n") + f"\n{end}\n"
    yield TEXT.replace("-10 -20", "\u221210 \u221220")
    yield TEXT.replace("40\n1 90", "40 # first\n1 90")


@pytest.mark.parametrize("text", dialects())
def test_dialects(tmp_path: Path, text: str) -> None:
    path = tmp_path / "clip.bvh"
    path.write_text(text)
    assert BvhReader().recognises(path.read_bytes()[:4096], path)
    assert_same(read(tmp_path, text), read(tmp_path, TEXT))


def test_ends_may_have_channels(tmp_path: Path) -> None:
    """They have columns, which are of no joint; places in them are the tip's."""
    ends = TEXT.replace(
        "OFFSET 0 -80 5", "OFFSET 0 -80 5\n      CHANNELS 3 Zrotation Xrotation Yrotation"
    )
    ends = ends.replace("10 20 30  40", "10 20 30 1 2 3 40").replace("30  50", "30 0 0 0 50")
    assert_same(
        read(tmp_path, ends.replace("-20 -30 50", "-20 -30 0 0 0 50")), read(tmp_path, TEXT)
    )
    placed = TEXT.replace(
        "OFFSET 0 20 0", "OFFSET 0 0 0\n CHANNELS 3 Xposition Yposition Zposition"
    )
    placed = placed.replace("40\n", "40 0 20 0\n").replace("50\n", "50 0 20 0\n")
    assert_same(read(tmp_path, placed), read(tmp_path, TEXT))


def test_a_fraction_with_blanks_is_no_second_between_frames(tmp_path: Path) -> None:
    clip = read(tmp_path, TEXT.replace("0.025", "1 / 40"))
    assert clip.times.tolist() == pytest.approx([0.0, 0.025])
    with pytest.raises(FileError, match="'Frame Time' must be seconds above 0 and up to 1"):
        read(tmp_path, TEXT.replace("0.025", "1 / 0"))
    with pytest.raises(FileError, match="'Frame Time' must be seconds above 0 and up to 1"):
        read(tmp_path, TEXT.replace("0.025", "40"))  # a rate, where nothing says so


def test_joints_of_the_same_name_get_a_number(tmp_path: Path) -> None:
    clip = read(tmp_path, TEXT.replace("JOINT Head", "JOINT Left Leg"))
    assert clip.joint_names == ("Hips", "Left Leg", "Left Leg_2")
    torch.testing.assert_close(clip.rotations, read(tmp_path, TEXT).rotations)
    taken = TEXT.replace("JOINT Head", "JOINT Hips").replace("Left Leg", "Hips_2")
    assert read(tmp_path, taken).joint_names == ("Hips", "Hips_2", "Hips_3")


def test_a_hierarchy_without_end_is_refused(tmp_path: Path) -> None:
    nested = "HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\n" + "".join(
        f"JOINT j{i}\n{{\nOFFSET 0 1 0\nCHANNELS 0\n" for i in range(5000)
    )
    with pytest.raises(FileError, match="more than 1000 joints are not read"):
        read(tmp_path, nested)
    with pytest.raises(FileError, match="the file ends within the hierarchy"):
        read(tmp_path, "HIERARCHY\nROOT a\n{\n")


# Writing


def random_clip(seed: int, joints: int, frames: int, lock: bool) -> Clip:
    """Any tree, any rotations; `lock` puts the middle Euler angle at or near a quarter turn."""
    rng = np.random.default_rng(seed)
    parents = (-1, *(int(rng.integers(0, joint)) for joint in range(1, joints)))
    names = tuple(f"joint{i}" for i in range(joints))
    offsets = rng.normal(size=(joints, 3))
    offsets[0] = 0.0
    turned = Rotation.from_quat(rng.normal(size=(frames * joints, 4)))
    if lock:
        angles = rng.uniform(-180, 180, (frames * joints, 3))
        angles[:, 1] = rng.choice([90.0, -90.0], frames * joints)
        angles[:, 1] += rng.choice([0.0, 1e-9, 1e-6, -1e-4], frames * joints)
        turned = Rotation.from_euler(
            "XYZ", angles, degrees=True
        )  # ZXY of the file's axes is XYZ here
    quaternions = turned.as_quat()[:, [3, 0, 1, 2]].reshape(frames, joints, 4)
    return Clip(
        name="random",
        times=torch.arange(frames) / 50.0,
        root_position=torch.from_numpy(rng.uniform(-20.0, 20.0, (frames, 3))),
        rotations=torch.from_numpy(quaternions),
        joint_names=names,
        loop=False,
        skeleton=Skeleton(names, parents, offsets, {names[-1]: rng.normal(size=3)}),
    )


@CASES
@given(
    seed=st.integers(0, 2**32 - 1),
    joints=st.integers(1, 12),
    frames=st.integers(2, 6),
    lock=st.booleans(),
)
def test_what_is_written_is_read_again(
    tmp_path: Path, seed: int, joints: int, frames: int, lock: bool
) -> None:
    clip = random_clip(seed, joints, frames, lock)
    path = tmp_path / "clip.bvh"
    BvhWriter().write(clip, path)
    back = BvhReader().read(path, WRITTEN)
    assert sorted(back.joint_names) == sorted(clip.joint_names)
    order = [back.joint_names.index(name) for name in clip.joint_names]
    torch.testing.assert_close(back.times, clip.times, rtol=0, atol=1e-6)
    torch.testing.assert_close(back.root_position, clip.root_position, rtol=0, atol=1e-6)
    assert rotations.angle_between(back.rotations[:, order], clip.rotations).max() < 1e-5
    assert back.skeleton is not None
    assert clip.skeleton is not None
    np.testing.assert_allclose(back.skeleton.offsets[order], clip.skeleton.offsets, atol=1e-9)
    for joint, parent in enumerate(clip.skeleton.parents):
        found = back.skeleton.parents[order[joint]]
        assert found == -1 if parent == -1 else back.joint_names[found] == clip.joint_names[parent]
    (name,) = clip.skeleton.tips
    assert list(back.skeleton.tips) == [name]
    np.testing.assert_allclose(back.skeleton.tips[name], clip.skeleton.tips[name], atol=1e-9)


def test_written_files_need_no_options(tmp_path: Path) -> None:
    back = BvhReader().read(write_bvh(tmp_path))
    torch.testing.assert_close(back.root_position, walker().root_position, rtol=0, atol=1e-9)


def test_uneven_frames_are_resampled(tmp_path: Path) -> None:
    clip = walker(frames=4)
    uneven = Clip(
        name="uneven",
        times=torch.tensor([0.0, 0.1, 0.4, 0.6]),
        root_position=clip.root_position,
        rotations=clip.rotations,
        joint_names=clip.joint_names,
        loop=True,
        skeleton=clip.skeleton,
    )
    path = tmp_path / "uneven.bvh"
    BvhWriter().write(uneven, path)
    back = BvhReader().read(path)
    assert back.times.tolist() == pytest.approx([0.0, 0.2, 0.4, 0.6])
    torch.testing.assert_close(back.root_position[[0, 2, 3]], clip.root_position[[0, 2, 3]])


def test_a_thousand_joints_in_a_row_are_written(tmp_path: Path) -> None:
    joints = 1000
    names = tuple(f"j{i}" for i in range(joints))
    still = torch.zeros(2, joints, 4)
    still[..., 0] = 1.0
    skeleton = Skeleton(names, tuple(range(-1, joints - 1)), np.full((joints, 3), 0.001))
    clip = Clip("chain", torch.tensor([0.0, 1.0]), torch.zeros(2, 3), still, names, False, skeleton)
    BvhWriter().write(clip, tmp_path / "chain.bvh")
    assert BvhReader().read(tmp_path / "chain.bvh", WRITTEN).joint_names == names


def test_what_bvh_cannot_hold(tmp_path: Path) -> None:
    clip = walker()
    bare = Clip("bare", clip.times, clip.root_position, clip.rotations, clip.joint_names, False)
    with pytest.raises(FileError, match="has no skeleton"):
        BvhWriter().write(bare, tmp_path / "bare.bvh")
    names = ("the hips", *clip.joint_names[1:])
    assert clip.skeleton is not None
    skeleton = Skeleton(names, clip.skeleton.parents, clip.skeleton.offsets)
    odd = Clip(
        "odd", clip.times, clip.root_position, clip.rotations, names, False, skeleton=skeleton
    )
    with pytest.raises(FileError, match="joint 'the hips' cannot be written as BVH"):
        BvhWriter().write(odd, tmp_path / "odd.bvh")


def _in_radians(text: str) -> str:
    """A BVH whose frames have 3 positions, then angles, with these in radians."""
    head, rows = text.split("Frame Time", 1)
    time, *frames = rows.strip().splitlines()
    numbers = [np.array(frame.split(), dtype=float) for frame in frames]
    turned = [(*row[:3], *np.radians(row[3:])) for row in numbers]
    lines = [" ".join(f"{value:.6f}" for value in row) for row in turned]
    return "\n".join([f"{head}Frame Time{time}", *lines, ""])


@pytest.mark.parametrize("name", ["walk", "run", "hop", "sit", "cartwheel", "backflip"])
def test_angles_in_radians(tmp_path: Path, name: str) -> None:
    """They left a figure that slid along in its zero pose, silently."""
    written = tmp_path / "written.bvh"
    BvhWriter().write(library.find(name, installed().registry), written)
    expected = BvhReader().read(written)
    (tmp_path / "radians.bvh").write_text(_in_radians(written.read_text()))
    for options in (ReadOptions(), WRITTEN):
        clip = BvhReader().read(tmp_path / "radians.bvh", options)
        torch.testing.assert_close(clip.root_position, expected.root_position)
        alike = (clip.rotations * expected.rotations).sum(dim=-1).abs()
        assert alike.min() == pytest.approx(1.0, abs=1e-6)


def test_who_says_the_unit_of_angles_is_believed(tmp_path: Path) -> None:
    """Also where the figure looks otherwise."""
    written = tmp_path / "written.bvh"
    BvhWriter().write(library.find("walk", installed().registry), written)
    expected = BvhReader().read(written)
    (tmp_path / "radians.bvh").write_text(_in_radians(written.read_text()))

    def alike(file: str, angles: AngleUnit) -> float:
        clip = BvhReader().read(tmp_path / file, replace(WRITTEN, angles=angles))
        return float((clip.rotations * expected.rotations).sum(dim=-1).abs().min())

    assert alike("radians.bvh", "radians") == pytest.approx(1.0, abs=1e-6)
    assert alike("written.bvh", "degrees") == pytest.approx(1.0, abs=1e-6)
    assert alike("radians.bvh", "degrees") < 0.99
    assert alike("written.bvh", "radians") < 0.9


@pytest.mark.parametrize("kind", ["still", "typed", "crumpled"])
def test_small_angles_that_are_degrees(tmp_path: Path, kind: str) -> None:
    """Of a figure that stands where it is, by hand, and of a statue that is carried and trembles."""
    clip = walker(frames=40)
    generator = np.random.default_rng(0)
    angles = generator.uniform(-5, 5, (40, len(clip.joint_names), 3))
    if kind == "typed":
        angles = np.round(angles)
    turns = Rotation.from_euler("ZXY", angles.reshape(-1, 3), degrees=True).as_rotvec()
    vectors = torch.from_numpy(turns).reshape(40, -1, 3)
    vectors = vectors[:1].expand_as(vectors) if kind == "still" else vectors
    still = clip.root_position[:1].expand_as(clip.root_position)
    clip = replace(
        clip,
        rotations=rotations.from_exponential_map(vectors),
        root_position=still if kind == "still" else clip.root_position,
    )
    BvhWriter().write(clip, tmp_path / "small.bvh")
    read = BvhReader().read(tmp_path / "small.bvh")
    alike = (read.rotations * clip.rotations).sum(dim=-1).abs()
    assert alike.min() == pytest.approx(1.0, abs=1e-6)
