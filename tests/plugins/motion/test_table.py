"""This product's own formats: nothing is lost in NPZ, and CSV says what it needs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from motion_files import walker, write_csv, write_npz

from understudy.errors import FileError
from understudy_motion.clip import Clip, Skeleton
from understudy_motion.readers.angles import AnglesReader
from understudy_motion.readers.table import CsvReader, NpzReader
from understudy_motion.reading import UNSAID, ReadOptions
from understudy_motion.writers.table import CsvWriter, NpzWriter
from understudy_tensors import rotations

CASES = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)

#: Any text that a name may be; numpy's strings cannot end in NUL.
TEXTS = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12)


@st.composite
def clips(draw: st.DrawFn) -> Clip:
    """Any clip at all, with or without a skeleton."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    joints, frames = draw(st.integers(1, 8)), draw(st.integers(2, 9))
    names = tuple(draw(st.lists(TEXTS, min_size=joints, max_size=joints, unique=True)))
    skeleton = None
    if draw(st.booleans()):
        offsets = rng.normal(size=(joints, 3))
        offsets[0] = 0.0
        tipped = draw(st.lists(st.sampled_from(names), unique=True))
        skeleton = Skeleton(
            names,
            (-1, *(int(rng.integers(0, joint)) for joint in range(1, joints))),
            offsets,
            {name: rng.normal(size=3) for name in tipped},
        )
    steps = torch.from_numpy(rng.uniform(1e-4, 1.0, frames - 1))
    return Clip(
        name=draw(TEXTS),
        times=torch.cat((torch.zeros(1, dtype=torch.float64), steps.cumsum(0))),
        root_position=torch.from_numpy(rng.normal(size=(frames, 3)) * 10.0 ** rng.integers(-3, 4)),
        rotations=rotations.normalize(torch.from_numpy(rng.normal(size=(frames, joints, 4)))),
        joint_names=names,
        loop=draw(st.booleans()),
        skeleton=skeleton,
        source=draw(TEXTS),
        licence=draw(TEXTS),
        sha256=draw(TEXTS),
        url=draw(TEXTS),
        attribution=draw(TEXTS),
    )


@CASES
@given(clip=clips())
def test_npz_loses_nothing(tmp_path: Path, clip: Clip) -> None:
    path = tmp_path / "clip.npz"
    NpzWriter().write(clip, path)
    back = NpzReader().read(path)
    for name in (
        "name",
        "loop",
        "joint_names",
        "source",
        "licence",
        "sha256",
        "url",
        "attribution",
    ):
        assert getattr(back, name) == getattr(clip, name), name
    assert torch.equal(back.times, clip.times)
    assert torch.equal(back.root_position, clip.root_position)
    torch.testing.assert_close(back.rotations, clip.rotations, rtol=0, atol=1e-15)
    assert (back.skeleton is None) == (clip.skeleton is None)
    if clip.skeleton is not None and back.skeleton is not None:
        assert back.skeleton.parents == clip.skeleton.parents
        assert back.skeleton.joint_names == clip.skeleton.joint_names
        np.testing.assert_array_equal(back.skeleton.offsets, clip.skeleton.offsets)
        assert list(back.skeleton.tips) == list(clip.skeleton.tips)
        for joint, tip in clip.skeleton.tips.items():
            np.testing.assert_array_equal(back.skeleton.tips[joint], tip)


NAMES = st.text(
    st.characters(codec="ascii", exclude_characters=',"# \0', min_codepoint=33), min_size=1
).filter(lambda name: name[0] not in "=+-@")  # formulas of a spreadsheet, which are refused


@CASES
@given(clip=clips(), data=st.data())
def test_csv_keeps_the_motion(tmp_path: Path, clip: Clip, data: st.DataObject) -> None:
    joints = len(clip.joint_names)
    names = tuple(data.draw(st.lists(NAMES, min_size=joints, max_size=joints, unique=True)))
    path = tmp_path / "clip.csv"
    CsvWriter().write(replace(clip, joint_names=names, skeleton=None), path)
    back = CsvReader().read(path)
    assert back.joint_names == names
    assert back.loop == clip.loop
    assert torch.equal(back.times, clip.times)
    assert torch.equal(back.root_position, clip.root_position)
    torch.testing.assert_close(back.rotations, clip.rotations, rtol=0, atol=1e-15)


