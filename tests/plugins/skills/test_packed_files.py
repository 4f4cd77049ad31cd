"""Files that a task reads and that are no clips or models go along in a pack: what is written is what is read, whoever wrote it."""

from __future__ import annotations

import errno
import gc
import json
import os
import re
from pathlib import Path
from typing import Any

import pytest
import torch

from understudy.errors import ConfigError, RunError
from understudy.inputs import Inputs
from understudy.records import checkpoint, runs
from understudy_skills import pack_inputs
from understudy_skills.pack_inputs import (
    MOST_FILE_BYTES,
    MOST_FILES,
    PackInputs,
    files_as_state,
    files_of_state,
)
from understudy_skills.packing import card_of_no_folder, words_of_no_folder

ASKED = "features runs/encoder"


@pytest.fixture
def read(tmp_path: Path) -> PackInputs:
    """What gathers, and was asked for a folder of three files, a clip and a model."""
    folder = tmp_path / "encoder"
    (folder / "checkpoints").mkdir(parents=True)
    for name, content in {
        "run.json": b"{}",
        "checkpoints/1 (a).bin": b"\0\1",
        "empty": b"",
    }.items():
        (folder / name).write_bytes(content)
    inputs = PackInputs.gathering(Inputs())
    names = ("run.json", "checkpoints/1 (a).bin", "empty")
    inputs.file(ASKED, lambda: [folder / name for name in names])
    for other in ("clip walk", "motion.name=walk", "motion.skeleton=a.asf", "mjcf robot.xml"):
        inputs.file(other, lambda: [folder / "run.json"])
    return inputs


def test_files_are_read_as_they_were_written(read: PackInputs, tmp_path: Path) -> None:
    carried = read.carried()
    assert {a: list(files) for a, files in carried.items()} == {
        ASKED: ["run.json", "checkpoints/1 (a).bin", "empty"]
    }
    pack = PackInputs(files=files_of_state(files_as_state(carried)))

    def find() -> list[Path]:
        raise AssertionError("the pack has it")

    first = pack.file(ASKED, find)
    assert first.read_bytes() == b"{}"
    assert (first.parent / "checkpoints" / "1 (a).bin").read_bytes() == b"\0\1"
    assert pack.folder_of(ASKED, Path("else"), lambda folder: None) == first.parent
    again = PackInputs.gathering(pack)
    assert again.file(ASKED, find) == first
    assert again.carried() == carried, "a pack of a pack"
    kept = pack.copy(tmp_path / "run")
    assert [*kept[ASKED]] == ["1/run.json", "1/checkpoints/1 (a).bin", "1/empty"]
    assert pack.file(ASKED, find) == tmp_path / "run" / "1" / "run.json"


def test_nothing_of_it_stays_behind(read: PackInputs) -> None:
    pack = PackInputs(files=files_of_state(files_as_state(read.carried())))
    place = pack.file(ASKED, list).parents[1]
    assert place.is_dir()
    del pack
    gc.collect()
    assert not place.exists()


def test_what_a_run_keeps_is_carried_and_only_what_is_read(tmp_path: Path) -> None:
    for name in ("1/grip.json", "2/other.json"):
        (tmp_path / "inputs" / name).parent.mkdir(parents=True)
        (tmp_path / "inputs" / name).write_bytes(name.encode())
    source = Inputs()
    source.file("grip.file=a.json", lambda: [tmp_path / "inputs" / "1" / "grip.json"])
    source.file("room.file=b.json", lambda: [tmp_path / "inputs" / "2" / "other.json"])
    source.copy(tmp_path / "run")
    again = PackInputs.gathering(source)
    again.file("grip.file=a.json", list)
    assert again.carried() == {"grip.file=a.json": {"grip.json": b"1/grip.json"}}


