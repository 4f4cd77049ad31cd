"""What is drawn of a trial whose recording is damaged."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import forked

from understudy.command.cli import main
from understudy_diversity.peaks import Take, take_of
from understudy_diversity.strategies import GalleryOptions

FRAMES = 6
SOUND = {
    "control_dt": 0.05,
    "first_episode": 5,
    "position": np.linspace([-1.0, 1.0], [1.0, 1.5], FRAMES),
    "pitch": np.zeros(FRAMES),
    "tuck": np.zeros(FRAMES),
    "bar_height": np.ones(FRAMES),
}
#: The peak is where the jumper is highest.
HIGHEST = GalleryOptions(track="position", index=1)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = tmp_path_factory.mktemp("peaks") / "run"
    quick = ("budget.samples=256", "evaluation.episodes=2", "evaluation.final_episodes=2")
    words = ("experiment=diversity/vault", *quick, "run.video_seconds=0", f"run.dir={run}")
    assert main(["train", *words]) == 0
    return run


def taken(trained: Path, folder: Path, **changed: Any) -> Take:
    run = folder / "run"
    shutil.copytree(trained, run)
    arrays = {**SOUND, **changed}
    np.savez(run / "recording.npz", **{k: v for k, v in arrays.items() if v is not None})
    return take_of(run, folder, "take", HIGHEST)


@pytest.mark.parametrize("first", [5, 1e300, -3])
def test_a_sound_recording_is_drawn(trained: Path, tmp_path: Path, first: float) -> None:
    take = taken(trained, tmp_path, first_episode=first)
    assert take.outline is not None
    assert take.film == tmp_path / "take.mp4" or "drawn" in take.reason  # without an encoder


def test_a_film_of_nothing_is_not_taken(trained: Path, tmp_path: Path) -> None:
    """It is drawn anew, whatever is in its place."""
    made = taken(trained, tmp_path)
    if made.film is None or made.still is None:
        pytest.skip("no encoder")
    times = made.film.stat().st_atime_ns, made.film.stat().st_mtime_ns
    for file in (made.film, made.still):
        sound = file.read_bytes()
        os.truncate(file, 40 * 2**30)
        os.utime(made.film, ns=times)
        assert take_of(tmp_path / "run", tmp_path, "take", HIGHEST).film == made.film
        assert file.stat().st_size < 2**20
        file.write_bytes(sound)
        os.utime(made.film, ns=times)


@pytest.mark.parametrize(
    "changed",
    [
        {"control_dt": 0.0},
        {"control_dt": np.nan},
        {"control_dt": None},
        {"first_episode": np.nan},
        {"first_episode": np.zeros(3)},
        {"position": np.float64(1.0)},
        {"position": np.array([{}] * FRAMES)},
        {"position": np.zeros((3, 2))},
        {name: None for name in ("position", "pitch", "tuck", "bar_height")},
        {name: np.zeros((0, 2)) for name in ("position", "pitch", "tuck", "bar_height")},
    ],
)
def test_a_damaged_recording_is_none(
    trained: Path, tmp_path: Path, changed: dict[str, Any]
) -> None:
    assert taken(trained, tmp_path, **changed).reason == "Nothing was recorded of it."


@pytest.mark.parametrize("content", [None, b"", b"PK\x03\x04 and nothing more", b"no archive"])
def test_a_recording_that_is_cut_or_missing_is_none(tmp_path: Path, content: bytes | None) -> None:
    if content is not None:
        (tmp_path / "recording.npz").write_bytes(content)
    assert take_of(tmp_path, tmp_path, "a", HIGHEST).reason == "Nothing was recorded of it."


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"pitch": np.zeros((FRAMES, 3))}, "It cannot be drawn"),
        ({"tuck": None}, "It cannot be drawn"),
        ({"position": None}, "gallery.track=position was not recorded"),
        ({"control_dt": 5e-324}, "It cannot be drawn"),
    ],
)
def test_a_recording_that_cannot_be_drawn_says_why(
    trained: Path, tmp_path: Path, changed: dict[str, Any], reason: str
) -> None:
    take = taken(trained, tmp_path, **changed)
    assert take.film is None
    assert take.reason.startswith(reason)


def test_a_film_of_the_future_is_of_its_recording_alone(trained: Path, tmp_path: Path) -> None:
    """Clocks that were set do not make an older recording's film this one's."""
    take = taken(trained, tmp_path)
    if take.film is None:
        pytest.skip("no encoder")
    os.utime(take.film, (4e9, 4e9))
    stale = take.film.read_bytes()
    np.savez(tmp_path / "run" / "recording.npz", **{**SOUND, "pitch": np.ones(FRAMES)})
    again = take_of(tmp_path / "run", tmp_path, "take", HIGHEST)
    assert again.film is not None
    assert again.film.read_bytes() != stale
    kept = again.film.stat().st_ino
    assert take_of(tmp_path / "run", tmp_path, "take", HIGHEST).film is not None
    assert again.film.stat().st_ino == kept, "and it is drawn once"


def test_the_gallery_says_nothing_of_sweeps_without_its_libraries(tmp_path: Path) -> None:
    """It is asked about every sweep, and those of other loops have nothing to show in it."""
    code = (
        "import sys; assert not {'botorch', 'gpytorch', 'understudy_diversity.gallery'} & {*sys.modules}\n"
        "sys.modules.update(botorch=None, gpytorch=None)\n"
        "from understudy.setup.plugins import installed\n"
        "installed().registry.find('sweep_page', 'diversity/gallery').factory()"
    )
    done = forked(code, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
