"""Packs of policies in sequence: those that act inside come along, and whoever gets one needs nothing beside it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import torch
from miniatures import AT_ONCE, QUICK, train

from understudy.command.cli import main
from understudy.errors import RunError
from understudy.records import checkpoint
from understudy_play.player import Player
from understudy_skills.pack_inputs import PackInputs
from understudy_skills.skill import open_skill


def words(first: Path | str, second: Path | str) -> str:
    def one(run: Path | str, name: str) -> str:
        until = f"{{field: {name}_distance, at_most: 0.3}}"
        return f"{{run: {run}, until: {until}, seconds: 5, reads: {{offset: {name}_offset}}}}"

    return f"actuation.stages=[{one(first, 'first')}, {one(second, 'second')}]"


@pytest.fixture(scope="module")
def run(built_on: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of a run and a packed skill in sequence, which are gone."""
    place = tmp_path_factory.mktemp("stages")
    shutil.copytree(built_on / "sleeve", place / "first")
    assert main(["play", str(place / "first"), "--pack", str(place / "second.json")]) == 0
    few = (*AT_ONCE, "run.video_seconds=0")
    stages = words(place / "first", place / "second.json")
    train("experiment=miniature/in_sequence", stages, *few, f"run.dir={place / 'whole'}")
    for file in (place / "second.json", place / "second.safetensors"):
        file.unlink()
    shutil.rmtree(place / "first")
    return place / "whole"


