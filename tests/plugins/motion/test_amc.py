"""The AMC reader: Acclaim's conventions by hand and against scipy, damage, and CMU's own files."""

from __future__ import annotations

import math
import re
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from motion_files import ASF, amc_text, write_amc
from scipy.spatial.transform import Rotation

from understudy.errors import ConfigError, FileError
from understudy_motion import library
from understudy_motion.clip import Clip
from understudy_motion.kinematics import forward_kinematics, tip_positions
from understudy_motion.library import data_folder
from understudy_motion.readers.amc import AmcReader
from understudy_motion.reading import ReadOptions
from understudy_tensors import rotations

INCH = 0.0254
TO_WORLD = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])  # (x, y, z) -> (z, x, y)


def read(path: Path, **options: object) -> Clip:
    return AmcReader().read(path, ReadOptions(**options))  # type: ignore[arg-type]


def test_lengths_times_and_axes(tmp_path: Path) -> None:
    clip = read(write_amc(tmp_path))
    assert clip.joint_names == ("root", "lthigh", "lshin", "rhipjoint", "rthigh")
    assert clip.num_frames == 6
    assert clip.frame_rate == pytest.approx(120.0)
    assert clip.name == "small_01"
    metres = INCH / 0.45
    assert clip.root_position[2].tolist() == pytest.approx([0.0, 0.2 * metres, 17.5 * metres])
    assert clip.skeleton is not None
    assert clip.skeleton.parents == (-1, 0, 1, 0, 3)
    # A bone begins at its parent's tip: the right hip is 2 to the right, our -y.
    assert clip.skeleton.offsets[4].tolist() == pytest.approx([0.0, -2 * metres, 0.0])
    assert clip.skeleton.offsets[1].tolist() == [0.0, 0.0, 0.0]
    assert sorted(clip.skeleton.tips) == ["lshin", "rthigh"]
    assert clip.skeleton.tips["lshin"].tolist() == pytest.approx([0.0, 0.0, -7 * metres])


def test_rotations_are_acclaims(tmp_path: Path) -> None:
    """C M C^-1 with matrices of scipy; lower-case letters there are turns about fixed axes."""
    clip = read(write_amc(tmp_path))
    frame = 3
    thigh_axis = Rotation.from_euler("xyz", [10, 20, 30], degrees=True)
    right_axis = Rotation.from_euler("zyx", [-20, 0, -90], degrees=True)
    expected = {
        "root": Rotation.from_euler("xyz", [1, 8, 2], degrees=True),
        "lthigh": thigh_axis
        * Rotation.from_euler("xyz", [12.5, 3, -0.7], degrees=True)
        * thigh_axis.inv(),
        "rhipjoint": Rotation.identity(),
        "rthigh": right_axis * Rotation.from_euler("zx", [-3, 17], degrees=True) * right_axis.inv(),
    }
    for name, rotation in expected.items():
        ours = rotations.to_matrix(clip.rotations[frame, clip.joint_names.index(name)])
        theirs = TO_WORLD @ rotation.as_matrix() @ TO_WORLD.T
        np.testing.assert_allclose(ours.numpy(), theirs, atol=1e-12, err_msg=name)


def test_radians_unit_rate_and_axis(tmp_path: Path) -> None:
    path = write_amc(tmp_path)
    degrees = read(path)
    text = amc_text(2).replace(":DEGREES", ":RADIANS").replace("lshin 30", f"lshin {math.pi / 6}")
    (tmp_path / "small_02.amc").write_text(text)
    radians = read(tmp_path / "small_02.amc")
    torch.testing.assert_close(radians.rotations[0, 2], degrees.rotations[0, 2])
    assert read(path, rate=60.0).frame_rate == pytest.approx(60.0)
    assert read(path, unit="cm").root_position[0, 2] == pytest.approx(17.5 / 0.45 * 0.01)
    # As it is given for CMU's clips in BVH; it was divided by 0.45 once more.
    assert read(path, unit=0.0564).root_position[0, 2] == pytest.approx(17.5 * 0.0564)
    assert read(path, up="z").root_position[0, 1] == pytest.approx(17.5 * INCH / 0.45)
    assert read(path, loop=True).loop
    assert torch.equal(read(path, angles="degrees").rotations, degrees.rotations)
    with pytest.raises(
        FileError,
        match=r"says that its angles are in degrees; leave motion\.angles=radians \(--angles\) out",
    ):
        read(path, angles="radians")
    with pytest.raises(ConfigError, match=r"motion\.rate=0"):
        ReadOptions(rate=0.0)


