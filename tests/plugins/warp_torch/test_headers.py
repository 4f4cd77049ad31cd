"""Warp's headers, compiled once and kept beside the kernels."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any

import pytest
import torch
import warp as wp
from warp import config

from understudy_warp_torch import headers
from understudy_warp_torch.kernels import Kernels

build = wp._src.build  # pyright: ignore


@wp.kernel(module="unique", enable_backward=False)
def _halve(numbers: wp.array(dtype=float)):  # pyright: ignore
    numbers[wp.tid()] *= 0.5


class Compiler:
    """Warp's, which makes headers where it is given none; counts that."""

    def __init__(self, makes: bool = True) -> None:
        self.made: list[str] = []
        self.makes = makes

    def __call__(self, path: str, *, pch_dir: str, use_precompiled_headers: bool) -> None:
        there = Path(pch_dir) / "builtin.pch"
        if use_precompiled_headers and not there.exists():
            time.sleep(0.05)
            self.made.append(path)
            if self.makes:
                there.write_bytes(b"compiled")


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "cache"
    folder.mkdir()
    monkeypatch.setattr(config, "kernel_cache_dir", str(folder))
    return folder


def _compile(path: Path, *names: str) -> None:
    """Each in a thread of its own, all at once."""

    def one(name: str) -> None:
        own = path / name
        own.mkdir()
        build.build_cpu(name, pch_dir=str(own), use_precompiled_headers=True)

    threads = [threading.Thread(target=one, args=(name,)) for name in names]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def _process(compiler: Compiler, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a new one."""
    monkeypatch.setattr(build, "build_cpu", compiler)
    headers.keep_headers.__wrapped__()


def test_one_thread_of_one_process_compiles_them(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiler = Compiler()
    _process(compiler, monkeypatch)
    _compile(tmp_path, "a", "b", "c")
    assert len(compiler.made) == 1
    _process(compiler, monkeypatch)
    _compile(tmp_path, "d", "e")
    assert len(compiler.made) == 1
    assert (tmp_path / "e" / "builtin.pch").read_bytes() == b"compiled"
    assert [path.name for path in cache.rglob("*.*")] == ["builtin.pch"]


def test_of_another_installation_they_are_others(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiler = Compiler()
    _process(compiler, monkeypatch)
    _compile(tmp_path, "a")
    monkeypatch.setattr(config, "version", "0.0")
    _compile(tmp_path, "b")
    assert compiler.made == ["a", "b"]


def test_where_none_can_be_made_kernels_compile_all_the_same(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiler = Compiler(makes=False)
    _process(compiler, monkeypatch)
    _compile(tmp_path, "a", "b", "c")
    assert sorted(compiler.made) == ["a", "b", "c"]
    assert not list(cache.rglob("*.*"))


def test_a_cache_that_cannot_be_written_only_takes_longer(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache.rmdir()
    cache.write_bytes(b"")  # no folder can be here
    compiler = Compiler()
    _process(compiler, monkeypatch)
    _compile(tmp_path, "a", "b")
    assert sorted(compiler.made) == ["a", "b"]


def test_warp_says_where_it_keeps_them(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Kernels(torch.device("cpu"))
    said: dict[str, Any] = {}

    def compiler(*_: Any, **named: Any) -> None:
        said.update(named)
        raise RuntimeError("said")

    monkeypatch.setattr(build, "build_cpu", compiler)
    with pytest.raises(RuntimeError, match="said"):
        wp.launch(_halve, 3, inputs=[wp.ones(3, dtype=float, device="cpu")], device="cpu")
    assert said["use_precompiled_headers"]
    assert Path(said["pch_dir"]).is_dir()
