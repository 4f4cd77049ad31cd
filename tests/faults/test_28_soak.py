"""Fault 28: nothing grows and nothing slows down; three minutes of it here, an hour by ``make soak``."""

from __future__ import annotations

import ctypes
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from soak import LIMIT, beyond, soak

from understudy.records import checkpoint


@pytest.mark.slow
def test_three_minutes() -> None:
    found = soak(3.0, ())
    for name in ("memory_mb", "threads", "descriptors"):
        assert found[name]["rise"] < LIMIT, found
    assert found["samples_per_cpu_second"]["rise"] > -LIMIT, found


def test_it_is_watched() -> None:
    """Some seconds of it, so that the long one cannot rot."""
    found = soak(0.05, ("num_worlds=16",))
    assert found["descriptors"]["rise"] == pytest.approx(0.0, abs=0.3)
    assert found["samples_per_cpu_second"]["mean"] > 0


def test_saving_gives_memory_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trimmed: list[int] = []
    libc = SimpleNamespace(malloc_trim=trimmed.append)
    monkeypatch.setattr(ctypes, "CDLL", lambda _: libc)
    checkpoint.save(tmp_path / "one", {"weights": torch.zeros(3)}, {})
    assert trimmed == [0]


@pytest.mark.parametrize(
    ("name", "rise", "bad"),
    [
        ("memory_mb", 0.06, True), ("descriptors", -0.06, True), ("threads", 0.04, False),
        ("samples_per_fixed_work", -0.06, True), ("samples_per_cpu_second", -0.06, True),
        ("samples_per_cpu_second", 0.06, False), ("samples_per_second", -0.8, False),
    ],
)  # fmt: skip
def test_what_is_beyond(name: str, rise: float, bad: bool) -> None:
    names = ("memory_mb", "threads", "descriptors", "samples_per_cpu_second", "samples_per_second",
             "samples_per_fixed_work")  # fmt: skip
    found = {other: {"rise": rise if other == name else 0.0} for other in names}
    assert beyond(found) == ([name] if bad else [])