#: What programs write in place of what the files here have, right of an arrow: in the AMC above, in the ASF below.
MOTIONS = r"""
:FULLY-SPECIFIED\r\n:DEGREES\r\n ->
#!OML:ASF small.ASF\r\n:FULLY-SPECIFIED\r\n:DEGREES\r\n ->
#!OML:ASF -> // OML:ASF
:DEGREES -> : degrees # of angles
:DEGREES -> :DEGREES\r\n:SAMPLES-PER-SECOND 120\r\n:FRAME-RANGE 1 6
lshin 30 -> lshin 30 # the knee
lshin 30 -> # the knee\r\nlshin 30
lshin 30 -> lshin 30\r\nrhipjoint
12.5 -> 12,5
lthigh -> LThigh
root -> ROOT
rthigh -3 17\r\nlthigh 12.5 3 -7e-001 -> lthigh 12.5 3 -7e-001\r\nrthigh -3 17
"""
SKELETONS = r"""
angle deg -> angle degrees
axis 10 20 30 XYZ -> axis 10 20 30
axis 10 20 30 XYZ -> axis 10 20 30 X Y Z
orientation 0 0 0 -> orientation 0 0 0 XYZ
dof rx ry rz -> dof rx, ry, rz
name lshin -> name "lshin"
name lshin -> name LSHIN
length 7 -> length 7,0
direction 0 -1 0\n     length 7 -> direction 0 -2 0\n     length 7
root lthigh rhipjoint -> root lthigh, rhipjoint
    root lthigh ->     ROOT lthigh
# a comment -> // a comment
"""


def changed(text: str, line: str) -> str:
    old, _, new = (part.encode().decode("unicode_escape") for part in line.partition(" ->"))
    assert old in text
    return text.replace(old, new.removeprefix(" "))


def check_same(clip: Clip, expected: Clip) -> None:
    assert [name.lower() for name in clip.joint_names] == list(expected.joint_names)
    torch.testing.assert_close(clip.root_position, expected.root_position)
    torch.testing.assert_close(clip.rotations, expected.rotations)
    assert torch.equal(clip.times, expected.times)
    assert clip.skeleton is not None
    assert expected.skeleton is not None
    np.testing.assert_allclose(clip.skeleton.offsets, expected.skeleton.offsets)


@pytest.mark.parametrize("line", MOTIONS.strip().splitlines())
def test_dialects_of_motions(tmp_path: Path, line: str) -> None:
    path = write_amc(tmp_path)
    expected = read(path)
    path.write_text(changed(amc_text(), line), newline="")
    assert AmcReader().recognises(path.read_bytes(), path)
    check_same(read(path), expected)


@pytest.mark.parametrize("line", SKELETONS.strip("\n").splitlines())
def test_dialects_of_skeletons(tmp_path: Path, line: str) -> None:
    path = write_amc(tmp_path)
    expected = read(path)
    (tmp_path / "small.asf").write_text(changed(ASF, line))
    check_same(read(path), expected)


def test_utf_16(tmp_path: Path) -> None:
    path = write_amc(tmp_path)
    expected = read(path)
    path.write_text(amc_text(), encoding="utf-16")
    (tmp_path / "small.asf").write_text(ASF, encoding="utf-16")
    assert AmcReader().recognises(path.read_bytes(), path)
    check_same(read(path), expected)


@pytest.mark.parametrize("said", [":SAMPLES-PER-SECOND 60", ":FRAMERATE 60", ":FPS: 60"])
def test_a_rate_in_the_header_counts(tmp_path: Path, said: str) -> None:
    """It was taken for CMU's, silently."""
    path = write_amc(tmp_path)
    path.write_text(amc_text().replace(":DEGREES", f"{said}\n:DEGREES"))
    assert read(path).frame_rate == pytest.approx(60.0)
    assert read(path, rate=30.0).frame_rate == pytest.approx(30.0)
    path.write_text(amc_text().replace(":DEGREES", ":SAMPLES-PER-SECOND 0\n:DEGREES"))
    with pytest.raises(FileError, match="line 3: '0' is no number of frames per second"):
        read(path)


