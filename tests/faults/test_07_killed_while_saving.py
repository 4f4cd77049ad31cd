"""Fault 7: SIGKILL at 100 random moments of saving; the newest or the previous always loads."""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from commands import forked

from understudy.errors import RunError
from understudy.folders import write_atomically

#: Forks savers from one process that has torch imported already; kills each at a random moment.
KILLER = """
import json, os, random, signal, sys, time
import torch
torch.set_num_threads(1)
from pathlib import Path
from understudy.records import checkpoint
folder = Path(sys.argv[1]); folder.mkdir()
rng = random.Random(0)

def state(n):
    return {"n": n, "weights": torch.full((300, 500), float(n)), "more": [torch.full((1000,), float(n))] * 20}

def save_forever(n):
    while True:
        n += 1
        checkpoint.save(folder / f"{n:08d}", state(n), {"n": n})
        os.write(told, n.to_bytes(8, "little"))
        checkpoint.prune(folder, 3)

checkpoint.save(folder / "00000000", state(0), {"n": 0})
began = time.monotonic()
checkpoint.save(folder / "00000000", state(0), {"n": 0})
one_save = time.monotonic() - began
last, fallbacks, partial = 0, 0, 0
for kill in range(100):
    heard, told = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(heard)
        save_forever(last)
    os.close(told)
    time.sleep(rng.uniform(0.0, 0.02 + 3 * one_save))
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    said = os.read(heard, 1 << 20)
    os.close(heard)
    finished = int.from_bytes(said[-8:], "little") if said else last
    partial += any(folder.glob(".*.partial"))
    warned = []
    loaded, meta, path = checkpoint.load_newest(folder, warned.append)
    fallbacks += len(warned)
    n = loaded["n"]
    assert n >= finished, (n, finished)  # what was finished is never lost
    assert meta["n"] == n and (loaded["weights"] == n).all() and all((t == n).all() for t in loaded["more"])
    last = n
print(json.dumps({"last": last, "fallbacks": fallbacks, "partial": partial}))
"""


def test_hundred_kills(tmp_path: Path) -> None:
    done = forked(KILLER, str(tmp_path / "checkpoints"), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["last"] > 20, "it did save between the kills"
    assert found["partial"] > 5, "kills did fall into writes"
    assert found["fallbacks"] == 0, "not even a damaged newest one"


def test_order_of_system_calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The content is on the disk before the name is, and the name before it returns."""
    calls: list[str] = []

    def recorded(name: str, call: Callable[..., Any]) -> None:
        def wrapper(first: Any, *others: Any) -> Any:
            where = ""
            if name == "fsync":
                where = " folder" if stat.S_ISDIR(os.fstat(first).st_mode) else " file"
                assert where == " folder" or os.fstat(first).st_size == 4, "written, not buffered"
            calls.append(name + where)
            return call(first, *others)

        monkeypatch.setattr(os, name, wrapper)

    recorded("fsync", os.fsync)
    recorded("replace", os.replace)
    write_atomically(tmp_path / "file", b"data")
    assert calls == ["fsync file", "replace", "fsync folder"]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_nothing_partial_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str, error: BaseException
) -> None:
    def failing(*arguments: Any) -> None:
        raise error

    (tmp_path / "file").write_bytes(b"old")
    monkeypatch.setattr(os, call, failing)
    with pytest.raises((RunError, KeyboardInterrupt)):
        write_atomically(tmp_path / "file", b"data")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
    assert (tmp_path / "file").read_bytes() == b"old"