@pytest.mark.parametrize("name", [";;", ";0;", "a;b;c;d;e;f;g;h"])
def test_csv_keeps_names_with_another_delimiter_in_them(tmp_path: Path, name: str) -> None:
    path = tmp_path / "clip.csv"
    clip = Clip(
        "clip",
        times=torch.tensor([0.0, 0.1], dtype=torch.float64),
        root_position=torch.zeros(2, 3, dtype=torch.float64),
        rotations=torch.tensor([[[1.0, 0, 0, 0]]] * 2, dtype=torch.float64),
        joint_names=(name,),
        loop=False,
    )
    CsvWriter().write(clip, path)
    assert CsvReader().read(path).joint_names == (name,)


def test_npz_is_the_same_bytes_each_time(tmp_path: Path) -> None:
    assert write_npz(tmp_path).read_bytes() == write_npz(tmp_path).read_bytes()


def changed_npz(folder: Path, **changes: Any) -> Path:
    with np.load(write_npz(folder)) as file:
        arrays = dict(file)
    arrays.update(changes)
    path = folder / "changed.npz"
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
    return path


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "other.clip"}, "not of format 'understudy.clip' version 1"),
        ({"version": 2}, "not of format 'understudy.clip' version 1"),
        ({"times": None}, "the array 'times' is missing"),
        (
            {"times": np.arange(5.0)},
            r"'root_position': its shape is \(6, 3\) and should be \(5, 3\)",
        ),
        ({"times": -np.arange(6.0)}, "time does not increase"),
        ({"times": np.full(6, np.nan)}, "frame 0: 'times' is not finite"),
        ({"joint_names": np.array(["a"])}, "'rotations': its shape"),
        ({"joint_names": np.array(["hips"] * 6), "parents": None}, "'hips' is named twice"),
        ({"loop": 1}, "'loop': holds int64 where true or false are needed"),
        ({"name": 3}, "'name': holds int64 where text are needed"),
        ({"rotations": np.zeros((6, 6, 4))}, "hips quaternion is not unit"),
        ({"parents": np.array([-1, 0, 0, 3, 0, 4])}, "joint 'l_shin': its parent must come before"),
        ({"parents": np.array([0, 0, 0, 2, 0, 4])}, "joint 'hips': its parent"),
        ({"parents": np.array([-1, 0, 0, -9, 0, 4])}, "joint 'l_shin': its parent"),
        ({"offsets": np.full((6, 3), 1e9)}, "joint 'hips': an offset is not a number of metres"),
        ({"tip_joints": np.array(["a", "b", "c"])}, "a tip belongs to 'a', which is no joint"),
    ],
)
def test_damage_of_npz_is_named(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    path = changed_npz(tmp_path, **changes)
    with pytest.raises(FileError, match=message) as caught:
        NpzReader().read(path)
    assert str(path) in str(caught.value)


CSV = """# made by hand
# rate: 50
# loop: true
root.px,root.py,root.pz,pelvis.qw,pelvis.qx,pelvis.qy,pelvis.qz,knee.rx,knee.ry,knee.rz
0,0,0.9,1,0,0,0,0,0.5,0
0.1,0,0.9,1,0,0,0,0,0.7,0
"""


def read_csv(folder: Path, text: str, options: ReadOptions = UNSAID) -> Clip:
    path = folder / "clip.csv"
    path.write_text(text, newline="")
    return CsvReader().read(path, options)


def test_a_table_by_hand(tmp_path: Path) -> None:
    clip = read_csv(tmp_path, CSV)
    assert clip.joint_names == ("pelvis", "knee")
    assert clip.frame_rate == pytest.approx(50.0)
    assert clip.loop
    assert clip.skeleton is None
    assert rotations.to_exponential_map(clip.rotations[1, 1]).tolist() == pytest.approx([0, 0.7, 0])
    assert clip.root_position[1].tolist() == [0.1, 0.0, 0.9]
    assert read_csv(tmp_path, CSV, ReadOptions(rate=25.0, loop=False)).duration == 0.04
    quoted = CSV.replace("knee.rx", '"knee.rx"')
    assert read_csv(tmp_path, quoted).joint_names == ("pelvis", "knee")
    spaced = CSV.replace(",", " , ").replace("\n", "\r\n") + "\r\n\r\n"
    assert torch.equal(read_csv(tmp_path, spaced).rotations, clip.rotations)


def test_tables_of_spreadsheets_and_pandas(tmp_path: Path) -> None:
    """Row numbers without a name, empty columns, quotes, semicolons and decimal commas, UTF-16."""
    expected = read_csv(tmp_path, CSV)
    lines = CSV.splitlines()
    comments, rows = lines[:3], lines[3:]

    def same(*table: str, encoding: str = "utf-8") -> None:
        path = tmp_path / "clip.csv"
        path.write_text("\n".join((*comments, *table)), encoding=encoding)
        assert CsvReader().recognises(path.read_bytes()[:4096], path)
        clip = CsvReader().read(path)
        assert clip.joint_names == expected.joint_names
        assert torch.equal(clip.rotations, expected.rotations)
        assert torch.equal(clip.root_position, expected.root_position)

    for index in ("", '""', "Unnamed: 0", "index", "Frame", "#", "# frame", "idx", "level_0"):
        same(f"{index},{rows[0]}", f"0,{rows[1]}", f"1,{rows[2]}")
    same(f"{rows[0]},,", f"{rows[1]},,", f"{rows[2]},,")
    same(rows[0], *(",".join(f'"{cell}"' for cell in row.split(",")) for row in rows[1:]))
    same(*(row.replace(",", ";") for row in rows))
    same(rows[0].replace(",", "\t"), *(r.replace(",", "\t").replace(".", ",") for r in rows[1:]))
    same(rows[0].replace(",", ";"), *(r.replace(",", ";").replace(".", ",") for r in rows[1:]))
    same(*rows, encoding="utf-16")
    same("sep=,", *rows)
    same(rows[0], *(f"{n},{row}" for n, row in enumerate(rows[1:], start=1)))  # as R does it
    blanks = [row.replace(",", " ") for row in rows]
    same(
        " ".join(f'"{name}"' for name in blanks[0].split()), f'"1" {blanks[1]}', f'"2" {blanks[2]}'
    )
    for time in ("Time", "t", "time_s", "Time [s]", "time (sec)"):
        same(rows[0].replace("time", time), *rows[1:])
    with pytest.raises(FileError, match="line 5: 10 numbers are needed, not 9"):
        read_csv(tmp_path, "\n".join((*comments, f",{rows[0]}", rows[1][2:], f"1,{rows[2]}")))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("# loop: true", "# loop: True"),
        ("# rate: 50", "# Rate: 50 Hz"),
        ("# rate: 50", "# fps = 50"),
        ("# rate: 50", "# frame rate: 50,0"),
        ("# rate: 50", "# rate: 50,,,,,,,,,"),
        ("# rate: 50", '"# rate: 50",,,'),
        ("root.px,root.py,root.pz", "Root.PX,Root.PY,Root.PZ"),
        ("root.px,root.py,root.pz", "root_px,root_py,root_pz"),
        ("root.px,root.py,root.pz", "root.px [m],root.py (m),root.pz [m]"),
        ("knee.rx,knee.ry", "knee.RX,knee.ry [rad]"),
        ("root.px,root.py,root.pz", "root.x,root.y,root.z"),
        ("root.px,root.py,root.pz", "root_pos_x,root_pos_y,root_pos_z"),
        ("root.px,root.py,root.pz", "root/tx,root/ty,root/tz"),
        ("root.px", "'root.px'"),
        ("# rate: 50\n# loop", "// rate: 50\n% loop"),
        (",0\n", ",0,\n"),
        ("0.7,0\n", "0.7,0\n,,,,,,,,,\n,,,,,,,,,\n"),
        ("0.5,0\n", "0.5,0\n# second\n"),
        ("0.5,0\n", "0.5,0\n; second; of; two; and; no; more; than; these\n"),
        ("# made", "; made; in no hurry"),
        ("# rate: 50", "; rate: 50"),
        ("0.7,0\n", "0.7,0\n;\n"),
        ("0.7,0\n", "0.7,0\n# end\n"),
        ("# made", "\ufeff\ufeff# made"),
    ],
)
def test_as_people_write(tmp_path: Path, old: str, new: str) -> None:
    assert old in CSV
    clip, expected = read_csv(tmp_path, CSV.replace(old, new)), read_csv(tmp_path, CSV)
    head = (tmp_path / "clip.csv").read_bytes()
    assert CsvReader().recognises(head, tmp_path / "clip.csv")
    assert not AnglesReader().recognises(head, tmp_path / "clip.csv")
    assert (clip.joint_names, clip.loop) == (expected.joint_names, True)
    assert clip.frame_rate == pytest.approx(50.0)
    assert torch.equal(clip.rotations, expected.rotations)
    assert torch.equal(clip.root_position, expected.root_position)


