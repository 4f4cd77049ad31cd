"""The grid proposes every variant with every seed, once."""

from __future__ import annotations

import pytest

from understudy.errors import ConfigError
from understudy_sweeps.command import expanded
from understudy_sweeps.grid import Grid
from understudy_sweeps.loops import Report, Trial

OPTIONS = Grid.Options(variants={"a": (), "b": ("x=1",)}, seeds=(0, 5))


def test_every_variant_with_every_seed_once() -> None:
    grid, seen = Grid(OPTIONS), []
    while (trial := grid.ask(len(seen))) is not None:
        seen.append(trial)
        grid.tell(Report(trial.key, "ok", objective=0.5, cost=10.0))
    assert [t.key for t in seen] == ["a/seed0", "b/seed0", "a/seed5", "b/seed5"]
    assert seen == list(grid.plan)
    assert (seen[-1].overrides, seen[-1].variant, seen[-1].seed) == (("x=1",), "b", 5)


def test_variants_as_people_write_them() -> None:
    grid = Grid(Grid.Options(variants={"a": None, "b": "x=1", "c": ()}))
    assert [trial.overrides for trial in grid.plan] == [(), ("x=1",), ()]


def test_variants_and_seeds_alone_are_a_grid() -> None:
    words = ["experiment=miniature/go", "variants={a: [], b: [x=1]}", "seeds=[0,1]"]
    assert expanded(words) == [
        "executor=in_process", "outer_loop=grid", words[0], f"outer_loop.{words[1]}", f"outer_loop.{words[2]}",
    ]  # fmt: skip
    chosen = ["ablation=spacetime/walk", "executor=processes", "seeds=[0]"]
    assert expanded(chosen) == [*chosen[:2], "outer_loop.seeds=[0]"]
    assert expanded(words[:1]) == words[:1]


def test_the_share_that_is_done() -> None:
    grid = Grid(OPTIONS)
    assert grid.share == 0.0
    grid.tell(Report("a/seed0", "ok", objective=0.5))
    grid.tell(Report("a/seed0", "running", objective=0.5))
    grid.tell(Report("gone/seed0", "ok", objective=0.5))
    assert grid.share == 0.25


def test_sums_up_results_and_failures() -> None:
    grid = Grid(OPTIONS)
    grid.tell(Report("a/seed0", "failed: something"))
    grid.tell(Report("a/seed5", "running", objective=0.1))
    grid.tell(Report("a/seed5", "ok", objective=0.8, cost=4.0))
    row = grid.summary()[0]
    assert (row["seeds"], row["failed"], row["objective"]) == (1, 1, 0.8)


def test_what_was_asked_before_is_not_asked_again() -> None:
    grid = Grid(OPTIONS)
    assert grid.recall(Trial("b/seed0", ("x=1",), variant="b", seed=0))
    assert not grid.recall(Trial("gone/seed0", variant="gone", seed=0))
    asked = [grid.ask(i) for i in range(2, 6)]
    assert [t.key for t in asked if t] == ["a/seed0", "a/seed5", "b/seed5"]


def test_a_variant_that_became_another_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"x=2.*another name"):
        Grid(OPTIONS).recall(Trial("b/seed0", ("x=2",), variant="b", seed=0))


def test_empty_grids_are_refused() -> None:
    with pytest.raises(ValueError, match="must not be empty"):
        Grid.Options(variants={})
