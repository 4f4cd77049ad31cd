"""Warp's kernels among torch's operations."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

import understudy_warp_torch.kernels as kernels


def test_rows_are_put_in_place_and_only_where_asked() -> None:
    view = torch.zeros(3, 2)
    kept = view
    kernels.put_rows(view, torch.tensor([True, False, True]), torch.tensor([[1.0, 2.0]]))
    assert kept.tolist() == [[1, 2], [0, 0], [1, 2]]


def test_on_a_cpu_work_simply_runs() -> None:
    done = torch.zeros(1)
    runner = kernels.Kernels(torch.device("cpu"))
    for _ in range(2):
        runner.run("key", lambda: done.add_(1.0), (done,))
    assert done.item() == 2


def test_a_kernel_cache_that_cannot_be_written_is_copied(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = tmp_path / "cache"
    full.mkdir()
    (full / "kernel").write_text("compiled")
    config = kernels.wp.config
    monkeypatch.setattr(config, "kernel_cache_dir", str(full))
    monkeypatch.setattr(kernels.wp, "init", lambda: None)
    monkeypatch.setattr(kernels.os, "access", lambda path, mode: False)
    with pytest.warns(UserWarning, match="WARP_CACHE_PATH"):
        kernels.start_warp()
    assert config.kernel_cache_dir != str(full)
    assert (Path(config.kernel_cache_dir) / "kernel").read_text() == "compiled"