@pytest.mark.parametrize(
    ("changes", "options"),
    [
        ({"root.px,root.py,root.pz": "root.px [cm],root.py [cm],root.pz (cm)", "0.1,0,": "10,0,", "0.9": "90"}, {}),
        ({"root.px,root.py": "root.px [mm],root.py [mm]", "0.1,0,": "100,0,"}, {}),
        ({"0.1,0,": "10,0,", "0.9": "90"}, {"unit": "cm"}),
        ({"knee.ry": "knee.ry [deg]", "0,0.5,": "0,28.64788975654116,", "0.7": "40.107045659157625"}, {}),
        ({"knee.ry": "knee.ry (°)", "0,0.5,": "0,28.64788975654116,", "0.7": "40.107045659157625"}, {}),
        ({"# rate: 50": "#", "root.px": "time_ms,root.px", "\n0,0,": "\n0,0,0,", "\n0.1,": "\n20,0.1,"}, {}),
        ({"root.px": "Time [s],root.px", "\n0,0,": "\n7,0,0,", "\n0.1,": "\n7.02,0.1,"}, {}),
        ({"root.px": "t,root.px", "\n0,0,": "\n7,0,0,", "\n0.1,": "\n9,0.1,"}, {"rate": 50.0}),
        ({",": "|"}, {}),
    ],
)  # fmt: skip
def test_units_of_columns(tmp_path: Path, changes: dict[str, str], options: dict[str, Any]) -> None:
    text = CSV
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    clip, expected = read_csv(tmp_path, text, ReadOptions(**options)), read_csv(tmp_path, CSV)
    assert clip.joint_names == expected.joint_names
    for field in ("times", "root_position", "rotations"):
        torch.testing.assert_close(getattr(clip, field), getattr(expected, field))


