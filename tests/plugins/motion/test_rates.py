"""Frames per second are no seconds, and seconds no milliseconds: a clip that would last hours is asked about, whatever its
format; it was read, as a motion in extreme slow motion."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from motion_files import WRITE, amc_text, smpl_arrays, write_amc

import understudy_motion
from understudy.errors import ConfigError, FileError, UnderstudyError
from understudy.setup.registry import Registrar, Registry
from understudy_motion.reading import ReadOptions, read_clip
from understudy_motion.writers.table import NpzWriter

NAMED = "root.px,root.py,root.pz,root.qw,root.qx,root.qy,root.qz,knee.rx,knee.ry,knee.rz\n"
FRAME = "0,0,1,1,0,0,0,0.1,0,0\n"


@pytest.fixture(scope="module")
def registry() -> Registry:
    made = Registry()
    Registrar(made, "motion").tables(understudy_motion)
    return made


def table(time: str, *times: object) -> str:
    return f"{time},{NAMED}" + "".join(f"{t},{FRAME}" for t in times)


def _amc(folder: Path, rate: float) -> Path:
    path = write_amc(folder)
    path.write_text(amc_text().replace(":DEGREES", f":SAMPLES-PER-SECOND {rate}\n:DEGREES"))
    return path


def _csv(folder: Path, rate: float) -> Path:
    (folder / "a.csv").write_text(f"# rate: {rate}\n{NAMED}{FRAME * 6}")
    return folder / "a.csv"


def _robot(folder: Path, rate: float) -> Path:
    (folder / "a.csv").write_text(f"# rate: {rate}\n" + "0,0,0.8,0,0,0,1,0.1,0.2\n" * 6)
    return folder / "a.csv"


def _smpl(folder: Path, rate: float) -> Path:
    np.savez(folder / "a.npz", **{**smpl_arrays(), "mocap_framerate": rate})
    return folder / "a.npz"


def _deepmimic(folder: Path, rate: float) -> Path:
    path = WRITE["deepmimic"](folder)
    content = json.loads(path.read_text())
    for frame in content["Frames"]:
        frame[0] = 1.0 / rate
    path.write_text(json.dumps(content))
    return path


SAYS: dict[str, Callable[[Path, float], Path]] = {
    "amc": _amc, "csv": _csv, "robot": _robot, "smpl": _smpl, "deepmimic": _deepmimic,
}  # fmt: skip


@pytest.mark.parametrize("name", SAYS)
@pytest.mark.parametrize("seconds", [1 / 30, 1 / 120, 0.02])
def test_the_seconds_between_two_frames_are_no_rate(
    tmp_path: Path, registry: Registry, name: str, seconds: float
) -> None:
    """Where frames per second belong; in DeepMimic's files, where seconds belong, these are milliseconds."""
    clip = read_clip(SAYS[name](tmp_path, 1.0 / seconds), registry)
    assert clip.frame_rate == pytest.approx(1.0 / seconds, rel=1e-4)
    with pytest.raises(FileError, match=r"apart|milliseconds"):
        read_clip(SAYS[name](tmp_path, seconds), registry)


@pytest.mark.parametrize("rate", [1 / 30, 1 / 120, 0.5])
def test_nor_are_they_one_that_is_given(rate: float) -> None:
    with pytest.raises(ConfigError, match=f"the rate is {1 / rate:.4g}"):
        ReadOptions(rate=rate)
    assert ReadOptions(rate=1.0 / rate).rate


@pytest.mark.parametrize(
    ("step", "says"), [(33, "33 s apart"), (1, "1 s apart"), (33_333, "s apart"), (8.3, "8.3 s")]
)
def test_times_without_a_unit_that_are_no_seconds_are_asked_about(
    tmp_path: Path, registry: Registry, step: float, says: str
) -> None:
    path = tmp_path / "a.csv"
    path.write_text(table("time", *(step * n for n in range(6))))
    with pytest.raises(FileError, match=says):
        read_clip(path, registry)


@pytest.mark.parametrize("apart", [30.0, 1.2, 1.0])
def test_frames_that_are_seconds_apart_are_told_of(
    tmp_path: Path, registry: Registry, apart: float
) -> None:
    """Times that say that they are seconds, and of our own format, may be frames per second all the same."""
    (tmp_path / "a.csv").write_text(table("time [s]", *(apart * n for n in range(6))))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        clip = read_clip(tmp_path / "a.csv", registry)
        NpzWriter().write(clip, tmp_path / "a.npz")
        read_clip(tmp_path / "a.npz", registry)
    said = [str(one.message) for one in told]
    assert len(said) == (0 if apart == 1.0 else 2)
    for one, cure in zip(
        said, (f"motion.rate={apart:g}", "write its times in seconds"), strict=False
    ):
        assert f"its frames are {apart:g} s apart" in one
        assert cure in one


