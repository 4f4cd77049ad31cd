"""Fault 29: a benchmark whose final state is invalid fails instead of reporting."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import torch
from mujoco.batch import Batch

from understudy.running.environment import Environment

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def benchmark(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    spec = importlib.util.spec_from_file_location("cpu_benchmark", ROOT / "benchmarks" / "cpu.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


SMALL = ["num_worlds=4", "learner.minibatches=2", "policy.feedback.hidden=[16]"]


def test_a_sound_run_reports(benchmark: ModuleType) -> None:
    row = benchmark.environment_against_batch(1, 2, SMALL)
    assert row["environment_to_bare"] > 0


def test_a_diverged_run_fails(benchmark: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    step = Environment.step

    def spoiled(self: Environment, action: torch.Tensor) -> object:
        return step(self, torch.full_like(action, float("nan")))

    monkeypatch.setattr(Environment, "step", spoiled)
    with pytest.raises(SystemExit, match="left the finite"):
        benchmark.environment_against_batch(1, 2, SMALL)


class Diverged:
    """A bare simulation that ends with a position that is no number."""

    def __init__(self, *arguments: Any) -> None:
        self._batch = Batch(*arguments)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._batch, name)

    def step(self, **options: Any) -> None:
        self._batch.step(**options)
        self._batch.bind("qpos")[0, 0] = float("nan")


def test_a_diverged_comparison_fails(
    benchmark: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(benchmark, "Batch", Diverged)
    with pytest.raises(SystemExit, match="The bare simulation left the finite"):
        benchmark.environment_against_batch(1, 2, SMALL)
