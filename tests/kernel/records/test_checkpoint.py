from __future__ import annotations

import errno
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import pytest
import torch
from safetensors.torch import load_file
from worlds import assert_same_state

from understudy.errors import RunError
from understudy.folders import write_atomically
from understudy.records import checkpoint
from understudy.records.runs import Run


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
    assert list(loaded) == list(state)


def test_mappings_keep_their_order(tmp_path: Path) -> None:
    """That of a configuration's members counts: who moves first."""
    config = {"scenes": {"person": {}, "cloth": {}}}
    checkpoint.save(tmp_path / "c", {"b": 1, "a": 2}, {"config": config})
    state, meta = checkpoint.load(tmp_path / "c")
    assert (list(state), list(meta["config"]["scenes"])) == (["b", "a"], ["person", "cloth"])


def test_same_state_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        checkpoint.save(tmp_path / name, {"x": torch.ones(3), "y": {"b": 1, "a": 2}}, {})
    for ending in (".json", ".safetensors"):
        assert (tmp_path / "a").with_suffix(ending).read_bytes() == (tmp_path / "b").with_suffix(
            ending
        ).read_bytes()


def test_large_tensors_that_are_mostly_alike_become_small(tmp_path: Path) -> None:
    """The springs of many worlds: lists of 32 places, of which a third is used. The same bits again."""
    used = torch.arange(32) < 11
    generator = torch.Generator().manual_seed(0)
    lengths = 0.2 + 0.1 * torch.rand(50, 200, 32, generator=generator)
    state = {
        "partners": torch.where(used, torch.arange(32, dtype=torch.int32), -1).expand(60, 200, 32),
        "lengths": torch.where(used, lengths, 0.0).transpose(0, 1),
        "double": torch.full((2**17,), -torch.nan, dtype=torch.float64),
        "flags": torch.zeros(2**20, dtype=torch.bool),
        "noise": torch.randn(2**18, generator=generator),
        "few": torch.zeros(2**18 - 1),
    }  # fmt: skip
    checkpoint.save(tmp_path / "x", state, {})
    loaded, _ = checkpoint.load(tmp_path / "x")
    for name, value in state.items():
        assert loaded[name].dtype == value.dtype
        assert loaded[name].shape == value.shape
        assert torch.equal(loaded[name].view(torch.uint8), value.contiguous().view(torch.uint8))
    loaded["partners"][0, 0, 0] = 7  # its own memory, to be written
    sizes = {k: v.nbytes for k, v in load_file(tmp_path / "x.safetensors").items()}
    assert sizes["partners"] < 0.03 * state["partners"].nbytes
    assert sizes["lengths"] < 0.4 * state["lengths"].nbytes
    for name in ("flags", "noise", "few"):
        assert sizes[name] == state[name].nbytes, "not worth it"


