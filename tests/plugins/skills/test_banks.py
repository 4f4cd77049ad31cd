"""Banks: states that one run leaves for others to begin in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from worlds import assert_same_state

from understudy.errors import FileError
from understudy.records import checkpoint
from understudy_skills import bank

STATES = {"qpos": torch.arange(12.0).view(4, 3), "qvel": torch.ones(4, 2), "phase": torch.rand(4)}


def test_round_trip(tmp_path: Path) -> None:
    """By the file, or by the folder of the run that left it."""
    bank.save(tmp_path / bank.NAME, STATES, {"run": "a"})
    for path in (tmp_path / "bank", tmp_path, str(tmp_path), tmp_path / "bank.json"):
        assert_same_state(bank.load(path), STATES)
    assert checkpoint.load(tmp_path / "bank")[1] == {"bank": {"run": "a", "of": {}}}


@pytest.mark.parametrize("ending", [".json", ".safetensors"])
@pytest.mark.parametrize("damage", ["truncated", "changed", "gone"])
def test_damaged(tmp_path: Path, ending: str, damage: str) -> None:
    bank.save(tmp_path / "bank", STATES, {})
    file = (tmp_path / "bank").with_suffix(ending)
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    if damage == "gone":
        file.unlink()
    else:
        file.write_bytes(data[:20] if damage == "truncated" else data)
    with pytest.raises(FileError, match=rf"^The bank {tmp_path / 'bank'} cannot be used: "):
        bank.load(tmp_path / "bank")


def test_missing(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(FileError, match=rf"^The bank {path} cannot be used: .*cannot be read"):
            bank.load(path)


@pytest.mark.parametrize(
    "states",
    [
        {},
        {"qpos": torch.zeros(0, 3)},
        {"qpos": torch.zeros(3, 2), "qvel": torch.zeros(2, 2)},
        {"qpos": torch.tensor(1.0)},
    ],
    ids=["nothing", "empty", "unequal", "no rows"],
)
def test_no_states(tmp_path: Path, states: dict[str, torch.Tensor]) -> None:
    bank.save(tmp_path / "bank", states, {})
    with pytest.raises(FileError, match=r"has no states, or not equally many of each field\.$"):
        bank.load(tmp_path / "bank")


@pytest.mark.parametrize(
    "state", [{"policy": {}}, {"states": 3}, {"states": {"qpos": 3}}, {"states": [1]}]
)
def test_what_is_no_bank(tmp_path: Path, state: dict[str, Any]) -> None:
    checkpoint.save(tmp_path / "bank", state, {})
    with pytest.raises(FileError, match="is no bank of states"):
        bank.load(tmp_path / "bank")


@pytest.mark.parametrize(
    "value",
    [
        torch.full((4, 2), torch.nan), torch.tensor([[0.0], [1.0], [2.0], [torch.inf]]),
        *(torch.zeros(4, 2).to(kind) for kind in (torch.complex64, torch.float8_e4m3fn, torch.uint16)),
    ],
    ids=["nan", "inf", "complex", "float8", "uint16"],
)  # fmt: skip
def test_numbers_that_no_state_has_are_refused(tmp_path: Path, value: torch.Tensor) -> None:
    """Before, episodes began there: some failed at once, and a complex number lost a part."""
    bank.save(tmp_path / "bank", {**STATES, "qvel": value}, {})
    with pytest.raises(FileError, match=r"^The bank .*bank is damaged: 'qvel' has numbers"):
        bank.load(tmp_path / "bank")