def test_bones_may_have_freedoms_to_move_that_they_do_not_use(tmp_path: Path) -> None:
    path = write_amc(tmp_path)
    expected = read(path)
    (tmp_path / "small.asf").write_text(ASF.replace("dof rx\n", "dof tx ty tz rx l\n"))
    path.write_text(amc_text().replace("lshin 30", "lshin 0 0 0 30 0"))
    check_same(read(path), expected)
    path.write_text(
        amc_text()
        .replace("lshin 30", "lshin 0 0.1 0 30 0", 1)
        .replace("lshin 30", "lshin 0 0 0 30 0")
    )
    with pytest.raises(FileError, match="frame 0: bone 'lshin' moves against its parent"):
        read(path)


def test_which_skeleton(tmp_path: Path) -> None:
    path = write_amc(tmp_path)
    with pytest.raises(FileError, match=r"Skeleton .*none\.asf: there is no such file"):
        read(path, skeleton=tmp_path / "none.asf")
    (tmp_path / "other.asf").write_text("damaged")
    assert read(path).num_frames == 6  # by the subject's name
    (tmp_path / "small.asf").rename(tmp_path / "renamed.ASF")
    with pytest.raises(FileError, match=r"2 skeletons, but no small\.asf,.*motion\.skeleton=PATH"):
        read(path)
    assert read(path, skeleton=tmp_path / "renamed.ASF").num_frames == 6
    (tmp_path / "other.asf").unlink()
    assert read(path).num_frames == 6  # the only one
    (tmp_path / "renamed.ASF").unlink()
    with pytest.raises(
        FileError, match=r"no skeleton \(\.asf\) beside it, nor .*; give motion\.skeleton"
    ):
        read(path)


def test_the_skeletons_of_the_data_folder_serve_everywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known, here = tmp_path / "data" / "motions" / "cmu", tmp_path / "here"
    for folder in (known, here):
        folder.mkdir(parents=True)
    path = write_amc(here)
    monkeypatch.setenv(library.DATA_VARIABLE, str(tmp_path / "data"))
    (here / "small.asf").rename(known / "small.asf")
    assert read(path).num_frames == 6
    assert list(AmcReader().needs(path, ReadOptions())) == [known / "small.asf"]
    (known / "small.asf").rename(known / "other.asf")
    with pytest.raises(FileError, match="no skeleton"):
        read(path)


def test_a_skeleton_alone_has_no_motion(tmp_path: Path) -> None:
    write_amc(tmp_path)
    path = tmp_path / "small.asf"
    assert AmcReader().recognises(path.read_bytes()[:4096], path)
    with pytest.raises(FileError, match=r"a skeleton \(ASF\) without a motion; give the AMC"):
        read(path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("lshin 30", "lshin", "line 8: 'lshin' and 1 finite number are expected"),
        ("lshin 30", "lshin 30 40", "line 8: 'lshin' and 1"),
        ("lshin 30", "lshin nan", "line 8: 'lshin' and 1"),
        ("lshin 30", "lshin 1e400", "line 8: 'lshin' and 1"),
        ("lshin 30", "lshin 3_0", "line 8: 'lshin' and 1"),
        ("lshin 30", "knee 30", "'knee' in its first frame is not one of the moving bones"),
        ("lshin 30", "rhipjoint 30", "'rhipjoint' in its first frame is not one of the moving"),
        ("lshin 30", "root 1 2 3 4 5 6", "'root' is listed twice in its first frame"),
        ("lshin 30\r\n", "", "its first frame has no 'lshin'"),
        ("2\r\nroot", "3\r\nroot", "line 9: the number 2 of a frame is expected, not '3'"),
        ("3\r\nroot", "root", "line 14: the number 3 of a frame is expected, not 'root"),
        ("1\r\nroot", "x\r\nroot", "line 4: 'x' is no AMC header"),
        (":DEGREES", ":DEGREES\n:RADIANS", "line 4: it says both :DEGREES and :RADIANS"),
        (":DEGREES", ":FPS 60\n:FPS 30", "line 4: it says both 60 and 30 frames per second"),
    ],
)
def test_damage_of_the_motion_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = write_amc(tmp_path)
    text = amc_text()
    assert old in text
    path.write_text(text.replace(old, new, 1), newline="")
    with pytest.raises(FileError, match=message) as caught:
        read(path)
    assert str(path) in str(caught.value)


