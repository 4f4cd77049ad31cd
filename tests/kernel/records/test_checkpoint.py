from __future__ import annotations

from pathlib import Path

import pytest
import torch
from worlds import assert_same_state

from understudy.errors import RunError
from understudy.records import checkpoint


def test_round_trip(tmp_path: Path) -> None:
    base = torch.arange(6.0).view(2, 3)
    state = {
        "double": torch.tensor([1.1], dtype=torch.float64), "int": torch.tensor([2**62]), "bool": torch.tensor([True]),
        "empty": torch.zeros(0, 3), "scalar": torch.tensor(2.5), "column": base[:, 1], "shared": [base, base],
        "nan": float("nan"), "inf": -float("inf"), "n": 3, "none": None, "text": "ä→b", "yes": True,
        "nested": {"a": {"b/c": 1, "": torch.ones(1)}}, "nothing": {}, "list": [], "grad": torch.ones(2, requires_grad=True),
    }  # fmt: skip
    checkpoint.save(tmp_path / "00000001", state, {"config": {"x": [1, None]}})
    loaded, meta = checkpoint.load(tmp_path / "00000001.json")
    assert meta == {"config": {"x": [1, None]}}
    assert loaded.pop("nan") != loaded.get("nan")
    state.pop("nan")
    assert_same_state(loaded, state)
    assert loaded["double"].dtype == torch.float64
    assert list(loaded) == sorted(loaded)


def test_same_state_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        checkpoint.save(tmp_path / name, {"x": torch.ones(3), "y": {"b": 1, "a": 2}}, {})
    for ending in (".json", ".safetensors"):
        assert (tmp_path / "a").with_suffix(ending).read_bytes() == (tmp_path / "b").with_suffix(
            ending
        ).read_bytes()


def test_newest_and_prune(tmp_path: Path) -> None:
    for n in (1, 2, 10, 3):
        checkpoint.save(tmp_path / f"{n:08d}", {"n": n}, {})
    (tmp_path / "00000099.safetensors").write_bytes(b"left by a crash")
    (tmp_path / ".00000099.json.1.partial").write_bytes(b"left by a crash")
    assert [int(p.name) for p in checkpoint.newest(tmp_path)] == [10, 3, 2, 1]
    checkpoint.prune(tmp_path, 2)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "00000003.json", "00000003.safetensors", "00000010.json", "00000010.safetensors",
    ]  # fmt: skip
    assert checkpoint.load_newest(tmp_path)[0] == {"n": 10}


def test_write_atomically(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    checkpoint.write_atomically(path, b"one")
    checkpoint.write_atomically(path, b"two")
    assert path.read_bytes() == b"two"
    assert [p.name for p in tmp_path.iterdir()] == ["x.json"]
    with pytest.raises(RunError, match="could not be written"):
        checkpoint.write_atomically(tmp_path / "nowhere/x", b"")
