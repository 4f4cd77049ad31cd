"""Which clip a name or a path finds."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

import understudy_motion
from understudy.errors import ConfigError, FileError
from understudy.setup.registry import Component, Registrar, Registry
from understudy_motion import library
from understudy_motion.clip import Clip
from understudy_motion.readers import deepmimic
from understudy_motion.reading import ReadOptions


def still() -> Clip:
    """Two frames of one joint that does nothing for a second."""
    one = torch.tensor([1.0, 0.0, 0.0, 0.0]).expand(2, 1, 4)
    return Clip("still", torch.tensor([0.0, 1.0]), torch.zeros(2, 3), one, ("root",), False)


def registry(**clips: Any) -> Registry:
    """What the motion plugin registers, and these generated clips."""
    made = Registry()
    Registrar(made, "motion").tables(understudy_motion)
    for name, target in clips.items():
        made.components["clip", name] = Component("clip", name, target, "tests")
    return made


GENERATED = registry(still=still)
ONE = [1, 0, 0, 0]
LYING_POSE = [0.5, 0, 0.1, 0]
for _, width in deepmimic.JOINTS:
    LYING_POSE += ONE if width == 4 else [0]
LYING = json.dumps({"Loop": "none", "Frames": [LYING_POSE, LYING_POSE]})


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A data folder with one clip in it."""
    folder = tmp_path / "motions" / "ours"
    folder.mkdir(parents=True)
    (folder / "lying.json").write_text(LYING)
    (folder / "lying_character.txt").write_text("{}")
    (folder / "README.md").write_text("no clip")
    monkeypatch.setenv(library.DATA_VARIABLE, str(tmp_path))
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    return tmp_path


def test_clips_of_the_working_folder_are_found_after_those_of_the_data_folder(data: Path) -> None:
    own = Path("motions") / "fetched"
    own.mkdir(parents=True)
    for name in ("lying", "mine"):
        (own / f"{name}.json").write_text(LYING)
    assert library.files("mine", None, GENERATED)[0] == own / "mine.json"
    assert library.files("lying", None, GENERATED)[0].is_relative_to(data / "motions" / "ours")


def test_generated_clips_are_found_by_name(data: Path) -> None:
    assert library.load("still", None, GENERATED).name == "still"


def test_files_are_found_by_stem_and_by_path(data: Path) -> None:
    path = data / "motions" / "ours" / "lying.json"
    for clip in (
        library.load("lying", None, registry()),
        library.load("still", str(path), GENERATED),
    ):
        assert clip.name == "lying"
        assert clip.source == str(path)


def test_a_generated_clip_wins_over_a_file_of_its_name(data: Path) -> None:
    assert library.load("lying", None, registry(lying=still)).source == "generated"


def test_the_first_folder_wins(data: Path) -> None:
    other = data / "motions" / "another"
    other.mkdir()
    (other / "lying.txt").write_text(LYING)
    assert library.load("lying", None, registry()).source == str(other / "lying.txt")


@pytest.mark.parametrize(
    "name", ["../lying", "ours/lying", "a\\b", "..", "/etc/passwd", "motions/../../x"]
)
def test_names_that_are_paths_are_refused(data: Path, name: str) -> None:
    with pytest.raises(FileError, match=r"not a clip's name; for a file give motion\.file=PATH"):
        library.load(name, None, GENERATED)


def test_an_unknown_name_suggests_a_near_one(data: Path) -> None:
    with pytest.raises(FileError, match=r"No motion clip 'stil'\. Did you mean 'still'"):
        library.load("stil", None, GENERATED)
    with pytest.raises(FileError, match="Did you mean 'lying'"):
        library.load("lyin", None, GENERATED)
    with pytest.raises(FileError, match="Known: lying, still"):
        library.load("zzz", None, GENERATED)
    for other in ("lying_character", "README"):
        with pytest.raises(FileError, match="No motion clip"):
            library.load(other, None, GENERATED)


@pytest.mark.parametrize("name", [None, ""])
def test_nothing_asked_for_says_what_to_give(name: str | None) -> None:
    with pytest.raises(FileError, match=r"motion\.name=NAME or motion\.file=PATH"):
        library.load(name, None, GENERATED)


def test_without_a_data_folder_only_generated_clips_are_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(library.DATA_VARIABLE, str(tmp_path / "absent"))
    assert library.data_folder() is None
    with pytest.raises(FileError, match="UNDERSTUDY_DATA"):
        library.load("lying", None, GENERATED)


def test_a_missing_file_is_named() -> None:
    with pytest.raises(FileError, match=r"absent\.txt: there is no such file"):
        library.load("walk", "absent.txt", GENERATED)


def test_parameters_are_a_generated_clips_only(data: Path) -> None:
    def lasting(*, seconds: float = 1.0) -> Clip:
        return replace(still(), times=torch.tensor([0.0, seconds]))

    known = registry(lasting=lasting)
    assert library.load("lasting", None, known).duration == 1.0
    assert library.load("lasting", None, known, {"seconds": 2}).duration == 2.0
    with pytest.raises(ConfigError, match=r"motion\.parameters has no option 'second'.*'seconds'"):
        library.load("lasting", None, known, {"second": 2})
    with pytest.raises(ConfigError, match="only generated clips have them"):
        library.load("lying", None, known, {"seconds": 2})


def test_content_that_no_reader_knows_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "lying.json"
    file.write_text("nothing of the kind")
    with pytest.raises(FileError, match=r"not a format that is read here \(.*deepmimic"):
        library.load(None, str(file), GENERATED)


@pytest.mark.parametrize("file", ["", ".", "/", "./"])
def test_a_file_without_a_name_is_none(file: str) -> None:
    """As of ``motion.file=$CLIP`` where the shell knows no CLIP: it was a traceback."""
    for asked in (library.files, library.load):
        with pytest.raises(FileError, match=r"names no file\. Give the path of a clip"):
            asked(None, file, GENERATED)


@pytest.mark.parametrize(
    "option", [{"unit": "cm"}, {"up": "y"}, {"loop": False}, {"rate": 60.0}, {"skeleton": Path("a.asf")}]
)  # fmt: skip
def test_what_a_file_leaves_unsaid_is_not_given_for_a_generated_clip(
    option: dict[str, Any],
) -> None:
    """It was ignored, in silence: the walk stayed in metres, at its rate, and looped."""
    (name,) = option
    with pytest.raises(ConfigError, match=rf"motion\.{name}=.* is of clip files, and still is"):
        library.find("still", GENERATED, ReadOptions(**option))


@pytest.mark.parametrize("named", ["file", "nothing"])
def test_a_data_folder_that_is_none_is_named(
    named: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(library.DATA_VARIABLE, str(tmp_path / named))
    said = (
        rf"No motion clip 'zebra'\..* UNDERSTUDY_DATA={tmp_path / named} is no folder\. Clip files"
    )
    with pytest.raises(FileError, match=said):
        library.load("zebra", None, registry())