HEAD, *ROWS = CSV.splitlines()[3:]


@pytest.mark.parametrize("parted", [",", ";", " ", "\t"])
def test_remarks_that_begin_with_a_semicolon(tmp_path: Path, parted: str) -> None:
    """Their file was of no format that is read, and a row that begins with nothing is none of them."""
    rows = [row.replace(",", parted) for row in (HEAD, *ROWS)]
    text = "\n".join(("; by hand; of two", "; rate: 50", rows[0], rows[1], "; the second", rows[2]))
    clip, expected = read_csv(tmp_path, text), read_csv(tmp_path, CSV)
    path = tmp_path / "clip.csv"
    path.write_text(text)
    assert CsvReader().recognises(path.read_bytes(), path)
    assert torch.equal(clip.root_position, expected.root_position)
    assert torch.equal(clip.times, expected.times)
    short = ";".join(ROWS[1].split(",")[:5])
    for row in (f";{short}", ";".join(["", *ROWS[1].split(",")[1:]])):
        with pytest.raises(FileError, match="line 5"):
            read_csv(
                tmp_path,
                "\n".join(
                    (
                        "# rate: 50",
                        *[r.replace(",", ";") for r in (HEAD, ROWS[0])],
                        ROWS[0].replace(",", ";"),
                        row,
                    )
                ),
            )


def table(*rows: str) -> str:
    """The table by hand, of these rows."""
    return "\n".join((*CSV.splitlines()[:3], *rows)) + "\n"


