"""The grid proposes every variant with every seed, once."""

from __future__ import annotations

import pytest

from understudy.running.trials import Result, Trial
from understudy_sweeps.grid import Grid
from understudy_sweeps.in_process import InProcess

OPTIONS = Grid.Options(variants={"a": (), "b": ("x=1",)}, seeds=(0, 5))


def test_every_variant_with_every_seed_once() -> None:
    grid, seen = Grid(OPTIONS), []
    while (trial := grid.ask()) is not None:
        seen.append(trial)
        grid.tell(Result(trial.key, "ok", objective=0.5, cost=10.0))
    assert [t.key for t in seen] == ["a/seed0", "a/seed5", "b/seed0", "b/seed5"]
    assert seen[-1].overrides == ("x=1", "seed=5")


def test_asks_the_same_until_told_and_sums_up_failures() -> None:
    grid = Grid(OPTIONS)
    assert grid.ask() == grid.ask()
    grid.tell(Result("a/seed0", "failed: something"))
    grid.tell(Result("a/seed5", "ok", objective=0.8, cost=4.0))
    row = grid.summary()[0]
    assert (row["seeds"], row["failed"], row["success_rate"]) == (1, 1, 0.8)


def test_empty_grids_are_refused() -> None:
    with pytest.raises(ValueError, match="must not be empty"):
        Grid.Options(variants={})


def test_in_process_yields_in_order() -> None:
    trials = [Trial("x", ()), Trial("y", ())]
    results = list(InProcess().run(trials, lambda t: Result(t.key, "ok")))
    assert [r.key for r in results] == ["x", "y"]
