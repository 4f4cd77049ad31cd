"""Robots' own motion tables: columns of angles, which a robot's model makes a motion of."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
import torch
from robots import robot_file, robot_xml

from understudy.command.cli import main
from understudy.errors import FileError
from understudy.setup.plugins import installed
from understudy_characters.character import Character, load_character
from understudy_motion.clip import Clip, angle_names
from understudy_motion.reading import ReadOptions, UnknownFormatError, read_clip
from understudy_tensors import rotations

REGISTRY = installed().registry
FRAMES = 40


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return robot_file(tmp_path_factory.mktemp("robot"))


@pytest.fixture(scope="module")
def character(robot: Path) -> Character:
    return load_character(str(robot), REGISTRY)


def moving(character: Character) -> np.ndarray:
    """(F, nq): the robot going and turning while every hinge swings in its own way."""
    time = np.arange(FRAMES) / 30.0
    qpos = np.tile(character.model.qpos0, (FRAMES, 1))
    qpos[:, 0] += time
    qpos[:, 3], qpos[:, 6] = np.cos(time / 2), np.sin(time / 2)
    qpos[:, 7:] = 0.3 * np.sin(3.0 * time[:, None] + np.arange(qpos.shape[1] - 7))
    return qpos


def read(path: Path, **options: float | str) -> Clip:
    return read_clip(path, REGISTRY, ReadOptions(**options))  # type: ignore[arg-type]


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " ", ", ", "  "])
@pytest.mark.parametrize("scalar_first", [False, True])
def test_a_table_without_a_header(
    tmp_path: Path, character: Character, delimiter: str, scalar_first: bool
) -> None:
    qpos = moving(character)
    columns = qpos if scalar_first else qpos[:, [0, 1, 2, 4, 5, 6, 3, *range(7, qpos.shape[1])]]
    path = tmp_path / "x.csv"
    path.write_text("\n".join(delimiter.join(f"{v:.9g}" for v in row) for row in columns))
    clip = read(path)
    assert angle_names(clip) == tuple(str(n + 1) for n in range(qpos.shape[1] - 7))
    assert clip.frame_rate == pytest.approx(30.0)
    torch.testing.assert_close(character.qpos(clip), torch.from_numpy(qpos), atol=1e-6, rtol=0)
    assert read(path, rate=50.0).frame_rate == pytest.approx(50.0)
    half = character.qpos(clip, clip.times[:-1] + 0.5 / 30.0)  # as a task asks for it
    between = 0.5 * (qpos[1:] + qpos[:-1])
    np.testing.assert_allclose(half[:, 7:], between[:, 7:], atol=2e-3)


@pytest.mark.parametrize(
    ("own", "said"),
    [
        ("{}_joint", "{}_joint"),  # as robots' makers call them, and their tables' columns
        ("{}_joint", "{}"),
        ("{}_joint", "{}_joint_dof"),
        ("{}_joint", "{}_pos"),
        ("{}", "{}_joint"),
        ("robot/{}", "{}"),
        ("{}", "{:camel}"),
    ],
)
@pytest.mark.parametrize("turned", [False, True])
def test_hinges_are_known_by_other_programs_names(
    tmp_path: Path, own: str, said: str, turned: bool
) -> None:
    text = robot_xml()
    plain = load_character(str(robot_file(tmp_path)), REGISTRY)
    for name in plain.hinges:
        text = text.replace(f'"{name}"', f'"{own.format(name)}"')
    (tmp_path / "robot.xml").write_text(text)
    character = load_character(str(tmp_path / "robot.xml"), REGISTRY)
    qpos = moving(character)
    order = list(range(len(plain.hinges)))[:: -1 if turned else 1]
    names = [
        name.title().replace("_", "") if ":" in said else said.format(name) for name in plain.hinges
    ]
    head = ["x", "y", "z", "qw", "qx", "qy", "qz", *(names[n] for n in order)]
    rows = np.concatenate((qpos[:, :7], qpos[:, 7:][:, order]), axis=1)
    np.savetxt(tmp_path / "x.csv", rows, delimiter=",", header=",".join(head), comments="")
    found = character.qpos(read(tmp_path / "x.csv"))
    torch.testing.assert_close(found, torch.from_numpy(qpos), atol=1e-6, rtol=0)


@pytest.mark.parametrize("first", [0, 1])
def test_numbers_of_hinges_are_their_order(
    tmp_path: Path, character: Character, first: int
) -> None:
    qpos = moving(character)
    count = qpos.shape[1] - 7
    head = ["x", "y", "z", "qw", "qx", "qy", "qz", *(f"dof_{first + n}" for n in range(count))]
    np.savetxt(tmp_path / "x.csv", qpos, delimiter=",", header=",".join(head), comments="")
    found = character.qpos(read(tmp_path / "x.csv"))
    torch.testing.assert_close(found, torch.from_numpy(qpos), atol=1e-6, rtol=0)
    head[-1] = f"dof_{first + count}"  # one is missing
    np.savetxt(tmp_path / "x.csv", qpos, delimiter=",", header=",".join(head), comments="")
    with pytest.raises(FileError, match="give the robot's own model"):
        character.qpos(read(tmp_path / "x.csv"))


def test_blank_lines_and_delimiters_at_the_end(tmp_path: Path, character: Character) -> None:
    qpos = moving(character)
    rows = [",".join(map(str, row)) + "," for row in qpos]
    path = tmp_path / "x.csv"
    path.write_text("\n# of a robot\n\n" + "\r\n".join(rows) + "\n\n")
    assert read(path).num_frames == FRAMES


def test_decimal_commas_a_stated_rate_and_another_unit(
    tmp_path: Path, character: Character
) -> None:
    qpos = moving(character)
    path = tmp_path / "x.csv"
    for mark in ";|":
        rows = (mark.join(f"{v:.9g}" for v in row).replace(".", ",") for row in qpos)
        path.write_text("# fps: 60\n" + "\n".join(rows))
        clip = read(path)
        assert clip.frame_rate == pytest.approx(60.0)
        torch.testing.assert_close(character.qpos(clip), torch.from_numpy(qpos), atol=1e-6, rtol=0)
    qpos[:, :3] *= 1000.0
    path.write_text("\n".join(",".join(f"{v:.9g}" for v in row) for row in qpos))
    with pytest.raises(FileError, match=r"from the floor; .* motion\.unit \(--unit\), as mm"):
        read(path)
    millimetres = read_clip(path, REGISTRY, ReadOptions(unit="mm"))
    torch.testing.assert_close(millimetres.root_position, clip.root_position, atol=1e-6, rtol=0)


def test_names_above_and_times_before(tmp_path: Path, character: Character) -> None:
    qpos = moving(character)
    columns = qpos[:, [0, 1, 2, 4, 5, 6, 3, *range(7, qpos.shape[1])]]
    names = [
        "x",
        "y",
        "z",
        "qx",
        "qy",
        "qz",
        "qw",
        *(f"h{n}_joint" for n in range(columns.shape[1] - 7)),
    ]
    path = tmp_path / "x.csv"
    for first, rate in ((np.arange(FRAMES) / 50.0, 50.0), (np.arange(FRAMES), 30.0), (None, 30.0)):
        rows = columns if first is None else np.column_stack((first, columns))
        head = names if first is None else ["t", *names]
        lines = [",".join(head), *(",".join(f"{v:.9g}" for v in row) for row in rows)]
        for text in ("\n".join(lines), "\n".join(lines[1:])):
            path.write_text(text)
            clip = read(path)
            assert clip.frame_rate == pytest.approx(rate)
            np.testing.assert_allclose(clip.root_position, qpos[:, :3], atol=1e-6)
        path.write_text("\n".join(lines))
        assert (angle_names(read(path)) or ())[:2] == ("h0", "h1")


@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_units_below_the_names_and_dates_as_times(
    tmp_path: Path, character: Character, mark: str
) -> None:
    qpos = moving(character)
    rows = qpos[:, [0, 1, 2, 4, 5, 6, 3, *range(7, qpos.shape[1])]]
    hinges = rows.shape[1] - 7
    names = [
        "timestamp",
        *("x", "y", "z", "qx", "qy", "qz", "qw"),
        *character.hinges,
    ]
    units = ["", "cm", "cm", "cm", "", "", "", "", *["deg"] * hinges]
    scaled = np.column_stack((100.0 * rows[:, :3], rows[:, 3:7], np.degrees(rows[:, 7:])))
    for times in (
        [f"2024-05-01T10:00:{frame / 30:09.6f}" for frame in range(FRAMES)],
        [f"{frame / 30:.3f}" for frame in range(FRAMES)],  # rounded, of 30 frames a second
        [str(1_714_557_600_000 + round(1000 * frame / 30)) for frame in range(FRAMES)],
    ):
        lines = [mark.join((t, *map(str, row))) for t, row in zip(times, scaled, strict=True)]
        path = tmp_path / "x.csv"
        path.write_text("\n".join((mark.join(names), mark.join(units), *lines)))
        clip = read(path)
        assert clip.frame_rate == pytest.approx(30.0)
        torch.testing.assert_close(character.qpos(clip), torch.from_numpy(qpos), atol=1e-6, rtol=0)


def test_times_that_leave_frames_out_are_refused(tmp_path: Path, character: Character) -> None:
    rows = moving(character)[:, [0, 1, 2, 4, 5, 6, 3, *range(7, character.model.nq)]]
    times = np.arange(FRAMES) / 30.0
    times[FRAMES // 2 :] += 0.1
    path = tmp_path / "x.csv"
    np.savetxt(path, np.column_stack((times, rows)), delimiter=",")
    with pytest.raises(FileError, match="frame 20: the times in its first column are not even"):
        read(path)


@pytest.mark.parametrize(
    ("places", "angles", "said"), [(1.0, 57.3, "in degrees"), (100.0, 1.0, "write it in metres")]
)
def test_other_units_are_named(
    tmp_path: Path, character: Character, places: float, angles: float, said: str
) -> None:
    qpos = moving(character) + np.eye(1, character.model.nq, 2)
    qpos[:, :3] *= places
    qpos[:, 7:] *= 2.0 * angles
    path = tmp_path / "x.csv"
    path.write_text("\n".join(",".join(map(str, row)) for row in qpos))
    with pytest.raises(FileError, match=said):
        read(path)


def test_another_robots_angles(tmp_path: Path, character: Character) -> None:
    path = tmp_path / "x.csv"
    np.savetxt(path, moving(character)[:, :-1], delimiter=",")
    count = character.model.nq - 7
    with pytest.raises(
        FileError, match=f"{count - 1} angles of a robot, and robot has {count} hinges"
    ):
        character.qpos(read(path))


def test_columns_that_are_no_quaternion(tmp_path: Path, character: Character) -> None:
    qpos = moving(character)
    path = tmp_path / "x.csv"
    qpos[7, 3:7] *= 2.0
    np.savetxt(path, qpos, delimiter=",")
    with pytest.raises(FileError, match="frame 7: columns 4 to 7 are no quaternion"):
        read(path)
    qpos[0, 3:7] = 3.0
    np.savetxt(path, qpos, delimiter=",")
    with pytest.raises(UnknownFormatError):
        read(path)


def test_angles_go_on_over_a_half_turn(tmp_path: Path, character: Character) -> None:
    qpos = moving(character)
    free = next(k for k, (low, _) in enumerate(character.model.jnt_range[1:]) if low == 0.0)
    qpos[:, 7 + free] = np.linspace(0.0, 9.0, FRAMES)
    path = tmp_path / "x.csv"
    np.savetxt(path, qpos, delimiter=",")
    clip = character.posed(read(path))
    turned = clip.rotations[:, character.joint_names.index(character.joint_names[1 + 0])]
    assert rotations.angle_between(turned[1:], turned[:-1]).max() < 0.6


def in_degrees(tmp_path: Path, qpos: np.ndarray, header: str = "") -> Path:
    """A table whose hinges are in degrees."""
    rows = qpos[:, [0, 1, 2, 4, 5, 6, 3, *range(7, qpos.shape[1])]].copy()
    rows[:, 7:] = np.degrees(rows[:, 7:])
    np.savetxt(tmp_path / "x.csv", rows, delimiter=",", header=header, comments="")
    return tmp_path / "x.csv"


@pytest.mark.parametrize("swing", [0.05, 0.02, 0.01])
def test_degrees_of_hinges_that_hardly_move_are_asked_about(
    tmp_path: Path, character: Character, swing: float
) -> None:
    """They were read as radians: 2.9 degrees as 166."""
    qpos = moving(character)
    qpos[:, 7:] *= swing / 0.3
    path = in_degrees(tmp_path, qpos)
    with pytest.raises(
        FileError,
        match=r"does not say the unit of its angles, and as radians .* give motion\.angles=degrees",
    ):
        character.posed(read(path))
    clip = character.posed(read(path, angles="degrees"))
    torch.testing.assert_close(character.qpos(clip), torch.from_numpy(qpos), atol=1e-6, rtol=0)
    said = character.posed(read(path, angles="radians"))
    assert said.num_frames == FRAMES, "who says it is believed"


def test_a_name_with_a_unit_answers_for_a_table(tmp_path: Path, character: Character) -> None:
    qpos = moving(character)
    qpos[:, 7:] *= 0.1
    root = "x,y,z,qx,qy,qz,qw"
    for unit in ("deg", "rad"):
        header = ",".join([root, *(f"{name} [{unit}]" for name in character.hinges)])
        path = in_degrees(tmp_path, qpos, header)
        clip = character.posed(read(path))
        if unit == "deg":
            torch.testing.assert_close(
                character.qpos(clip), torch.from_numpy(qpos), atol=1e-6, rtol=0
            )
        with pytest.raises(
            FileError,
            match=r"it says the unit of its angles; leave motion\.angles=degrees \(--angles\) out",
        ):
            read(path, angles="degrees")


def test_one_hinge_beyond_a_turn_among_small_ones_is_asked_about(
    tmp_path: Path, character: Character
) -> None:
    """The median of all was looked at: a bent knee in degrees was read as radians where most hinges rest."""
    qpos = moving(character)
    qpos[:, 7:] *= 0.1
    qpos[:, 9] = np.radians(35.0)
    path = in_degrees(tmp_path, qpos)
    with pytest.raises(
        FileError,
        match=r"its hinge '3' turns to 35, in radians more than a turn: give motion\.angles=degrees",
    ):
        read(path)
    clip = character.posed(read(path, angles="degrees"))
    torch.testing.assert_close(character.qpos(clip), torch.from_numpy(qpos), atol=1e-6, rtol=0)


def test_radians_of_a_robot_that_keeps_its_feet_on_the_floor_are_asked_nothing(
    tmp_path: Path, character: Character
) -> None:
    """Its legs bend and its root sinks, so that only as radians its lowest point stays."""
    qpos = moving(character)
    low = character.clearance(torch.from_numpy(qpos)).amin(dim=1).numpy()
    qpos[:, 2] -= low
    np.savetxt(
        tmp_path / "x.csv", qpos[:, [0, 1, 2, 4, 5, 6, 3, *range(7, qpos.shape[1])]], delimiter=","
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        clip = character.posed(read(tmp_path / "x.csv"))
    torch.testing.assert_close(character.qpos(clip), torch.from_numpy(qpos), atol=1e-6, rtol=0)


def standing(character: Character, swing: float) -> np.ndarray:
    """(F, nq) of a robot that stays where it is, its hinges swinging by so many rad."""
    qpos = moving(character)
    qpos[:, :7] = qpos[0, :7]
    qpos[:, 7:] *= swing / 0.3
    return qpos


def table(tmp_path: Path, qpos: np.ndarray) -> Path:
    np.savetxt(
        tmp_path / "x.csv", qpos[:, [0, 1, 2, 4, 5, 6, 3, *range(7, qpos.shape[1])]], delimiter=","
    )
    return tmp_path / "x.csv"


@pytest.mark.parametrize("unit", ["degrees", "radians"])
def test_where_both_units_fit_it_is_asked(
    tmp_path: Path, character: Character, unit: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a robot that stands and whose arms swing by a degree, or a radian: one of the two was taken, with a warning."""
    qpos = standing(character, 0.9 if unit == "radians" else np.radians(0.9))
    legs = [n for n in character.hinges if "shoulder" not in n]
    qpos[:, [character.hinges[n] for n in legs]] = 0.0
    own = in_degrees(tmp_path, qpos) if unit == "degrees" else table(tmp_path, qpos)
    with pytest.raises(
        FileError,
        match=r"radians or degrees: .* give motion\.angles=degrees .* or motion\.angles=radians",
    ):
        character.posed(read(own))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        clip = character.posed(read(own, angles=unit))
    torch.testing.assert_close(character.qpos(clip), torch.from_numpy(qpos), atol=1e-6, rtol=0)
    model = robot_file(tmp_path)
    assert (
        main(
            [
                "motion",
                "check",
                str(own),
                "--character",
                str(model),
                "--fix",
                str(tmp_path / "y.npz"),
            ]
        )
        == 2
    )
    assert "--angles degrees" in capsys.readouterr().err
    assert not (tmp_path / "y.npz").exists()


