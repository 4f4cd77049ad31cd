"""What rounding a policy's weights costs, found before it is shipped."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import miniatures
import pytest
import torch

from understudy.command.cli import main
from understudy.records import checkpoint
from understudy_skills.skill import open_skill

#: Starts so far off that none of the targets is near without going there.
FAR = (
    "initial_states.spread=[4.0,4.0]",
    "measure.distance.reduce=last",
    "evaluation.success={measure: distance, at_most: 2.9}",
)
#: In the middle of where targets are: near to all of them whatever one does.
NEAR = "initial_states.spread=[0.0,0.0]"


@pytest.fixture(scope="module")
def untrained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return trained(tmp_path_factory.mktemp("rounded") / "run")


def trained(run: Path, *words: str) -> Path:
    words = (
        "experiment=miniature/go",
        *FAR,
        *words,
        *miniatures.QUICK,
        *miniatures.AT_ONCE,
        "evaluation.seconds=2.4",
    )
    miniatures.train(*words, "budget.samples=1024", "run.video_seconds=0", f"run.dir={run}")
    return run


def with_a_weight_of(size: float, untrained: Path, folder: Path) -> Path:
    """A run whose policy goes to its target. Two rows of its middle matrix have a weight of 1, by which it goes, and one
    of `size` from a unit that is always 0."""
    shutil.copytree(untrained, folder)
    newest = checkpoint.newest(folder / "checkpoints")[0]
    state, meta = checkpoint.load(newest)
    policy = state["policy"]
    for name, value in policy.items():
        if name.startswith("actor."):
            value.zero_()
    policy["normaliser.mean"].zero_()
    policy["normaliser.variance"].fill_(1.0)
    for k in (0, 1):
        policy["actor.0.weight"][k, [k, k + 2]] = torch.tensor([0.1, -0.06])
        policy["actor.2.weight"][k, [k, 2]] = torch.tensor([1.0, size])
        policy["actor.4.weight"][k, k] = 20.0
    checkpoint.save(newest, state, meta)
    return folder


def packed(run: Path, file: Path, *words: str) -> dict[str, Any]:
    """The card, and the number format of what was written."""
    assert main(["play", str(run), *words, "--pack", str(file)]) == 0
    state, card = checkpoint.load(file)
    middle = state["policy"]["actor.2.weight"]
    kept = middle["rows"].dtype if isinstance(middle, dict) else middle.dtype
    return {**card, "kept": kept}


@pytest.mark.parametrize(
    ("size", "bits", "kept", "tried"),
    [(0.0, 8, torch.int8, 1), (300.0, 16, torch.int16, 2), (1e6, 32, torch.float32, 3)],
)
def test_as_many_bits_as_lose_nothing(
    size: float,
    bits: int,
    kept: torch.dtype,
    tried: int,
    untrained: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    run = with_a_weight_of(size, untrained, tmp_path / "run")
    capsys.readouterr()
    card = packed(run, tmp_path / "small.json")
    lines = capsys.readouterr().out.splitlines()
    assert (card["weights"]["bits"], card["kept"]) == (bits, kept)
    assert len(lines) == tried + 1
    assert [line.split(" bits")[0] for line in lines[:-1]] == ["8", "16", "32"][:tried]
    assert all("a loss beyond chance" in line for line in lines[: tried - 1])
    assert "loss beyond" not in lines[tried - 1]
    assert card["evaluation"]["episodes"] == 32, "of 8 that are asked for"
    assert card["evaluation"]["success_rate"] > 0.9
    opened, own = open_skill(str(tmp_path / "small.json")), open_skill(str(run))
    for name, value in opened.policy.items():
        torch.testing.assert_close(value, own.policy[name], rtol=0, atol=max(size, 20) / 2**bits)


def test_the_line_says_what_it_costs(
    untrained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Bits that are asked for are kept, and what they lose stands in the card."""
    run = with_a_weight_of(300.0, untrained, tmp_path / "run")
    capsys.readouterr()
    card = packed(run, tmp_path / "small.json", "--bits", "8")
    line, last = capsys.readouterr().out.splitlines()
    found = card["weights"]["compared"]
    assert card["kept"] == torch.int8
    assert (found["of"], found["starts"], found["first"]) == ("success", 32, 1.0)
    assert found["second"] == card["evaluation"]["success_rate"] < 0.8
    assert found["worse"] == round(32 * (1 - found["second"]))
    said = f"8 bits a weight: success from {found['second']:.0%} of 32 starts instead of 100% (lost {found['worse']}, won 0)"
    assert line.startswith(f"{said}, a loss beyond chance (p = ")
    assert line.endswith("It is written so, as --bits says.")
    assert last.startswith(str(tmp_path / "small.json"))


