"""Banks in packs: whoever gets one begins where its run did, with nothing beside it."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path
from typing import Any

import miniatures
import pytest
import torch
from torch import Tensor

from understudy.command.cli import main
from understudy.errors import ConfigError, RunError
from understudy.inputs import Inputs
from understudy.records import checkpoint
from understudy_play.player import Player
from understudy_skills import bank
from understudy_skills.pack_inputs import Held, PackInputs
from understudy_skills.skill import open_skill

OWN = "initial_states={name: miniature/somewhere, drag: [0.5, 2.0]}"


@pytest.fixture(scope="module")
def run(built_on: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run whose episodes begin in the 300 states of the bank ``ends`` beside it."""
    place = tmp_path_factory.mktemp("banks")
    states = {
        name: torch.cat([value] * math.ceil(300 / len(value)))[:300]
        for name, value in bank.load(built_on / "bank").items()
    }
    (place / "ends").mkdir()
    bank.save(place / "ends" / bank.NAME, states, {})
    begins = ("initial_states=bank", f"initial_states.file={place / 'ends'}")
    small = ("budget.samples=512", *miniatures.QUICK, "run.video_seconds=0")
    miniatures.train("experiment=miniature/sleeve", *begins, *small, f"run.dir={place / 'run'}")
    return place / "run"