def test_bent_knees_of_a_robot_on_the_floor_are_radians(
    tmp_path: Path, character: Character
) -> None:
    """As degrees its legs would be straight, and reach 9 cm into the floor."""
    qpos = standing(character, 0.02)
    for name, angle in (("hip_y", -0.4), ("knee", 0.8), ("ankle_y", -0.4)):
        qpos[:, [character.hinges[f"{side}_{name}"] for side in ("left", "right")]] += angle
    qpos[:, 2] -= character.clearance(torch.from_numpy(qpos[:1])).min().item()
    clip = character.posed(read(table(tmp_path, qpos)))
    torch.testing.assert_close(character.qpos(clip), torch.from_numpy(qpos), atol=1e-6, rtol=0)


def test_angles_that_would_turn_too_fast_as_radians_are_asked_about(
    tmp_path: Path, character: Character
) -> None:
    qpos = moving(character)
    qpos[:, 7:] = 0.0
    shoulder = character.hinges["left_shoulder_y"]
    qpos[:, shoulder] = np.where(np.arange(FRAMES) % 2, 1.2, -1.2)
    with pytest.raises(FileError, match=r"hinges turn by 72 rad/s, as degrees by 1\.3 rad/s"):
        character.posed(read(table(tmp_path, qpos)))


@pytest.mark.parametrize("swing", [0.0, 0.004])
def test_where_the_unit_makes_no_difference_nothing_is_asked(
    tmp_path: Path, character: Character, swing: float
) -> None:
    qpos = standing(character, swing)
    clip = character.posed(read(table(tmp_path, qpos)))
    torch.testing.assert_close(character.qpos(clip), torch.from_numpy(qpos), atol=1e-6, rtol=0)