def test_easier_starts_of_the_pack_hide_nothing(untrained: Path, tmp_path: Path) -> None:
    """A pack that cannot have its run's bank begins elsewhere, and that is what its card tells of; the weights are
    compared from where the run begins."""
    run = with_a_weight_of(300.0, untrained, tmp_path / "run")
    card = packed(run, tmp_path / "eight.json", NEAR, "--bits", "8")
    assert card["evaluation"]["success_rate"] == 1.0
    assert card["weights"]["compared"]["second"] < 0.8
    assert packed(run, tmp_path / "more.json", NEAR)["kept"] == torch.int16


def test_starts_from_which_nothing_succeeds_compare_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """From too far off no bits are better than others, so the pack's starts tell."""
    hopeless = trained(tmp_path / "hopeless", "initial_states.spread=[90.0,90.0]")
    run = with_a_weight_of(300.0, hopeless, tmp_path / "run")
    capsys.readouterr()
    card = packed(run, tmp_path / "near.json", "initial_states.spread=[4.0,4.0]")
    printed = capsys.readouterr()
    assert "from the pack's starts, since from its own it has too little to lose" in printed.err
    assert "too few successes to show a loss" in printed.out.splitlines()[0]
    assert card["kept"] == torch.int16
    assert card["weights"]["compared"]["first"] > 0.9


def test_starts_that_do_not_go_with_the_rest_are_said(
    built_on: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A pack is made, of what can be compared."""
    run, bank = tmp_path / "run", built_on / "bank"
    begins = ("initial_states=bank", f"initial_states.file={bank}", *miniatures.QUICK)
    words = ("experiment=miniature/sleeve", *begins, "budget.samples=512", "run.video_seconds=0")
    miniatures.train(*words, f"run.dir={run}")
    shutil.rmtree(run / "inputs")
    capsys.readouterr()
    card = packed(run, tmp_path / "small.json", "initial_states={name: miniature/somewhere}")
    assert "from the pack's starts, since from its own it cannot be: " in capsys.readouterr().err
    assert card["weights"]["compared"]["starts"] == 32


def test_without_a_success_the_objective_is_compared(untrained: Path, tmp_path: Path) -> None:
    run = with_a_weight_of(300.0, untrained, tmp_path / "run")
    card = packed(run, tmp_path / "small.json", "evaluation.success=null", "--bits", "8")
    found = card["weights"]["compared"]
    assert found["of"] == "return"
    assert found["worse"] > 25
    assert found["second"] < 0.5 * found["first"]
    assert found["chance"] < 1e-6


def test_nothing_is_overwritten(
    untrained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The tensors are a file of their own, and may be what is named."""
    mine = tmp_path / "small.safetensors"
    mine.write_text("of another day")
    for name in ("small.json", "small", "small.safetensors"):
        assert main(["play", str(untrained), "--pack", str(tmp_path / name)]) == 2
        assert f"{mine} is there already" in capsys.readouterr().err
    assert mine.read_text() == "of another day"
    assert list(tmp_path.iterdir()) == [mine]
    words = ["--pack", str(mine), "--overwrite", "--bits", "32"]
    assert main(["play", str(untrained), *words]) == 0
    assert json.loads((tmp_path / "small.json").read_text())["digest"]
    (tmp_path / "small.json").unlink()  # as if it was killed before the card was written
    assert main(["play", str(untrained), "--pack", str(mine), "--bits", "32"]) == 0
    assert (tmp_path / "small.json").is_file()


@pytest.mark.parametrize("words", [["--bits", "8"], ["--bits", "4", "--pack", "x"]])
def test_bits_are_of_a_pack(
    words: list[str],
    untrained: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["play", str(untrained), *words]) == 2
    assert capsys.readouterr().err.count("\n") == 1
