"""Robots' tables of angles: what their headers say of order and units, by hand."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from understudy.errors import FileError
from understudy_motion.clip import Clip
from understudy_motion.readers.angles import AnglesReader
from understudy_motion.reading import HEAD_BYTES, ReadOptions

PLACES = ["0", "0.1", "0.8"]
LYING = {"x": "0", "y": "0.7071068", "z": "0", "w": "0.7071068"}
"""By part: a robot on its back, by which it cannot be told whether w is first or last."""
HINGES = ["0.1", "-0.2"]


def read(folder: Path, *lines: str, **options: float) -> Clip:
    path = folder / "clip.csv"
    path.write_text("\n".join(lines) + "\n")
    reader = AnglesReader()
    assert reader.recognises(path.read_bytes(), path)
    return reader.read(path, ReadOptions(**options))  # type: ignore[arg-type]


def row(order: str = "xyzw", *before: str) -> str:
    return ",".join((*before, *PLACES, *(LYING[part] for part in order), *HINGES))


def check(clip: Clip, rate: float = 30.0) -> None:
    half = 0.5**0.5
    assert clip.root_position[-1].tolist() == pytest.approx([0.0, 0.1, 0.8])
    assert clip.rotations[-1, 0].tolist() == pytest.approx([half, 0.0, half, 0.0], abs=1e-6)
    turned = 2.0 * torch.atan2(clip.rotations[-1, 1:, 1], clip.rotations[-1, 1:, 0])
    assert turned.tolist() == pytest.approx([0.1, -0.2])
    assert clip.frame_rate == pytest.approx(rate, rel=1e-3)


@pytest.mark.parametrize("order", ["xyzw", "wxyz"])
@pytest.mark.parametrize(
    "form", ["q{}", "quat_{}", "root_q{}", "base_quat_{}", "root.rot.{}", "pelvis_rotation_{}"]
)
@pytest.mark.parametrize("mark", ["", "# "])
def test_the_names_say_the_quaternions_order(
    tmp_path: Path, order: str, form: str, mark: str
) -> None:
    """Where the root lies it was read as xyzw, whatever its header said; the header may be np.savetxt's remark."""
    names = ",".join(
        ("root_x", "root_y", "root_z", *(form.format(part) for part in order), "knee_joint", "hip")
    )
    clip = read(tmp_path, mark + names, row(order), row(order))
    check(clip)
    assert clip.joint_names == ("root", "angle knee", "angle hip")


def test_the_roots_columns_may_stand_anywhere(tmp_path: Path) -> None:
    numbers = ",".join((*(LYING[part] for part in "wxyz"), *PLACES, *HINGES))
    check(read(tmp_path, "qw,qx,qy,qz,x,y,z,knee,hip", numbers, numbers))
    numbers = ",".join((*HINGES, *PLACES, *(LYING[part] for part in "xyzw")))
    clip = read(tmp_path, "knee,hip,x,y,z,qx,qy,qz,qw", numbers, numbers)
    check(clip)
    assert clip.joint_names == ("root", "angle knee", "angle hip")


@pytest.mark.parametrize("index", ["", ","])
def test_numbers_of_columns_are_no_names(tmp_path: Path, index: str) -> None:
    """As pandas writes a table without names, with its index or without."""
    head = index + ",".join(map(str, range(9)))
    rows = [row("xyzw", *([str(n)] if index else [])) for n in range(3)]
    clip = read(tmp_path, head, *rows)
    check(clip)
    assert (clip.num_frames, clip.joint_names) == (3, ("root", "angle 1", "angle 2"))


@pytest.mark.parametrize("first", ["V1", "Column1", "x.1", "1", "0.0", "col_0", "Unnamed: 0"])
def test_names_that_only_count_are_no_joints(tmp_path: Path, first: str) -> None:
    """As R and spreadsheets name columns that have no names; they were taken for joints'."""
    begin, end = ("0", ".0") if first == "0.0" else (first[-1], "")
    word = "" if first == "0.0" else first[:-1]
    names = ",".join(f"{word}{int(begin) + n}{end}" for n in range(9))
    clip = read(tmp_path, names, row(), row())
    check(clip)
    assert clip.joint_names == ("root", "angle 1", "angle 2")


