"""What the comparison of searches over jumps makes of trainings: noise, strategies found, coverage."""

from __future__ import annotations

import json
import math
import sys
from concurrent.futures import Future
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


class Made:
    """In place of processes: a training at once, or None where the time cuts it."""

    def __init__(self, cut: set[str]) -> None:
        self.cut, self.asked = cut, list[str]()

    def submit(self, train: Any, folder: Path, seed: int, point: Any, until: float) -> Future[Any]:
        folder.mkdir(parents=True, exist_ok=True)
        self.asked.append(folder.name)
        row = training(0, 0, 0.1) | {"seed": seed, "point": dict(point)}
        made = {name: row[name] for name in ("seed", "point", "samples", "seconds", "measures")}
        future = Future[Any]()
        future.set_result(None if folder.name in self.cut else made)
        return future


def test_a_training_that_is_recorded_is_not_made_again(tmp_path: Path) -> None:
    write("bayesian_0", [training(0, 0, 0.1)])
    pool = Made(set())
    known = jumps.Jumps(tmp_path / "bayesian_0.jsonl", pool, tmp_path / "runs", 0.0)  # type: ignore[arg-type]
    assert [row["seed"] for row in known.train(0, [5], {})] == [0]
    assert not pool.asked


def test_a_search_that_is_cut_asks_for_what_is_missing_at_the_same_take_off(tmp_path: Path) -> None:
    """Also where only the second training of a take-off is on record: its place is not drawn anew."""
    journal = tmp_path / "random_0.jsonl"

    def go_on(cut: set[str]) -> tuple[int, list[str]]:
        pool = Made(cut)
        made = jumps.Jumps(journal, pool, tmp_path / "runs", 0.0)  # type: ignore[arg-type]
        return jumps.search(made, "random", 0, 3, 2, 1.2), pool.asked

    assert go_on({"random_0_1_0"}) == (
        1,
        ["random_0_0_0", "random_0_0_1", "random_0_1_0", "random_0_1_1"],
    )
    (place,) = {
        json.dumps(r["point"])
        for r in map(json.loads, journal.read_text().splitlines())
        if r["take_off"]
    }
    assert [path.name for path in (tmp_path / "runs").iterdir()] == [
        "random_0_1_0"
    ]  # it goes on there
    assert go_on(set()) == (3, ["random_0_1_0", "random_0_2_0", "random_0_2_1"])
    rows = [json.loads(line) for line in journal.read_text().splitlines()]
    assert {json.dumps(r["point"]) for r in rows if r["take_off"] == 1} == {place}
    assert len({r["seed"] for r in rows}) == len(rows) == 6
    assert not [*(tmp_path / "runs").iterdir()]