def test_a_last_frame_that_is_cut_off(tmp_path: Path) -> None:
    path = write_amc(tmp_path)
    path.write_text(amc_text().removesuffix("lshin 30\r\n"))
    with pytest.raises(FileError, match="its last frame is incomplete"):
        read(path)
    path.write_text(amc_text(1))
    with pytest.raises(FileError, match="at least 2 frames"):
        read(path)
    path.write_text(":FULLY-SPECIFIED\n")
    with pytest.raises(FileError, match="has no frames"):
        read(path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("length 0.45", "length 0", "line 6: the unit of length"),
        ("length 0.45", "length", "line 6: 'length' needs 1 finite number"),
        ("angle deg", "angle turns", "line 7: the unit of angle is"),
        ("order TX", "order WX", "line 9: 'wx' is not a freedom"),
        ("axis XYZ", "axis XXY", "line 10: 'XXY' is not an order of the axes"),
        ("name lshin", "name lthigh", "a bone's name must be one word that no other bone has"),
        ("direction 0 -1 0", "direction 0 -1", "'direction' needs 3 finite numbers"),
        ("dof rx\n", "dof rx rw\n", "'rw' is not a freedom that is read"),
        ("dof rx\n", "dof rx rx\n", "a freedom is listed twice"),
        ("    lthigh lshin\n", "", "bone 'lshin' does not hang on the root"),
        ("    lthigh lshin\n", "    lthigh knee\n", "'knee' is not a bone of this skeleton"),
        ("    lthigh lshin\n", "    lthigh lshin rthigh\n", "'rthigh' hangs on two bones"),
        ("    root lthigh", "    lshin lthigh", "does not hang on the root"),
        ("  end\n  begin\n     id 2", "  end\n     id 2", "'begin' is expected"),
        ("     length 7\n", "     length -7\n", "a bone's length must be 0 or above"),
        ("     length 7\n", "", "bone 'lshin' ends that has no length"),
        ("     length 7\n", "     length 7\n     length 8\n", "'length' is said twice of a bone"),
        (
            "     name lthigh\n",
            "     name lthigh\n     name thigh\n",
            "'name' is said twice of a bone",
        ),
        ("     name lthigh\n", "", "a bone ends that has no name"),
        ("     direction 0 -1 0\n", "", "ends that has no direction"),
        (
            "     direction 0 -1 0\n",
            "     direction 0 0 0\n",
            "has a length, and its direction is 0 0 0",
        ),
        (
            "  end\n  begin\n     id 2\n     name lshin\n",
            "  begin\n     id 2\n",
            "ends that has no name",
        ),
        ("length 0.45", "length 0.45\n  length 1", "line 7: 'length' is said twice in :units"),
        ("order TX TY TZ RX RY RZ\n", "", "section :root has no 'order'"),
        (":root\n", ":trunk\n", "is no ASF: it has no section :root"),
        (":bonedata\n", ":bones\n", "is no ASF: it has no section :bonedata"),
    ],
)
def test_damage_of_the_skeleton_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = write_amc(tmp_path)
    assert old in ASF
    (tmp_path / "small.asf").write_text(ASF.replace(old, new, 1))
    with pytest.raises(FileError, match=message) as caught:
        read(path)
    assert "small.asf" in str(caught.value)


def test_a_skeletons_sections_may_come_in_any_order(tmp_path: Path) -> None:
    path = write_amc(tmp_path)
    expected = read(path)
    head, bones = ASF.split(":bonedata")
    bones, hierarchy = bones.split(":hierarchy")
    (tmp_path / "small.asf").write_text(f"{head}:hierarchy{hierarchy}:bonedata{bones}")
    check_same(read(path), expected)