@pytest.fixture(scope="module")
def packed(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("packed") / "two.json"
    assert main(["play", str(run), "--pack", str(file)]) == 0
    return file


@pytest.mark.parametrize("gone", [False, True], ids=["its bank is there", "its bank is gone"])
def test_a_pack_begins_where_its_run_did(
    gone: bool, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:  # fmt: skip
    """It was refused; before that, whoever got the pack could not open it."""
    own, ends, file = tmp_path / "run", run.parent / "ends", tmp_path / "packed/two.json"
    shutil.copytree(run, own)
    aside = run.parent / "aside"
    if gone:
        ends.rename(aside)  # the run has its copy
    capsys.readouterr()
    try:
        assert main(["play", str(own), "--pack", str(file)]) == 0
        said = capsys.readouterr().out
        assert (
            f"The pack has 64 of the 300 states of the bank {ends}, drawn evenly, and is judged from these."
            in said
        )
        if not gone:
            ends.rename(aside)
        shutil.rmtree(own)
        elsewhere = tmp_path / "elsewhere"
        elsewhere.mkdir()
        monkeypatch.chdir(elsewhere)
        assert str(run.parent) not in file.read_text(), "no folder of its makers"
        opened = open_skill(str(file))
        assert opened.card["config"]["initial_states"]["file"] == "ends"
        assert main(["evaluate", str(file), "half_step=false", "episodes=32"]) == 0
        (made,) = Path("runs/skills").iterdir()
        found, packed = (
            json.loads((made / "evaluation-episodes-32.json").read_text()),
            opened.card["evaluation"],
        )
        assert found["success_rate"] == packed["success_rate"], "what was judged is what is there"
        assert found["measures"] == packed["measures"]
        held = opened.experiment.inputs
        assert isinstance(held, PackInputs)
        starts = held.banks["bank ends"].states
        player = Player(opened)
        for name in player.environment.parts.simulator.state_fields:
            first = player.environment.table[name][0]
            assert any(torch.equal(first, row) for row in starts[name][:: bank.HELD_OUT])
        player.close()
    finally:
        if aside.exists():
            aside.rename(ends)


def test_a_pack_is_packed_and_unpacked_again(
    packed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert main(["play", str(packed), "--pack", str(tmp_path / "again.json")]) == 0
    assert "The pack has all 64 states of the bank ends.\n" in capsys.readouterr().out
    before, after = (
        checkpoint.load(file)[0]["banks"] for file in (packed, tmp_path / "again.json")
    )
    assert before.keys() == after.keys() == {"ends"}
    for name, value in before["ends"]["states"].items():
        torch.testing.assert_close(after["ends"]["states"][name], value, rtol=0, atol=0)
    assert main(["play", str(packed), "--unpack", str(tmp_path / "run")]) == 0
    kept = json.loads((tmp_path / "run" / "run.json").read_text())["inputs"]
    assert sorted(kept["bank ends"]) == ["1/bank.json", "1/bank.safetensors"]
    states = bank.load(tmp_path / "run" / "inputs" / "1")
    torch.testing.assert_close(states, dict(before["ends"]["states"]), rtol=0, atol=0)


def test_other_starts_need_no_bank(
    packed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    file = tmp_path / "own.json"
    assert main(["play", str(packed), OWN, "--pack", str(file)]) == 0
    assert "from the pack's starts" not in capsys.readouterr().err, "the pack has its bank"
    state, card = checkpoint.load(file)
    assert state.keys() == {"policy"}
    assert card["weights"]["compared"]["starts"] > 1
    assert main(["play", str(file), "--unpack", str(tmp_path / "again")]) == 0


def test_what_is_drawn_is_even_and_keeps_apart_what_evaluations_have() -> None:
    inputs = PackInputs.gathering(Inputs())
    rows = torch.arange(1000)
    held = inputs.bank("bank it", lambda: Held({"row": rows, "half": 0.5 * rows}, {"half": "its"}))
    found = held.states["row"]
    assert len(held) == bank.MOST
    assert held.of == {"half": "its"}
    torch.testing.assert_close(held.states["half"], 0.5 * found)
    own = found % bank.HELD_OUT == 0
    assert own.tolist() == [k % bank.HELD_OUT == 0 for k in range(bank.MOST)]
    for part in (found[own], found[~own]):
        steps = part.diff().double()
        assert (steps - steps.mean()).abs().max() < 10
        assert part[0] < 10
        assert part[-1] > 900
    assert inputs.bank("bank it", list) is held, "it is read once"  # type: ignore[arg-type]
    few = Held({"row": torch.arange(bank.MOST)})
    assert inputs.bank("bank few", lambda: few) is few


def test_large_states_are_fewer_or_none() -> None:
    inputs = PackInputs.gathering(Inputs())
    wide = Held({"cloth": torch.zeros(100, 2**18)})  # a MiB each
    assert len(inputs.bank("bank wide", lambda: wide)) == 8
    vast = Held({"cloth": torch.zeros(3, 2**21)})
    with pytest.raises(
        ConfigError, match="a state of the bank vast has 8 MiB, too much for a pack"
    ):
        inputs.bank("bank vast", lambda: vast)


def spoiled(packed: Path, folder: Path, banks: Any) -> str:
    state, card = checkpoint.load(packed)
    checkpoint.save(folder / "bad", {**state, "banks": banks}, card)
    return str(folder / "bad.json")


def field(value: Tensor) -> dict[str, Any]:
    return {"ends": {"states": {"position": value}, "of": {}}}


@pytest.mark.parametrize(
    ("banks", "said"),
    [
        (3, "its banks are none"),
        ([], "its banks are none"),
        ({f"b{k}": {"states": {}, "of": {}} for k in range(17)}, "more than 16"),
        ({"ends": {"states": {}}}, "'ends' is no bank"),
        ({"ends": "/etc/passwd"}, "'ends' is no bank"),
        ({"ends": {"states": {}, "of": {}}}, "has no states"),
        ({"ends": {"states": {"position": [1.0]}, "of": {}}}, "no bank of states"),
        ({"ends": {"states": {"position": torch.zeros(2, 1)}, "of": {"position": 3}}}, "no bank of states"),
        (field(torch.full((2, 2), math.nan)), "not finite"),
        (field(torch.zeros(2, 2, dtype=torch.complex64)), "of a kind that no state has"),
        (field(torch.zeros(())), "has no states"),
        (field(torch.zeros(65, 2)), "65 states of 520 bytes, too many"),
        (field(torch.zeros(2, 2**21)), "2 states of 16777216 bytes, too many"),
        ({"ends": {"states": {"position": torch.zeros(2, 1), "velocity": torch.zeros(3, 1)}, "of": {}}}, "not equally many"),
    ],
)  # fmt: skip
def test_a_strangers_bank_is_refused_in_a_sentence(
    banks: Any, said: str, packed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = spoiled(packed, tmp_path, banks)
    with pytest.raises(RunError, match=rf"bad\.json is no packed skill: .*{said}"):
        open_skill(file)
    for words in (["--unpack", str(tmp_path / "run")], ["--video", str(tmp_path / "it.mp4")]):
        assert main(["play", file, *words]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert said in error
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.json", "bad.safetensors"]


def test_a_bank_of_other_states_does_not_fit(packed: Path, tmp_path: Path) -> None:
    skill = open_skill(spoiled(packed, tmp_path, field(torch.zeros(5, 7))))
    with pytest.raises(ConfigError, match="the bank ends does not fit this simulator"):
        Player(skill)


def test_names_of_banks_lead_nowhere(packed: Path, tmp_path: Path) -> None:
    """They are looked up, and files of them are numbered."""
    state, card = checkpoint.load(packed)
    name = "../../../outside"
    config = {
        **card["config"],
        "initial_states": {**card["config"]["initial_states"], "file": name},
    }
    words = [
        word.replace("initial_states.file=ends", f"initial_states.file={name}")
        for word in card["overrides"]
    ]
    banks = {name: state["banks"]["ends"]}
    checkpoint.save(
        tmp_path / "far", {**state, "banks": banks}, {**card, "config": config, "overrides": words}
    )
    before = {path for path in tmp_path.parent.rglob("*") if path.parent != tmp_path}
    assert main(["play", str(tmp_path / "far.json"), "--unpack", str(tmp_path / "run")]) == 0
    after = {
        path for path in tmp_path.parent.rglob("*") if not path.is_relative_to(tmp_path / "run")
    }
    assert after - before == {tmp_path / "far.json", tmp_path / "far.safetensors"}
    assert sorted(p.name for p in (tmp_path / "run" / "inputs").rglob("*")) == [
        "1",
        "bank.json",
        "bank.safetensors",
    ]


def test_a_run_beside_its_bank_is_still_refused(run: Path, built_on: Path) -> None:
    """As a controller of another task it is read for its policy, and not for its bank."""
    words = ["actuation=controllers", f"actuation.runs=[{built_on / 'bank'}]", "actuation.goal=2"]
    assert (built_on / "bank" / "bank.json").is_file()
    assert main(["play", str(run), *words, "--pack", str(run.parent / "no.json")]) == 2
    assert not (run.parent / "no.json").exists()