def test_of_a_run_it_carries_nothing_of_its_makers_folders(tmp_path: Path) -> None:
    """The words that made it, its folder and the clips that it learned from are paths of somebody's."""
    home = tmp_path / "ann" / "poses"
    clip = f"{home}/clips of mine/walk, slow.txt"
    run = {
        "layout": 3,
        "config": {"job": {"clips": ["hop", clip, "lib/run"]}, "run": {"dir": str(home)}, "start": {"run": str(home)}},
        "overrides": [f"run.dir={home}"],
        "sources": {"clips": [{"clip": clip, "url": "https://a.org/b", "licence": "CC0 / MIT"}]},
        "command": ["understudy", f"run.dir={home}"],
        "machine": {"system": "Linux"},
        "inputs": {f"clip {clip}": {"1/walk.txt": "00"}},
    }  # fmt: skip
    checkpoints = home / "checkpoints"
    checkpoints.mkdir(parents=True)
    (home / "run.json").write_text(json.dumps(run))
    state = {"network": {"a": torch.arange(3.0)}, "progress": {"samples": 5}}
    checkpoint.save(checkpoints / "00000001", state, run)
    inputs, ends = PackInputs.gathering(Inputs()), (".json", ".safetensors")
    names = ["run.json", *(f"checkpoints/00000001{end}" for end in ends)]
    inputs.file(ASKED, lambda: [home / name for name in names])
    files = inputs.carried()[ASKED]
    assert not any(b"ann" in content for content in files.values())

    said = json.loads(files["run.json"])
    assert said["config"]["job"] == {"clips": ["hop", "walk, slow.txt", "lib/run"]}
    assert said["sources"]["clips"] == [{**run["sources"]["clips"][0], "clip": "walk, slow.txt"}]
    assert said["inputs"] == {"clip walk, slow.txt": {"1/walk.txt": "00"}}
    pack = PackInputs(files=files_of_state(files_as_state({ASKED: files})))
    kept = runs.open_run(pack.file(ASKED, list).parent)
    assert kept.config["run"]["dir"] is None
    found, meta = kept.newest()
    torch.testing.assert_close(found["network"]["a"], torch.arange(3.0))
    assert meta["sources"] == said["sources"]


@pytest.mark.parametrize(
    ("word", "bare"),
    [
        ("/home/me/a b.txt", "a b.txt"),
        ("~/clips/a.txt", "a.txt"),
        ("~ann/a.txt", "a.txt"),
        ("../../me/a.txt", "a.txt"),
        (r"C:\Users\me\a.txt", "a.txt"),
        ("/home/me/run/", "run"),
        ("clip /home/me/a.txt", "clip a.txt"),
        ("motion.file='/home/me/a b.txt'", "motion.file='a b.txt'"),
        ("job.clips=[hop,/home/me/a.txt,b/c]", "job.clips=[hop,a.txt,b/c]"),
        *((same, same) for same in ("runs/walk", "https://a.org/b", "CC0 / MIT", "m/s", "../", "/", "a=b/c")),
    ],
)  # fmt: skip
def test_paths_of_a_disk_are_names(word: str, bare: str) -> None:
    assert words_of_no_folder({word: [word]}) == {bare: [bare]}


@pytest.mark.parametrize("content", [b"", b"[]", b"{}", b'{"content": 1}', b"[" * 9999, b"\xff"])
def test_what_is_no_card_is_carried_as_it_is(content: bytes) -> None:
    assert card_of_no_folder("a/run.json", content) == content


def test_a_file_of_a_strange_name_gets_a_plain_one(tmp_path: Path) -> None:
    file = tmp_path / ".günther's grip?.json"
    file.write_bytes(b"{}")
    inputs = PackInputs.gathering(Inputs())
    inputs.file("grip.file=x", lambda: [file])
    carried = inputs.carried()
    assert files_of_state(files_as_state(carried)) == carried
    assert list(carried["grip.file=x"]) == ["_günther_s grip_.json"]


@pytest.mark.parametrize(
    "names",
    [("it/own?.json", "it/own!.json"), ("it/Own.json", "it/own.json"), ("a/b/c/d/e/f/g.json",) * 2],
)
def test_files_of_names_that_no_pack_can_have_are_refused(
    names: tuple[str, str], tmp_path: Path
) -> None:
    """The one took the other's place, or a pack was written that nobody could open."""
    top = tmp_path / "main.json"
    top.write_text("{}")
    files = [tmp_path / name for name in dict.fromkeys(names)]
    for file in files:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(file.name)
    inputs = PackInputs.gathering(Inputs())
    inputs.file("grip.file=x", lambda: [top, *files])
    with pytest.raises(ConfigError, match="of names that no pack can have"):
        inputs.carried()