NAMES = ["x", "y", "z", "qx", "qy", "qz", "qw", "knee", "hip"]


def quoted(line: str, between: str = ",") -> str:
    return between.join(f'"{cell}"' for cell in line.split(","))


@pytest.mark.parametrize(
    ("lines", "named"),
    [
        ([quoted(row())] * 3, False),
        ([quoted(row()).replace(".", ",")] * 3, False),
        ([quoted(row(), ";").replace(".", ",")] * 3, False),
        (["sep=,", *[row()] * 3], False),
        (['"sep=;"', *[row().replace(",", ";").replace(".", ",")] * 3], False),
        ([quoted(",".join(NAMES)), *[quoted(row())] * 3], True),
        ([quoted(",".join(NAMES)), *(f'"{n}",{row()}' for n in (1, 2, 3))], True),
        ([",".join(NAMES), *(f"{n},{row()}" for n in (1, 2, 3))], True),
        ([quoted(",".join(NAMES), " "), *(f'"{n}" {row().replace(",", " ")}' for n in (1, 2, 3))], True),
        ([quoted(",".join(["", *NAMES])), *(f'"{n}",{row()}' for n in (1, 2, 3))], True),
    ],
)  # fmt: skip
def test_tables_of_r_and_spreadsheets(tmp_path: Path, lines: list[str], named: bool) -> None:
    """Quotes around cells, with decimal commas in them, names of rows that have none above them, and ``sep=``."""
    clip = read(tmp_path, *lines)
    check(clip)
    joints = ("angle knee", "angle hip") if named else ("angle 1", "angle 2")
    assert (clip.num_frames, clip.joint_names) == (3, ("root", *joints))


@pytest.mark.parametrize("cell", ['"' + "0" * 200_000, '"0.1', '"a"b', '""'])
def test_quotes_around_no_number_are_refused(tmp_path: Path, cell: str) -> None:
    (tmp_path / "clip.csv").write_text("\n".join([row(), f"{cell},{row()}", row()]))
    with pytest.raises(FileError, match=r"line 2: .*(is not a number|9 numbers are needed)"):
        AnglesReader().read(tmp_path / "clip.csv")


def test_names_of_rows_of_a_long_table(tmp_path: Path) -> None:
    """Of which only the beginning is looked at, whose last line is cut."""
    path = tmp_path / "clip.csv"
    lines = [",".join(NAMES), *(f"{n},{row()}" for n in range(1, 201))]
    path.write_text("\n".join(lines) + "\n")
    assert len(path.read_bytes()) > HEAD_BYTES
    assert AnglesReader().recognises(path.read_bytes()[:HEAD_BYTES], path)
    clip = AnglesReader().read(path)
    check(clip)
    assert clip.num_frames == 200


def test_a_cell_more_than_names_is_refused(tmp_path: Path) -> None:
    """Unless it is the rows' name in every row."""
    for rows in ([f"5,{row()}", f"7,{row()}"], [f"1,{row()}", row()], [f"{row()},1"] * 2):
        (tmp_path / "clip.csv").write_text("\n".join((",".join(NAMES), *rows)))
        with pytest.raises(FileError, match="9 numbers are needed, not 10"):
            AnglesReader().read(tmp_path / "clip.csv")


@pytest.mark.parametrize(
    ("time", "unit"), [("time_ms", 20), ("time [s]", 0.02), ("timestamp_us", 20000), ("t", 0.02)]
)
def test_times_have_the_unit_of_their_name(tmp_path: Path, time: str, unit: float) -> None:
    """Milliseconds were seconds, silently."""
    head = f"{time},x,y,z,qx,qy,qz,qw,knee,hip"
    check(read(tmp_path, head, *(row("xyzw", f"{n * unit:g}") for n in range(4))), rate=50.0)