def long_clip(folder: Path, minutes: float) -> tuple[Path, int]:
    """A clip of 29 moving bones at 120 frames/s, as large as CMU's."""
    bones = [f"bone{i}" for i in range(28)]
    data = "".join(
        f"begin\nname {b}\ndirection 0 -1 0\nlength 20\naxis 0 0 20 XYZ\ndof rx ry rz\nend\n"
        for b in bones
    )
    head, _, _ = ASF.partition("  begin\n")
    (folder / "long.asf").write_text(
        head + data + ":hierarchy\nbegin\nroot " + " ".join(bones) + "\nend\n"
    )
    count = int(minutes * 7200)
    rows = "\n".join(f"{b} 12.3456 -7.89012 0.333333" for b in bones)
    frames = [f"{i}\nroot 1 2 3 4 5 6\n{rows}\n" for i in range(1, count + 1)]
    path = folder / "long_01.amc"
    path.write_text(":FULLY-SPECIFIED\n:DEGREES\n" + "".join(frames))
    return path, count


@pytest.mark.parametrize(
    ("minutes", "seconds"), [(1.0, 5.0), pytest.param(10.0, 15.0, marks=pytest.mark.slow)]
)
def test_ten_minutes_are_read_in_seconds(tmp_path: Path, minutes: float, seconds: float) -> None:
    path, count = long_clip(tmp_path, minutes)
    began = time.perf_counter()
    assert read(path).num_frames == count
    assert time.perf_counter() - began < seconds


def recorded(stem: str) -> Path | None:
    folder = library.data_folder()
    path = folder / "motions" / "cmu" / f"{stem}.amc" if folder else None
    return path if path is not None and path.is_file() else None


needs_cmu = pytest.mark.skipif(
    recorded("02_01") is None, reason="no recorded clips: UNDERSTUDY_DATA is not set"
)


@needs_cmu
def test_a_recorded_walk_stands_on_its_feet() -> None:
    """CMU 02_01: a person of adult size walks forward, feet on the floor, left where left is."""
    path = recorded("02_01")
    assert path is not None
    clip = read(path)
    positions, world = forward_kinematics(clip)
    tips = tip_positions(clip, positions, world)
    joint = {name: positions[:, i] for i, name in enumerate(clip.joint_names)}
    assert clip.skeleton is not None
    tip = {name: tips[:, i] for i, name in enumerate(clip.skeleton.tips)}

    toes = torch.stack((tip["ltoes"], tip["rtoes"]))
    lowest = toes[..., 2].amin(dim=0)
    assert lowest.min() > -0.03
    assert lowest.max() < 0.08  # one foot at least is on the floor at any time
    height = tip["head"][:, 2] - lowest
    assert 1.45 < height.median() < 1.9

    # Feet on the floor do not slide: whichever toe is lowest nearly stands still.
    speeds = 120.0 * toes.diff(dim=1)[..., :2].norm(dim=-1)
    assert speeds.amin(dim=0).median() < 0.3
    assert speeds.amax(dim=0).median() > 1.0

    travel = clip.root_position[-1] - clip.root_position[0]
    forward = rotations.rotate(
        rotations.heading_rotation(clip.rotations[:, 0]),
        torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64),
    ).mean(dim=0)
    assert (travel[:2] @ forward[:2]) / travel[:2].norm() > 0.9
    left = torch.tensor([-forward[1], forward[0], 0.0], dtype=torch.float64)
    for part in ("femur", "tibia", "foot", "humerus", "hand"):  # feet come close in passing
        assert ((joint[f"l{part}"] - joint[f"r{part}"]) @ left).mean() > 0.05, part
    # Knees bend backwards: the knee lies in front of the line from hip to ankle.
    knee = joint["ltibia"] - 0.5 * (joint["lfemur"] + joint["lfoot"])
    assert (knee @ forward).mean() > 0.01