def test_a_long_strange_name_is_carried(tmp_path: Path) -> None:
    """Its last 100 signs began with a dot."""
    file = tmp_path / f"{'a' * 90}.{'b' * 94}.json"
    file.write_text("{}")
    inputs = PackInputs.gathering(Inputs())
    inputs.file("grip.file=x", lambda: [file])
    carried = inputs.carried()
    assert files_of_state(files_as_state(carried)) == carried


def test_a_full_temporary_folder_is_said(read: PackInputs, monkeypatch: pytest.MonkeyPatch) -> None:
    pack = PackInputs(files=files_of_state(files_as_state(read.carried())))

    def full(*_: object, **__: object) -> str:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(pack_inputs.tempfile, "mkdtemp", full)
    with pytest.raises(RunError, match=r"temporary files: No space left on device\. Make room"):
        pack.file(ASKED, list)
    with pytest.raises(ConfigError, match=r"cannot be copied: No space left on device\. Make room"):
        read.carried()


def test_a_fork_that_forgets_a_pack_leaves_its_files(read: PackInputs) -> None:
    """What it has is its maker's, as that of worlds in processes of their own."""
    pack = PackInputs(files=files_of_state(files_as_state(read.carried())))
    place = pack.file(ASKED, list).parents[1]
    if not (child := os.fork()):
        del pack
        gc.collect()
        os._exit(0)
    os.waitpid(child, 0)
    assert place.is_dir()


def test_what_is_too_large_is_said(tmp_path: Path) -> None:
    (tmp_path / "mesh.obj").write_bytes(bytes(MOST_FILE_BYTES + 1))
    inputs = PackInputs.gathering(Inputs())
    inputs.file("chair.mesh=mesh.obj", lambda: [tmp_path / "mesh.obj"])
    with pytest.raises(ConfigError, match=r"16 MiB.* are chair\.mesh=mesh\.obj: pass on the run"):
        inputs.carried()


def entry(**changes: Any) -> list[dict[str, Any]]:
    content = torch.zeros(3, dtype=torch.uint8)
    return [{"asked": ASKED, "names": ["a"], "contents": [content], **changes}]


@pytest.mark.parametrize(
    "state",
    [
        "files",
        entry(asked=3),
        entry(asked="clip walk"),
        entry(asked="motion.file=walk.npz"),
        entry(asked="controller x"),
        entry(names=[], contents=[]),
        entry(names=["a", "a"], contents=[torch.zeros(1, dtype=torch.uint8)] * 2),
        entry(names=["a", "A"], contents=[torch.zeros(1, dtype=torch.uint8)] * 2),
        entry(names=["a", "a/b"], contents=[torch.zeros(1, dtype=torch.uint8)] * 2),
        entry(contents=[torch.zeros(3)]),
        entry(contents=[torch.zeros(3, 3, dtype=torch.uint8)]),
        entry(contents=["text"]),
        entry(contents=[torch.zeros(MOST_FILE_BYTES + 1, dtype=torch.uint8)]),
        entry(names=[str(k) for k in range(MOST_FILES + 1)],
              contents=[torch.zeros(1, dtype=torch.uint8)] * (MOST_FILES + 1)),
        [*entry(), *entry()],
        [{"asked": ASKED}],
    ],
)  # fmt: skip
def test_what_no_pack_has_is_refused(state: Any) -> None:
    with pytest.raises(ValueError, match=r"."):
        files_of_state(state)


@pytest.mark.parametrize(
    "name",
    ["../a", "a/../../b", "/etc/passwd", "a//b", "", ".", "..", "a/.ssh", "c:\\a", "a\\b", "a\0b", "a\nb",
     "x" * 101, "/".join("abcdefg"), 7],
)  # fmt: skip
def test_names_that_lead_elsewhere_are_refused(name: Any) -> None:
    with pytest.raises(ValueError, match=re.escape("is no name of a file in a pack")):
        files_of_state(entry(names=[name]))