@pytest.mark.parametrize(
    "text",
    [
        table(*(row.replace(",", " ") for row in (HEAD, *ROWS))),
        table(*("  ".join(f"{cell:>10}" for cell in row.split(",")) for row in (HEAD, *ROWS))),
        table("# " + HEAD.replace(",", " "), *(row.replace(",", " ") for row in ROWS)),
        table(HEAD.replace(",", " [m] ", 3).replace(",", " "), *(r.replace(",", " ") for r in ROWS)),
        table(HEAD, "m,m,m,,,,,rad,rad,rad", *ROWS),
        table(HEAD, "[m],[m],[m],-,-,-,-,[rad],[rad],[rad]", *ROWS),
        table(HEAD, "(metres),(metres),(metres),1,1,1,1,1,1,1", *ROWS),
        table(HEAD, "cm,m,cm,,,,,,deg,", "0,0,90,1,0,0,0,0,28.64788975654116,0",
              "10,0,90,1,0,0,0,0,40.107045659157625,0"),
        table(HEAD.replace(",", ";"), "cm;m;cm;;;;;;deg;", "0;0;90;1;0;0;0;0;28,64788975654116;0",
              "10;0;90;1;0;0;0;0;40,107045659157625;0"),
    ],
)  # fmt: skip
def test_blanks_between_columns_and_a_row_of_units(tmp_path: Path, text: str) -> None:
    clip, expected = read_csv(tmp_path, text), read_csv(tmp_path, CSV)
    path = tmp_path / "clip.csv"
    path.write_text(text)
    assert CsvReader().recognises(path.read_bytes(), path)
    assert not AnglesReader().recognises(path.read_bytes(), path)
    assert clip.joint_names == expected.joint_names
    for field in ("times", "root_position", "rotations"):
        torch.testing.assert_close(getattr(clip, field), getattr(expected, field))


@pytest.mark.parametrize(
    ("name", "times"),
    [
        ("time", ("2024-05-01T10:00:00", "2024-05-01T10:00:00.020")),
        ("timestamp", ("2024-05-01 23:59:59.990000+00:00", "2024-05-02 00:00:00.010000+00:00")),
        ("time", ("2024-05-01T10:00:00.000000001Z", "2024-05-01T10:00:00.020000001Z")),
        ("time", ("10:00:59.990", "10:01:00.010")),
        ("time", ("1 days 00:00:00", "1 days 00:00:00.02")),
        ("time", ("0:00.98", "0:01.00")),
        ("timestamp", ("1714557600000000000", "1714557600020000000")),
        ("timestamp", ("1714557600000000", "1714557600020000")),
        ("timestamp", ("1714557600000", "1714557600020")),
        ("time_ms", ("1714557600000", "1714557600020")),
        ("time [us]", ("1714557600000000", "1714557600020000")),
        ("timestamp_ns", ("1714557600000000000", "1714557600020000000")),
        ("time [ms]", ("2024-05-01T10:00:00", "2024-05-01T10:00:00.020")),
        ("time (µs)", ("0", "20000")),
    ],
)
def test_dates_clocks_and_counts(tmp_path: Path, name: str, times: tuple[str, str]) -> None:
    rows = (f"{time},{row}" for time, row in zip(times, ROWS, strict=True))
    clip = read_csv(tmp_path, table(f"{name},{HEAD}", *rows))
    assert clip.times.tolist() == pytest.approx([0.0, 0.02], abs=1e-9)


@pytest.mark.parametrize(
    ("times", "message"),
    [
        (("10:00:00:01", "10:00:00:02"), "column 'time': '10:00:00:01' is no time; write seconds"),
        (("2024-05-01T10:00:00", "0.02"), "'0.02' is no time"),
        (("01.05.2024 10:00", "01.05.2024 10:00"), "no time; write seconds, as 0.033, or a date"),
        (("1714557600000000000", "1714557600020000000.5"), "is no time"),
        (("10:00:00", "09:00:00"), "frame 1: time does not increase"),
    ],
)
def test_what_is_no_time(tmp_path: Path, times: tuple[str, str], message: str) -> None:
    rows = (f"{time},{row}" for time, row in zip(times, ROWS, strict=True))
    with pytest.raises(FileError, match=message):
        read_csv(tmp_path, table(f"time,{HEAD}", *rows))