@needs_cmu
def test_the_same_take_by_another_route() -> None:
    """DeepMimic's layout of CMU 02_01, converted by its authors, bends the knees at the same times."""
    path = recorded("02_01")
    assert path is not None
    other = path.parents[1] / "pose_manifold" / "02_01.txt"
    if not other.is_file():
        pytest.skip("the converted take is not here")
    from understudy_motion.clip import sample
    from understudy_motion.readers.deepmimic import DeepMimicReader

    ours, theirs = read(path), DeepMimicReader().read(other)
    assert theirs.duration == pytest.approx(ours.duration, rel=0.05)
    _, at = sample(ours, theirs.times)
    for side in ("right", "left"):
        mine = at[:, ours.joint_names.index(f"{side[0]}tibia")]
        given = theirs.rotations[:, theirs.joint_names.index(f"{side}_knee")]
        one = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
        bends = torch.stack([rotations.angle_between(q, one.expand_as(q)) for q in (mine, given)])
        assert torch.corrcoef(bends)[0, 1] > 0.95


@pytest.mark.parametrize("name", ["01_01", "02_01", "03_01"])
def test_files_that_leave_units_open(tmp_path: Path, name: str) -> None:
    """Without :units the figure was 0.7 m tall, silently; and without a header radians were degrees."""
    asf, amc = (tmp_path / f"{name[:2]}.asf", tmp_path / f"{name}.amc")
    folder = data_folder()
    if folder is None or not (folder / "motions" / "cmu" / amc.name).exists():
        pytest.skip("clips of CMU are not here")
    own = folder / "motions" / "cmu"
    skeleton, motion = (own / asf.name).read_text(), (own / amc.name).read_text()
    expected = read(own / amc.name)
    bare = re.sub(r":units\n(\s+.*\n)+?(?=:)", "", skeleton)
    assert ":units" in skeleton
    assert ":units" not in bare
    headless = re.sub(r"^[#:].*\n", "", motion, flags=re.MULTILINE)

    def radians(match: re.Match[str]) -> str:
        bone, *values = match[0].split()
        kept = values[:3] if bone == "root" else []
        turned = [f"{math.radians(float(value)):.7f}" for value in values[len(kept) :]]
        return " ".join([bone, *kept, *turned])

    turned = re.sub(r"^[a-z]+ .*$", radians, headless, flags=re.MULTILINE)
    said = skeleton.replace("angle deg", "angle rad")
    axes = re.sub(
        r"^(\s*axis|\s*orientation)((?: \S+){3})",
        lambda m: m[1] + "".join(f" {math.radians(float(v)):.8f}" for v in m[2].split()),
        said,
        flags=re.MULTILINE,
    )
    for figure, frames in ((bare, motion), (bare, headless), (bare, turned), (axes, turned)):
        asf.write_text(figure)
        amc.write_text(frames)
        clip = read(amc)
        torch.testing.assert_close(clip.root_position, expected.root_position, atol=1e-5, rtol=0)
        alike = (clip.rotations * expected.rotations).sum(dim=-1).abs()
        assert alike.min() == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize(
    ("length", "size"), [("9.0", r"0\.0\d+"), ("0.009", r"\d\d(\.\d)?"), ("1e6", r"\d\.?\d*e-07")]
)
def test_a_figure_of_no_bodys_size_is_no_unit(tmp_path: Path, length: str, size: str) -> None:
    path = write_amc(tmp_path)
    (tmp_path / "small.asf").write_text(ASF.replace("  length 0.45\n", f"  length {length}\n"))
    number = re.escape(f"{float(length):g}")
    said = rf"section :units \(inches divided by {number}\) the figure is {size} m from end to end, .*0\.4 to 3 m.*inch if"
    with pytest.raises(FileError, match=said):
        read(path)
    # Whoever gives it means it; a number is the metres in one of the file's own.
    for unit, metres in (("inch", INCH / float(length)), (2.5, 2.5)):
        height = read(path, unit=unit).root_position[0, 2]
        assert height == pytest.approx(17.5 * metres)


def test_a_unit_that_nothing_shows_is_asked_for(tmp_path: Path) -> None:
    path = write_amc(tmp_path)
    skeleton = tmp_path / "small.asf"
    skeleton.write_text(ASF.replace("  length 0.45\n", ""))
    with pytest.raises(FileError, match=r"no section :units.*give motion\.unit"):
        read(path)
    assert read(path, unit="cm").root_position[0, 2] == pytest.approx(0.175)