def test_it_is_learned_and_checked(
    tmp_path: Path, robot: Path, character: Character, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    qpos = moving(character)
    qpos[:, 7:] = 0.0
    np.savetxt(tmp_path / "x.csv", qpos[:, [0, 1, 2, 4, 5, 6, 3, *range(7, qpos.shape[1])]], delimiter=",")  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert main(["motion", "check", "x.csv", "--character", str(robot), "--fix", "y.npz"]) in (0, 1)
    assert read(tmp_path / "y.npz").joint_names == character.joint_names
    assert main(["motion", "check", "x.csv"]) in (0, 1)
    assert "--character ROBOT.xml" in capsys.readouterr().err
    small = ["num_worlds=2", "budget.samples=8", "learner.rollout_steps=4", "learner.batch_size=4",
             "learner.minibatches=null", "learner.epochs=1", "evaluation.seconds=0.2", "run.dir=run",
             "evaluation.episodes=2", "evaluation.final_episodes=2", "run.video_seconds=0"]  # fmt: skip
    character_is = f"scene.character={robot}"
    assert (
        main(["train", "experiment=spacetime/walk", character_is, "motion.file=x.csv", *small]) == 0
    )
    assert main(["motion", "retarget", "x.csv", "humanoid", "z.npz"]) == 2
    assert "motion check x.csv --character ROBOT.xml --fix OUT.npz" in capsys.readouterr().err