@pytest.mark.parametrize(
    ("text", "duration"),
    [
        (table("time [ms]", 0, 33, 66, 99), 0.099),
        (table("time_ms", 0, 33, 66, 99), 0.099),
        (table("time [s]", 0, 2, 4, 6), 6.0),
        (f"# units: m, s\n{table('time', 0, 2, 4, 6)}", 6.0),
        (f"# rate: 30\n{table('frame', 0, 1, 2, 3)}", 0.1),
        (table("time", 0, 0.03, 0.06, 30), 30.0),
        (table("time", 0, 5), 5.0),
    ],
    ids=["ms", "_ms", "s", "units", "numbers", "a gap", "two poses"],
)
def test_times_that_say_what_they_are(
    tmp_path: Path, registry: Registry, text: str, duration: float
) -> None:
    (tmp_path / "a.csv").write_text(text)
    assert read_clip(tmp_path / "a.csv", registry).duration == pytest.approx(duration)


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"mocap_framerate": 120.0, "fps": 30}, "two frame rates, mocap_framerate 120, fps 30"),
        ({"fps": 60.0, "mocap_time_length": 4.0}, "one frame of 2 were left; .* 30 if that"),
        ({"fps": 120.0, "mocap_time_length": 4.001}, "one frame of 4 were left"),
        ({"fps": 120.0, "mocap_time_length": 1.0}, ""),
        ({"fps": 120.0, "mocap_time_length": 2.43}, ""),  # cut, not thinned out
        ({"fps": 120.0, "mocap_time_length": "long"}, ""),
        ({"fps": 30.0, "mocap_framerate": 30}, ""),
    ],
)
def test_rates_that_contradict_what_else_is_said(
    tmp_path: Path, registry: Registry, more: dict[str, Any], says: str
) -> None:
    """Of clips of AMASS each fourth frame is kept, and the rate stays: then they are four times as fast."""
    arrays = smpl_arrays(frames=120)
    del arrays["mocap_framerate"]
    path = tmp_path / "a.npz"
    np.savez(path, **arrays, **more)
    if not says:
        assert read_clip(path, registry).frame_rate == pytest.approx(more["fps"])
        return
    with pytest.raises(UnderstudyError, match=says):
        read_clip(path, registry)
    given = read_clip(path, registry, ReadOptions(rate=30.0))
    assert given.frame_rate == pytest.approx(30.0)


@pytest.mark.parametrize("between", [False, True])
@pytest.mark.parametrize(
    ("of", "every", "asked"),
    [(1000, 4, True), (1003, 4, True), (120, 4, True), (117, 4, True), (80, 4, True), (720, 6, True),
     (2000, 20, True), (41, 2, True), (12, 4, False), (300, 1, False)],
)  # fmt: skip
def test_short_clips_that_were_thinned_out_are_asked_about(
    tmp_path: Path, registry: Registry, of: int, every: int, asked: bool, between: bool
) -> None:
    """From about four times as many frames as one of which was kept on, whichever the last one is; lengths are of frames,
    or from the first to the last."""
    arrays = smpl_arrays(frames=of)
    thinned = {k: v[::every] if np.shape(v)[:1] == (of,) else v for k, v in arrays.items()}
    thinned |= {"mocap_framerate": 120.0, "mocap_time_length": (of - between) / 120.0}
    path = tmp_path / "a.npz"
    np.savez(path, **thinned)
    if asked:
        with pytest.raises(UnderstudyError, match=rf"one frame of {every} were left"):
            read_clip(path, registry)
    else:
        assert read_clip(path, registry).frame_rate == pytest.approx(120.0)


@pytest.mark.parametrize("part", [0.3, 0.45, 0.6, 0.9])
def test_clips_that_were_cut_are_not(tmp_path: Path, registry: Registry, part: float) -> None:
    arrays = smpl_arrays(frames=100)
    arrays |= {"mocap_framerate": 120.0, "mocap_time_length": 100 / 120.0 / part}
    np.savez(tmp_path / "a.npz", **arrays)
    assert read_clip(tmp_path / "a.npz", registry).frame_rate == pytest.approx(120.0)


@pytest.mark.parametrize("name", SAYS)
@pytest.mark.parametrize("rate", [33_333.0, 8333.0 * 2, 1e6])
def test_the_microseconds_between_two_frames_are_no_rate(
    tmp_path: Path, registry: Registry, name: str, rate: float
) -> None:
    """Nor are seconds in thousands: a motion of seconds would be over in one sub-step, in silence."""
    path = SAYS[name](tmp_path, rate)
    with pytest.raises(FileError, match="nothing that moves is recorded so often"):
        read_clip(path, registry)


@pytest.mark.parametrize("name", SAYS)
def test_what_high_speed_cameras_and_motors_record_is_read(
    tmp_path: Path, registry: Registry, name: str
) -> None:
    clip = read_clip(SAYS[name](tmp_path, 2000.0), registry)
    assert clip.frame_rate == pytest.approx(2000.0)


def test_a_rate_of_microseconds_is_refused_where_it_is_given() -> None:
    with pytest.raises(ConfigError, match=r"rate=33333.* the µs between two, the rate is 30"):
        ReadOptions(rate=33_333)


def test_a_clip_of_years_is_refused(tmp_path: Path, registry: Registry) -> None:
    """Times that are no seconds, in a file that needs none said."""
    path = WRITE["npz"](tmp_path)
    with np.load(path) as arrays:
        made = dict(arrays)
    np.savez(path, **{**made, "times": 1e9 * made["times"]})
    with pytest.raises(
        FileError, match=r"it lasts .*e\+\d+ s, and nobody records longer than 100000"
    ):
        read_clip(path, registry)
