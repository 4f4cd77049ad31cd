"""On whose terms a run is that began with another: those of everything behind that one, through any depth."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from miniatures import QUICK, train

from understudy.command.cli import main
from understudy.records import checkpoint
from understudy_credits.walk import items_of, open_made
from understudy_skills import bank

NC = {"clip": "fight", "licence": "CC BY-NC 4.0", "attribution": "Fought by Cid."}
#: In seconds; no picture.
FEW = ("budget.samples=512", *QUICK, "run.video_seconds=0")


@pytest.fixture(scope="module")
def begun(built_on: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that begins in a bank behind which is somebody's clip."""
    place = tmp_path_factory.mktemp("terms")
    (place / "ends").mkdir()
    bank.save(place / "ends" / bank.NAME, bank.load(built_on / "bank"), {"clips": [NC]})
    begins = ("initial_states=bank", f"initial_states.file={place / 'ends'}")
    train("experiment=miniature/sleeve", *begins, *FEW, f"run.dir={place / 'first'}")
    return place / "first"


def started(run: Path, folder: Path) -> Path:
    """A run that begins with the weights of `run`, and in no bank."""
    train("experiment=miniature/sleeve", f"start.run={run}", *FEW, f"run.dir={folder}")
    return folder


def terms(source: Path) -> dict[str, str]:
    return {item.what: item.licence for item in items_of(open_made(str(source)))}


def refused(source: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Commercial use of `source` is."""
    capsys.readouterr()
    assert main(["licence", str(source), "--for", "commercial"]) == 1
    assert "CC BY-NC 4.0" in capsys.readouterr().out


def test_a_start_of_a_start_has_the_terms_of_the_first_ones_bank(
    begun: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was said that nothing stands in the way."""
    own = tmp_path / "first"
    shutil.copytree(begun, own)
    second = started(own, tmp_path / "second")
    shutil.rmtree(own)
    third = started(second, tmp_path / "third")
    shutil.rmtree(second)
    assert terms(third) == {
        "code understudy": "Apache-2.0", "weights of second": "CC BY-NC 4.0", "clip fight": "CC BY-NC 4.0",
    }  # fmt: skip
    refused(third, capsys)


def test_a_start_of_a_pack_has_the_packs_terms(
    begun: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of the bank and the policies inside, whose makers have them no more; and so has a pack of that."""
    file = tmp_path / "one.json"
    assert main(["play", str(begun), "--pack", str(file)]) == 0
    assert main(["play", str(file), "--unpack", str(tmp_path / "run")]) == 0
    second = started(tmp_path / "run", tmp_path / "second")
    found = terms(second)
    assert found["weights of run"] == "CC BY-NC 4.0"
    refused(second, capsys)
    assert main(["play", str(second), "--pack", str(tmp_path / "two.json")]) == 0
    assert str(tmp_path) not in (tmp_path / "two.json").read_text(), "no folder of its makers"
    refused(tmp_path / "two.json", capsys)


def test_a_harvest_of_a_start_has_its_terms(begun: Path, tmp_path: Path) -> None:
    """The bank, and the run that left it."""
    second = started(begun, tmp_path / "second")
    words = ("job=harvest", f"job.run={second}", "job.count=4", "job.ending=any", "num_worlds=8")
    assert main(["train", *words, f"run.dir={tmp_path / 'ends'}"]) == 0
    about = checkpoint.load(tmp_path / "ends" / "bank")[1]
    assert NC in about["bank"]["clips"]
    assert terms(tmp_path / "ends")["weights of second"] == "CC BY-NC 4.0"


def test_a_start_of_policies_inside_has_their_terms(begun: Path, tmp_path: Path) -> None:
    """In sequence within the run with which another begins."""
    stages = "actuation.stages=[{run: %s, until: {field: first_distance, at_most: 0.3}, seconds: 5, reads: {offset: first_offset}}]"
    few = (*QUICK[:2], "run.video_seconds=0")
    train("experiment=miniature/in_sequence", stages % begun, *few, f"run.dir={tmp_path / 'whole'}")
    assert terms(tmp_path / "whole")["weights of first"] == "CC BY-NC 4.0"
