"""A run has copies of the files that its parts read, and reads nothing else."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from understudy.errors import RunError
from understudy.inputs import Inputs


def files(folder: Path) -> list[Path]:
    (folder / "meshes").mkdir(parents=True)
    paths = [folder / "robot.xml", folder / "meshes" / "foot.stl"]
    for path in paths:
        path.write_text(path.name)
    return paths


def kept(tmp_path: Path) -> Inputs:
    """What a run in ``run`` knows after a training that read the files of ``away``."""
    inputs = Inputs()
    paths = files(tmp_path / "away")
    assert inputs.file("scene", lambda: paths) == paths[0]
    return Inputs(tmp_path / "run", json.loads(json.dumps(inputs.copy(tmp_path / "run"))))


def never() -> list[Path]:
    raise AssertionError("the original is asked for")


def test_copies_keep_their_places_and_stand_for_the_originals(tmp_path: Path) -> None:
    inputs = kept(tmp_path)
    (tmp_path / "away" / "robot.xml").write_text("another")
    path = inputs.file("scene", never)
    assert path.is_relative_to(tmp_path / "run")
    assert path.read_text() == "robot.xml"
    assert (path.parent / "meshes" / "foot.stl").read_text() == "foot.stl"


def test_after_copying_the_originals_are_not_read_again(tmp_path: Path) -> None:
    inputs, paths = Inputs(), files(tmp_path / "away")
    inputs.file("scene", lambda: paths)
    inputs.copy(tmp_path / "run")
    assert inputs.file("scene", never).is_relative_to(tmp_path / "run")


def test_a_file_from_another_folder_is_kept_under_its_own_name(tmp_path: Path) -> None:
    one, other = files(tmp_path / "one"), files(tmp_path / "other")
    (tmp_path / "one" / "robot.xml").rename(tmp_path / "one" / "clip.amc")
    inputs = Inputs()
    inputs.file("clip", lambda: [tmp_path / "one" / "clip.amc", one[1], other[0]])
    inputs.copy(tmp_path / "run")
    assert (inputs.file("clip", never).parent / "robot.xml").read_text() == "robot.xml"


def test_what_is_asked_for_later_is_found_and_kept_beside(tmp_path: Path) -> None:
    inputs = kept(tmp_path)
    more = files(tmp_path / "more")
    more[0].write_text("more")
    assert inputs.file("other", lambda: more) == more[0]
    inputs.copy(tmp_path / "run")
    assert inputs.file("other", never).read_text() == "more"
    assert inputs.file("scene", never).read_text() == "robot.xml"


@pytest.mark.parametrize("name", ["robot.xml", "meshes/foot.stl"])
@pytest.mark.parametrize("harm", ["changed", "deleted", "linked"])
def test_a_copy_that_differs_is_refused(tmp_path: Path, name: str, harm: str) -> None:
    inputs = kept(tmp_path)
    path = inputs.file("scene", never).parent / name
    if harm == "changed":
        path.write_text("Robot.xml")
    else:
        path.unlink()
    if harm == "linked":  # to the same content, out of the folder
        path.symlink_to(tmp_path / "away" / name)
    with pytest.raises(RunError, match=f"{Path(name).name} is not what the run was made with"):
        inputs.file("scene", never)


@pytest.mark.parametrize("name", ["../away/robot.xml", "/etc/hostname", "a\0b", "\ud800"])
def test_nothing_outside_the_folder_is_read(tmp_path: Path, name: str) -> None:
    inputs = kept(tmp_path)
    digest = next(iter(inputs.kept["scene"].values()))
    with pytest.raises(RunError, match="not what the run was made with"):
        Inputs(tmp_path / "run", {"scene": {name: digest}}).file("scene", never)


def test_a_folder_is_read_where_it_is_until_its_copy_is_written(tmp_path: Path) -> None:
    def fill(copy: Path) -> None:
        (copy / "deep").mkdir(parents=True)
        (copy / "deep" / "a").write_text("weights")
        (copy / "run.json").write_text("{}")

    inputs = Inputs()
    inputs.file("scene", lambda: files(tmp_path / "away"))
    assert inputs.folder_of("skill", tmp_path / "skill", fill) == tmp_path / "skill"
    again = Inputs(tmp_path / "run", json.loads(json.dumps(inputs.copy(tmp_path / "run"))))
    for found in (inputs, again):
        copy = found.folder_of("skill", tmp_path / "skill", fill)
        assert copy.parent == tmp_path / "run"
        assert (copy / "run.json").read_text() == "{}"
        assert (copy / "deep" / "a").read_text() == "weights"
    assert sorted(file.name for file in copy.iterdir()) == ["deep", "run.json"], "and nothing else"
    (copy / "deep" / "a").write_text("others")
    with pytest.raises(RunError, match="is not what the run was made with"):
        again.folder_of("skill", tmp_path / "skill", fill)


def test_a_name_that_leads_out_and_in_again_is_refused(tmp_path: Path) -> None:
    """Where the copies are copied on, it would lead somewhere else."""
    inputs = kept(tmp_path)
    (name, digest), *_ = inputs.kept["scene"].items()
    again = Inputs(tmp_path / "run", {"scene": {f"../run/{name}": digest}})
    with pytest.raises(RunError, match="is not what the run was made with"):
        again.file("scene", never)