@pytest.fixture(scope="module")
def packed(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("alone") / "both.json"
    assert main(["play", str(run), "--pack", str(file)]) == 0
    return file


def acted(source: str | Path) -> torch.Tensor:
    """(100, 4): what two worlds that begin alike do."""
    player = Player(open_skill(str(source)))
    rows = []
    try:
        player.environment.reset(seed=3)
        for _ in range(50):
            action = torch.zeros(player.environment.num_worlds, player.environment.action_size)
            player.environment.advance(action)
            table = player.environment.table
            rows.append(torch.cat([table["position"], table["velocity"]], dim=1).clone())
    finally:
        player.close()
    return torch.cat(rows)


def test_a_run_in_sequence_is_evaluated_for_less_time(run: Path, tmp_path: Path) -> None:
    own = tmp_path / "run"
    shutil.copytree(run, own)
    assert main(["evaluate", str(own), "episodes=4", "evaluation.seconds=1"]) == 0


def test_a_pack_acts_as_its_run_does(
    run: Path, packed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was refused: a pack had one policy."""
    wanted = acted(run)
    monkeypatch.chdir(tmp_path)
    assert wanted.abs().max() > 0.5, "it moves"
    assert torch.equal(acted(packed), wanted), "the weights inside are not rounded"
    assert str(run.parent) not in packed.read_text(), "no folder of its makers"
    stages = open_skill(str(packed)).card["config"]["actuation"]["stages"]
    assert [stage["run"] for stage in stages] == ["first", "second.json"]
    assert main(["evaluate", str(packed), "half_step=false", "episodes=32"]) == 0
    (made,) = Path("runs/skills").iterdir()
    found = json.loads((made / "evaluation-episodes-32.json").read_text())
    evaluation = open_skill(str(packed)).card["evaluation"]
    assert found["measures"] == evaluation["measures"], "what was judged is what is there"


def test_it_is_packed_and_unpacked_again(
    packed: Path, run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wanted = acted(run)
    capsys.readouterr()
    assert main(["play", str(packed), "--pack", str(tmp_path / "again.json")]) == 0
    said = capsys.readouterr().out
    assert "The pack has the policy of first, whose weights are as they are.\n" in said
    assert "The pack has the policy of second.json, whose weights are as they are.\n" in said
    assert main(["play", str(packed), "--unpack", str(tmp_path / "run")]) == 0
    assert main(["play", str(tmp_path / "run"), "--pack", str(tmp_path / "third.json")]) == 0
    shutil.rmtree(tmp_path / "run" / "tensorboard", ignore_errors=True)
    for source in ("again.json", "run", "third.json"):
        assert torch.equal(acted(tmp_path / source), wanted)


def test_another_policy_is_put_in_the_place_of_one(
    packed: Path, built_on: Path, tmp_path: Path
) -> None:
    """By an override, which the pack of a pack takes from its folder."""
    file = tmp_path / "other.json"
    given = words(built_on / "sleeve", "second.json")
    assert main(["play", str(packed), given, "--pack", str(file)]) == 0
    inputs = open_skill(str(file)).experiment.inputs
    assert isinstance(inputs, PackInputs)
    assert {*inputs.policies} == {"controller sleeve", "controller second.json"}
    assert str(built_on) not in file.read_text()
    assert main(["licence", str(file)]) == 0, "all three learned from nothing that is somebody's"


def test_controllers_of_a_hierarchy_come_along(
    built_on: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Above which a policy of its own has learned, and is rounded."""
    for name in ("go", "stop"):
        shutil.copytree(built_on / name, tmp_path / "makers" / name)
    runs = f"actuation.runs=[{tmp_path / 'makers' / 'go'},{tmp_path / 'makers' / 'stop'}]"
    small = (
        "budget.samples=256",
        *QUICK,
        *AT_ONCE,
        "run.video_seconds=0",
        f"run.dir={tmp_path / 'run'}",
    )
    train("experiment=miniature/sitting", runs, *small)
    words = ["--bits", "8", "--pack", str(tmp_path / "own" / "it.json")]
    assert main(["play", str(tmp_path / "run"), *words]) == 0
    for gone in ("makers", "run"):
        shutil.rmtree(tmp_path / gone)
    monkeypatch.chdir(tmp_path / "own")
    inputs = open_skill("it.json").experiment.inputs
    assert isinstance(inputs, PackInputs)
    assert {*inputs.policies} == {"controller go", "controller stop"}
    assert main(["evaluate", "it.json", "episodes=4", "half_step=false"]) == 0


def spoiled(packed: Path, folder: Path, states: Any, cards: Any) -> str:
    state, card = checkpoint.load(packed)
    state["policies"] = states(state["policies"]) if callable(states) else states
    card["policies"] = cards(card["policies"]) if callable(cards) else cards
    checkpoint.save(folder / "bad", state, card)
    return str(folder / "bad.json")


def same(value: Any) -> Any:
    return value


def deep(value: dict[str, Any], times: int) -> dict[str, Any]:
    """One policy within another, so many times."""
    (name, own), *_ = value.items()
    for _ in range(times):
        own = {**next(iter(value.values())), "policies": {name: own}}
    return {name: own}


@pytest.mark.parametrize(
    ("states", "cards", "said"),
    [
        (3, same, "its policies are none"),
        (same, {}, "not those of its card"),
        (same, lambda c: {name: 3 for name in c}, "a policy of it is none"),
        (lambda s: {name: [] for name in s}, same, "a policy of it is none"),
        (lambda s: {f"p{k}": s["first"] for k in range(17)}, lambda c: {f"p{k}": c["first"] for k in range(17)}, "more than 16"),
        (lambda s: deep(s, 17), lambda c: deep(c, 17), "more than 16"),
        (same, lambda c: {k: {**v, "samples": "many"} for k, v in c.items()}, "its samples are many"),
        (same, lambda c: {k: {**v, "config": 3} for k, v in c.items()}, "its config is no mapping"),
        (lambda s: {k: {**v, "policy": {"actor.0.weight": 3}} for k, v in s.items()}, same, "is no packed skill"),
        (lambda s: {k: {**v, "banks": 3} for k, v in s.items()}, same, "its banks are none"),
    ],
)  # fmt: skip
def test_a_strangers_policies_are_refused_in_a_sentence(
    states: Any, cards: Any, said: str, packed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:  # fmt: skip
    file = spoiled(packed, tmp_path, states, cards)
    with pytest.raises(RunError, match=said):
        open_skill(file)
    assert main(["play", file, "--unpack", str(tmp_path / "run")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert said in error
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.json", "bad.safetensors"]


def test_a_policy_of_other_sizes_does_not_fit(packed: Path, tmp_path: Path) -> None:
    def cut(states: dict[str, Any]) -> dict[str, Any]:
        own = states["first"]
        smaller = {k: v[:1] if v.dim() == 2 else v for k, v in own["policy"].items()}
        return {**states, "first": {**own, "policy": smaller}}

    skill = open_skill(spoiled(packed, tmp_path, cut, same))
    with pytest.raises(RunError, match="first does not fit this configuration"):
        Player(skill)
