"""What the comparison of searches over jumps makes of trainings: noise, strategies found, coverage."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

import jumps


def training(take_off: int, repeat: int, turn: float, success: float = 1.0) -> dict[str, Any]:
    """Its root turned by `turn` rad about the vertical above the bar."""
    axes = [math.cos(turn), math.sin(turn), 0.0, 0.0, 0.0, 1.0]
    measures = {"success_rate": success, "cleared_height": 0.5}
    measures |= dict(zip(jumps.ROTATION, axes, strict=True))
    row = {"take_off": take_off, "repeat": repeat, "seed": repeat, "samples": 10.0}
    return row | {"seconds": 6.0, "point": {}, "measures": measures}


def write(name: str, rows: list[dict[str, Any]]) -> None:
    text = "".join(json.dumps(row) + "\n" for row in rows)
    (jumps.RESULTS / f"{name}.jsonl").write_text(text)


@pytest.fixture(autouse=True)
def _results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jumps, "RESULTS", tmp_path)


def test_noise_is_of_trainings_that_succeed_and_of_one_take_off() -> None:
    write("noise_0", [training(0, 0, 0.0), training(0, 1, 0.2), training(0, 2, 3.0, success=0.0)])
    write("noise_1", [training(1, 0, 2.0), training(1, 1, 2.2)])
    found = jumps.told_apart()
    assert found["noise"] == pytest.approx(0.2 / math.sqrt(2))  # of a pair, √2 less
    assert found["between_take_offs"] == pytest.approx(2.0)
    assert found["succeed"] == pytest.approx(4 / 5)
    assert found["take_offs_mixed"] == 1


def test_a_take_off_shows_a_strategy_where_half_of_its_trainings_do() -> None:
    good, bad = training(0, 0, 0.4), training(0, 1, 3.0, success=0.4)
    mean = jumps.averaged([good, bad])
    assert mean["success_rate"] == 1.0
    assert mean["strategy_forward_x"] == pytest.approx(math.cos(0.4))  # the failed one is left out
    assert jumps.averaged([good, bad, bad])["success_rate"] == 0.0


def test_coverage_is_of_what_all_searches_found() -> None:
    def finished(name: str, turns: list[float | None]) -> None:
        rows = [
            training(i, 0, turn or 0.0, success=float(turn is not None))
            for i, turn in enumerate(turns)
        ]
        write(f"{name}_0", rows)

    finished("bayesian", [0.1, 1.5, 2.9])
    finished("random", [0.1, 0.2, None])
    finished("map_elites", [0.1, 1.5])  # not finished: no row
    rows = {row["search"]: row for row in jumps.compared([0], 3, 1, 0.6)}
    assert rows.keys() == {"bayesian", "random"}
    assert (rows["bayesian"]["found"], rows["bayesian"]["coverage"]) == (3, 1.0)
    assert (rows["random"]["found"], rows["random"]["coverage"]) == (1, pytest.approx(1 / 3))
    assert rows["random"]["succeeded"] == pytest.approx(2 / 3)


def test_a_training_that_is_recorded_is_not_made_again() -> None:
    write("bayesian_0", [training(0, 0, 0.1)])
    known = jumps.Jumps("bayesian_0", until=0.0)
    assert known.train(0, 0, 5, {})["seed"] == 0