def test_other_units_are_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="40 rad long, so they seem to be in degrees"):
        read_csv(tmp_path, CSV.replace("0,0.7,0", "0,40,0"))
    with pytest.raises(
        FileError, match=r"90 m from the floor; give motion\.unit \(--unit\), as cm"
    ):
        read_csv(tmp_path, CSV.replace("0.9", "90"))


def test_columns_of_joints_are_never_a_robots(tmp_path: Path) -> None:
    """A name that is not read is said, where the rest would pass for angles of a robot."""
    path = tmp_path / "clip.csv"
    path.write_text(CSV.replace("root.px,root.py,root.pz", "hips x,hips y,hips z"))
    head = path.read_bytes()
    assert not AnglesReader().recognises(head, path)
    assert CsvReader().recognises(head, path)
    with pytest.raises(FileError, match=r"column 'root\.px' is missing"):
        CsvReader().read(path)


@pytest.mark.parametrize(
    "form",
    [
        "{}_q{}", "{} q{}", "{}/q{}", "{}_quat_{}", "{}_quat{}", "{}:q{}", "{}_Q{}", "{}.quat.{}", "{}_{}", "{}.{}",
        "{}_rot_{}", "{}.rotation.{}", "{}.q_{}", "{}_quaternion_{}", "'{}.q{}'",
    ],
)  # fmt: skip
def test_quaternions_as_people_name_them_are_no_angles(tmp_path: Path, form: str) -> None:
    """They were a robot's angles, silently."""
    names = [f"{joint}.q{part}" for joint in ("hips", "left knee") for part in "wxyz"]
    numbers = "0,0,0.9,1,0,0,0,1,0,0,0"
    plain = ",".join(("root.px,root.py,root.pz", *names))
    expected = read_csv(tmp_path, f"# rate: 50\n{plain}\n{numbers}\n{numbers}\n")
    other = [form.format(*name.split(".q")) for name in names]
    text = "\n".join(("# rate: 50", ",".join(("root_x,root_y,root_z", *other)), numbers, numbers))
    clip = read_csv(tmp_path, text)
    # The root's own name is no hindrance.
    rooted = text.replace("root_x,root_y,root_z", "root:px,root:py,root:pz").replace("hips", "root")
    rooted = read_csv(tmp_path, rooted)
    assert rooted.joint_names == ("root", "left knee")
    assert torch.equal(rooted.rotations, expected.rotations)
    read_csv(tmp_path, text)
    path = tmp_path / "clip.csv"
    assert not AnglesReader().recognises(path.read_bytes(), path)
    assert CsvReader().recognises(path.read_bytes(), path)
    assert clip.joint_names == expected.joint_names == ("hips", "left knee")
    assert torch.equal(clip.rotations, expected.rotations)


@pytest.mark.parametrize(
    "name",
    ["Unnamed: 0.1", "No.", "frame_id", "Frame #", "sample", "step", "row_number", "frame_index"],
)
def test_columns_of_row_numbers(tmp_path: Path, name: str) -> None:
    numbered = table(f"{name},{HEAD}", *(f"{n},{row}" for n, row in enumerate(ROWS)))
    assert torch.equal(
        read_csv(tmp_path, numbered).rotations, read_csv(tmp_path, table(HEAD, *ROWS)).rotations
    )


@pytest.mark.parametrize(
    ("unit", "metres"),
    [("_cm", 0.01), ("_mm", 0.001), (" [in]", 0.0254), (" (ft)", 0.3048), ("_m", 1.0)],
)
def test_units_as_endings(tmp_path: Path, unit: str, metres: float) -> None:
    text = table(HEAD, *ROWS)
    names = [f"root.p{axis}" for axis in "xyz"]
    other = text
    for name in names:
        other = other.replace(name, name + unit)
    expected = metres * read_csv(tmp_path, text).root_position
    torch.testing.assert_close(read_csv(tmp_path, other).root_position, expected)