def test_times_that_cannot_be_seconds(tmp_path: Path) -> None:
    rows = [row("xyzw", str(20 * n)) for n in range(4)]
    with pytest.raises(
        FileError, match=r"are 20 s apart; write them in seconds, or give motion\.rate"
    ):
        read(tmp_path, *rows)
    check(read(tmp_path, *rows, rate=50.0), rate=50.0)


def test_units_of_names(tmp_path: Path) -> None:
    names = ["x [cm]", "y_cm", "z (mm)", "qx", "qy", "qz", "qw", "knee [deg]", "hip_deg"]
    numbers = f"0,10,800,{','.join(LYING[part] for part in 'xyzw')},5.729578,-11.459156"
    clip = read(tmp_path, ",".join(names), numbers, numbers)
    check(clip)
    assert clip.joint_names == ("root", "angle knee", "angle hip")


@pytest.mark.parametrize("degrees", [7.0, 12.0, 90.0])
def test_degrees_that_are_not_said_are_asked_about(tmp_path: Path, degrees: float) -> None:
    """Up to 12.6 they were radians: half the hinges beyond a turn."""
    numbers = ",".join(
        (*PLACES, *(LYING[part] for part in "xyzw"), "1", f"{-degrees}", f"{degrees}")
    )
    with pytest.raises(FileError, match="seem to be in degrees; write them in radians"):
        read(tmp_path, numbers, numbers)


def test_a_height_in_centimetres_is_said_as_such(tmp_path: Path) -> None:
    numbers = f"0,10,80,{','.join(LYING[part] for part in 'xyzw')},0.1,-0.2"
    with pytest.raises(FileError, match=r"80 m from the floor; .* \(--unit\), as cm"):
        read(tmp_path, numbers, numbers)


@pytest.mark.parametrize(
    ("place", "first"),
    [(0, ()), (7, ()), (-1, ()), (0, ("",)), (0, ("frame",)), (1, ("frame",)), (None, ("index",))],
)
@pytest.mark.parametrize("hinges", [0, 3])
def test_columns_of_times_and_numbers_are_no_hinges(
    tmp_path: Path, place: int | None, first: tuple[str, ...], hinges: int
) -> None:
    """A column called time that was not the first, or of a root alone, was an angle, silently."""
    names = ["root_x", "root_y", "root_z", "root_qx", "root_qy", "root_qz", "root_qw"]
    names += [f"knee_{n}" for n in range(hinges)]
    rows = [[0.02 * f, 0.0, 0.9, 0.0, 0.0, 0.6, 0.8, *[0.1 * f] * hinges] for f in range(6)]
    if place is not None:
        at = len(names) if place < 0 else place
        names.insert(at, "time")
        for frame, row in enumerate(rows):
            row.insert(at, frame / 50)
    names = [*first, *names]
    lines = [names, *([*([str(f)] if first else []), *row] for f, row in enumerate(rows))]
    (tmp_path / "robot.csv").write_text("\n".join(",".join(map(str, line)) for line in lines))
    clip = AnglesReader().read(tmp_path / "robot.csv")
    assert clip.joint_names == ("root", *(f"angle knee_{n}" for n in range(hinges)))
    assert clip.frame_rate == pytest.approx(30.0 if place is None else 50.0)
    assert clip.root_position[3].tolist() == pytest.approx([0.06, 0.0, 0.9])
    assert clip.rotations[3, 0].tolist() == pytest.approx([0.8, 0.0, 0.0, 0.6])


@pytest.mark.parametrize("text", ["", "\n \n", "# a remark\n; another\n"])
def test_a_table_of_no_rows(tmp_path: Path, text: str) -> None:
    """The recognised file may be cut off before it is read."""
    path = tmp_path / "clip.csv"
    path.write_text(text)
    with pytest.raises(FileError, match="it has no row of numbers"):
        AnglesReader().read(path)