def test_an_eighth_says_what_is_not_worth_deflating(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Networks take no time for it, and lists of which half is unused are deflated."""
    deflated, compress = [], zlib.compress

    def counted(data: memoryview, level: int) -> bytes:
        deflated.append(data.nbytes)
        return compress(data, level)

    monkeypatch.setattr(zlib, "compress", counted)
    weights = torch.randn(2**20, generator=torch.Generator().manual_seed(0))
    lists = torch.cat((weights[: 2**19], torch.zeros(2**19)))
    for name, value in (("weights", weights), ("lists", lists), ("back", lists.flip(0))):
        checkpoint.save(tmp_path / name, {"x": value}, {})
        assert torch.equal(checkpoint.load(tmp_path / name)[0]["x"], value)
    assert deflated[:2] == [weights.nbytes // 8, lists.nbytes // 8]
    assert (tmp_path / "weights.safetensors").stat().st_size > weights.nbytes
    for name in ("lists", "back"):
        assert (tmp_path / f"{name}.safetensors").stat().st_size < 0.6 * lists.nbytes


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
    for name in ("00000003.json", "00000010.json"):
        (tmp_path / name).write_bytes(b"damaged")
    last = tmp_path / "00000002"
    checkpoint.save(last, {"n": 2}, {})
    checkpoint.prune(tmp_path, 2, last)
    assert checkpoint.load_newest(tmp_path)[0] == {"n": 2}, "what was just saved stays"


def test_a_name_may_have_dots(tmp_path: Path) -> None:
    checkpoint.save(tmp_path / "walk-1", {"x": 1}, {})
    checkpoint.save(tmp_path / "walk-1.5.json", {"x": 2}, {})
    for name, value in (("walk-1", 1), ("walk-1.5", 2), ("walk-1.5.safetensors", 2)):
        assert checkpoint.load(tmp_path / name)[0] == {"x": value}
    with pytest.raises(RunError, match="names no file"):
        checkpoint.save(Path("."), {}, {})


def test_deflated_tensors_of_strangers_do_not_fill_the_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each tensor stands in one place, and all of them together have a limit, which is kept when
    writing, too."""
    zeros = torch.zeros(2**19)
    checkpoint.save(tmp_path / "x", {"a": zeros, "b": zeros}, {})
    small = (tmp_path / "x.safetensors").stat().st_size
    monkeypatch.setattr(checkpoint, "_MOST", 3 * 2**20)
    with pytest.raises(RunError, match="not readable"):
        checkpoint.load(tmp_path / "x")
    checkpoint.save(tmp_path / "y", {"a": zeros, "b": zeros}, {})  # one of them as it is
    assert torch.equal(checkpoint.load(tmp_path / "y")[0]["b"], zeros)
    assert (tmp_path / "y.safetensors").stat().st_size > zeros.nbytes > 10 * small
    content = checkpoint.read_sealed(tmp_path / "y.json")
    content["state"]["map"]["b"] = content["state"]["map"]["a"]
    (tmp_path / "y.json").write_bytes(checkpoint._sealed(content))
    with pytest.raises(RunError, match="not readable"):
        checkpoint.load(tmp_path / "y")


def test_write_atomically(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    write_atomically(path, b"one")
    write_atomically(path, b"two")
    assert path.read_bytes() == b"two"
    assert [p.name for p in tmp_path.iterdir()] == ["x.json"]
    with pytest.raises(RunError, match="could not be written"):
        write_atomically(tmp_path / "nowhere/x", b"")


@pytest.mark.parametrize("kind", ["missing", "a file", "a link to itself"])
def test_what_is_no_folder_is_one_sentence(tmp_path: Path, kind: str) -> None:
    parent = tmp_path / "parent"
    if kind == "a file":
        parent.write_text("theirs")
    elif kind == "a link to itself":
        parent.symlink_to(parent)
    with pytest.raises(RunError, match="00000001 could not be written: "):
        write_atomically(parent / "00000001", b"1")
    assert kind != "a file" or parent.read_text() == "theirs"


@pytest.mark.parametrize("code", [errno.ENOSYS, errno.EINVAL, errno.EOPNOTSUPP])
def test_a_file_system_that_cannot_be_asked_to_write_at_once(
    code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.fsync", fails_with(code))
    write_atomically(tmp_path / "x", b"one")
    assert (tmp_path / "x").read_bytes() == b"one"
    monkeypatch.setattr("os.fsync", fails_with(errno.EIO))
    with pytest.raises(RunError, match="could not be written"):
        write_atomically(tmp_path / "x", b"two")


@pytest.mark.parametrize("code", [errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP])
def test_a_file_system_without_locks(
    code: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    run = Run(tmp_path, {})
    monkeypatch.setattr("fcntl.flock", fails_with(code))
    run.lock()
    assert "has no locks: start no second training in it" in capsys.readouterr().err
    run.unlock()
    monkeypatch.setattr("fcntl.flock", fails_with(errno.EIO))
    with pytest.raises(RunError, match="cannot be written"):
        run.lock()


def fails_with(code: int) -> Callable[..., NoReturn]:
    def fail(*arguments: object) -> NoReturn:
        raise OSError(code, "no")

    return fail
