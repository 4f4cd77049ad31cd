"""How table 3.1 from coarse physics on is compared with the fine one: GPUs, what was cut, sums and differences."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from miniatures import QUICK

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

import sharpened


@pytest.mark.parametrize(
    ("given", "count", "chosen"),
    [
        (None, 2, ["0", "1"]),
        ("", 0, []),
        ("0,1,2", 3, ["0", "1", "2"]),
        ("3, 5", 2, ["3", "5"]),
        ("2,3,-1,0", 2, ["2", "3"]),  # CUDA reads on to what it does not know
        ("GPU-ab,GPU-cd", 2, ["GPU-ab", "GPU-cd"]),
    ],
)
def test_trainings_get_the_gpus_that_the_benchmark_was_given(
    given: str | None, count: int, chosen: list[str]
) -> None:
    assert sharpened.visible(count, given) == chosen


def training(skill: str, physics: str, seconds: float, slide: float, **more: Any) -> dict[str, Any]:
    measures = {"success_from_clip_start": 1.0, "success_from_any_phase": 1.0 - slide}
    played = {"slide": slide, "sink": 0.01, "jerk": 100.0}
    row = {
        "skill": skill,
        "seed": 0,
        "physics": physics,
        "when": "2026-11-28",
        "gpus": 3,
        "samples": 10,
    }
    return row | {"training_seconds": seconds, "measures": measures, "played": played} | more


def test_physics_are_compared_over_the_skills_that_have_both() -> None:
    rows = [
        training("walk", "coarse_then_fine", 30.0, 0.2),
        training("walk", "fine", 60.0, 0.1),
        training("run", "coarse_then_fine", 30.0, 0.4, samples=30),
        training("run", "fine", 90.0, 0.1),
        training("run", "fine", 1.0, 0.9, when="2026-11-27"),
        training("run", "fine", 1.0, 0.9, gpus=2),
        training("roll", "coarse_then_fine", 600.0, 0.9),
        training("roll", "fine", 600.0, 0.0, wrong=sharpened.CUT),
    ]
    (line,) = sharpened.together(rows)
    assert line["skills"] == ["run", "walk"]
    assert line["cut"] == ["roll"]
    assert line["at_most"] == pytest.approx(660 / 750)
    assert line["ratio"] == pytest.approx(60 / 150)
    assert line["samples_ratio"] == 2.0
    assert line["slide"] == pytest.approx(0.2)
    assert line["from_any_phase"] == pytest.approx(-0.2)
    assert line["sink"] == line["jerk"] == line["from_start"] == 0.0


def test_calls_are_compared_apart_and_trainings_with_few_beside_are_left_out_of_one_ratio() -> None:
    rows = [
        training("backflip", "coarse_then_fine", 40.0, 0.1, call="a", span=[0.0, 40.0]),
        training("backflip", "fine", 100.0, 0.1, call="a", span=[0.0, 100.0]),
        training("run", "fine", 100.0, 0.1, call="a", span=[0.0, 100.0]),
        training("run", "coarse_then_fine", 10.0, 0.1, call="a", span=[200.0, 210.0]),  # alone
        training("run", "coarse_then_fine", 90.0, 0.1),
        training("run", "fine", 100.0, 0.1),
    ]
    other, one = sharpened.together(rows)
    assert one["call"] == "a"
    assert one["ratio"] == 0.25
    assert (one["loaded"], one["loaded_ratio"]) == (["backflip"], 0.4)
    assert other["ratio"] == 0.9
    assert not {"call", "loaded", "loaded_ratio"} & set(other)


def test_at_once_is_the_mean_over_a_trainings_span() -> None:
    rows = [{"span": [0.0, 10.0]}, {"span": [5.0, 10.0]}, {"span": [100.0, 101.0]}, {}]
    assert sharpened.at_once(rows) == {(0.0, 10.0): 1.5, (5.0, 10.0): 2.0, (100.0, 101.0): 1.0}


def test_without_a_driver_nothing_is_said_of_its_service(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> None:
        raise OSError(name)

    monkeypatch.setattr(sharpened.ctypes, "CDLL", absent)
    assert sharpened.served() is None


@pytest.mark.parametrize(("error", "value", "said"), [(0, 1, True), (0, 0, False), (1, 0, None)])
def test_the_driver_is_asked_whether_its_service_runs(
    monkeypatch: pytest.MonkeyPatch, error: int, value: int, said: bool | None
) -> None:
    class Driver:
        def __init__(self, name: str) -> None:
            assert name == "libcuda.so.1"

        def cuInit(self, flags: int) -> int:
            return 0

        def cuDeviceGetAttribute(self, found: Any, attribute: int, device: int) -> int:
            assert (attribute, device) == (133, 0)
            found._obj.value = value
            return error

    monkeypatch.setattr(sharpened.ctypes, "CDLL", Driver)
    assert sharpened.served() is said


@pytest.mark.slow
def test_what_the_clock_cuts_is_kept_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "walk-0-fine"

    class OutOfTime(subprocess.Popen[bytes]):
        """Whose time is over once there is a row of metrics."""

        def wait(self, timeout: float | None = None) -> int:
            if timeout == 1.0:
                while self.poll() is None and not (folder / "metrics.jsonl").exists():
                    time.sleep(0.05)
                raise subprocess.TimeoutExpired("train", 1.0)
            return super().wait(timeout)

    monkeypatch.setattr(sharpened, "played", lambda folder: {"slide": 0.0})
    words = [
        "experiment=miniature/go",
        "budget.samples=30000",
        "run.video_seconds=0",
        *QUICK,
        "evaluation.success={measure: return, at_least: 0.0}",
    ]
    words += [f"run.dir={folder}"]
    with monkeypatch.context() as patched:
        patched.setattr(subprocess, "Popen", OutOfTime)
        assert sharpened.train(words, folder, None, 1.0) == sharpened.CUT
    cut = sharpened.row(folder)
    assert 0 < cut["samples"] < 30_000
    assert "success_rate" not in cut
    assert sharpened.train(words, folder, None, 600.0) == ""
    whole = sharpened.row(folder)
    assert whole["samples"] >= 30_000
    assert whole["training_seconds"] > cut["training_seconds"]
    assert whole["success_rate"] >= 0.0