def test_a_frame_without_numbers_is_no_frame_only_where_times_say_so(tmp_path: Path) -> None:
    rows = (*ROWS, "," * 9, ROWS[1].replace("0.1", "0.2"))
    with pytest.raises(FileError, match="line 7: a frame without numbers, and no column 'time'"):
        read_csv(tmp_path, table(HEAD, *rows))
    timed = (f"{time},{row}" for time, row in zip(("0", "0.02", "", "0.06"), rows, strict=True))
    clip = read_csv(tmp_path, table(f"time,{HEAD}", *timed))
    assert clip.times.tolist() == pytest.approx([0.0, 0.02, 0.06])


def test_columns_in_any_order(tmp_path: Path) -> None:
    rows = [line.split(",") for line in CSV.splitlines()[3:]]
    reordered = "\n".join(",".join(reversed(row)) for row in rows)
    clip = read_csv(tmp_path, "# rate: 50\n" + reordered)
    assert clip.joint_names == ("knee", "pelvis")
    torch.testing.assert_close(clip.rotations[:, [1, 0]], read_csv(tmp_path, CSV).rotations)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("# rate: 50", "", r"neither a column 'time' nor a line '# rate: 60'; give motion\.rate"),
        ("# rate: 50", "# rate: fast", "the rate 'fast' is no number"),
        ("# rate: 50", "# rate: -1", "the rate '-1' is no number"),
        ("# loop: true", "# loop: maybe", "'# loop:' is true or false, not 'maybe'"),
        (
            "root.pz",
            "root.pw",
            "column 'root.pz' is missing; .* Rename its columns so, or add them",
        ),
        (
            "0.7,0\n",
            "nan,0\n",
            "line 6: 'nan' is not a number; fill it in from the frames around it",
        ),
        ("0.7,0\n", ",0\n", "line 6: '' is not a number; fill it in from the frames around it"),
        (
            "0,0.5,0\n0.1,0,0.9,1,0,0,0,0,0.7,0\n",
            "0,N/A,0\n0.1,0,0.9,1,0,0,0,0,,0\n",
            "line 5: 'N/A' .* remove it",
        ),
        ("0.7,0\n", "0.7o,0\n", "line 6: '0.7o' is not a number; correct it"),
        ("root.py", "root.px", "column 'root.px' is there twice"),
        ("knee.rx", "knee.rw", "column 'knee.rw' is not known.* Rename it so, or remove it"),
        ("knee.rx,", "", "joint 'knee' needs either .* and has ry, rz"),
        ("pelvis.qw", "pelvis.rx", "joint 'pelvis' needs either"),
        ("0.5,0\n", "0.5\n", "line 5: 10 numbers are needed, not 9"),
        ("0.5,0\n", "x,0\n", "line 5: 'x' is not a number"),
        ("knee.rz\n", "knee.rz\n" + "furlong," * 9 + "deg\n", "line 5: 'furlong' is not a number"),
        ("0.5,0\n", ",0\n", "line 5: '' is not a number"),
        ("0.1,0,0.9,1", "0.1,0,0.9,7", "frame 1: pelvis quaternion is not unit"),
        ("0.1,0,0.9,1,0,0,0,0,0.7,0\n", "", "at least 2 frames and this one has 1"),
    ],
)
def test_damage_of_csv_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in CSV
    with pytest.raises(FileError, match=message) as caught:
        read_csv(tmp_path, CSV.replace(old, new, 1))
    assert str(tmp_path / "clip.csv") in str(caught.value)


def test_a_table_without_a_rotation(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="no column has the root's rotation"):
        read_csv(tmp_path, "time,root.px,root.py,root.pz\n0,0,0,0\n1,0,0,0\n")
    with pytest.raises(FileError, match=r"column 'root\.px' is missing"):
        read_csv(tmp_path, "")


def test_the_licence_travels(tmp_path: Path) -> None:
    assert CsvReader().read(write_csv(tmp_path)).licence == "CC0"
    assert NpzReader().read(write_npz(tmp_path)).licence == "CC0"


@pytest.mark.parametrize("name", ["a,b", 'a"b', "a#b", " a", "", "a\nb", "=1+1", "@sum"])
def test_names_that_csv_cannot_hold(tmp_path: Path, name: str) -> None:
    clip = replace(walker(), joint_names=(name, *walker().joint_names[1:]), skeleton=None)
    with pytest.raises(FileError, match="cannot be a column"):
        CsvWriter().write(clip, tmp_path / "clip.csv")
