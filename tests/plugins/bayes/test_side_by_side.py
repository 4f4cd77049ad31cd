"""Candidates that share one job: asked together, told together, going on from a journal."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from understudy.errors import ConfigError
from understudy_bayes.gp_ucb import GPUCB
from understudy_bayes.side_by_side import SideBySide, apart, reports, together
from understudy_bayes.space import Parameter
from understudy_sweeps.loops import Report, Trial

PATHS = {"starts.CANDIDATE.x": Parameter(-1.0, 1.0), "starts.CANDIDATE.y": Parameter(0.0, 2.0)}


def made(**options: Any) -> SideBySide:
    chosen = {"trials": 8, "initial": 4, "candidates": 2, "overrides": ("count=2", "a.CANDIDATE=1")}
    return SideBySide(SideBySide.Options(PATHS, **{**chosen, **options}), 5)


def score(trial: Trial, name: str) -> float:
    return -((trial.point[f"starts.{name}.x"] - 0.4) ** 2) - trial.point[f"starts.{name}.y"]


def report(trial: Trial, without: str = "", status: str = "ok") -> Report:
    names = sorted({path.split(".")[1] for path in trial.point})
    measures = {f"score_{n}": score(trial, n) for n in names if n != without}
    return Report(trial.key, status, 0.0, measures, cost=300.0)


def asked(loop: SideBySide, number: int) -> Trial:
    trial = loop.ask(number)
    assert trial is not None
    return trial


def test_a_job_has_several_points_each_under_its_name() -> None:
    first, second = asked(loop := made(), 0), asked(loop, 1)
    assert set(first.point) == {f"starts.c{k}.{axis}" for k in range(2) for axis in "xy"}
    assert first.overrides == ("count=2", "a.c0=1", "a.c1=1")
    assert len({*first.point.values(), *second.point.values()}) == 8
    assert (first.key, second.key) == ("job0", "job1")


def test_ranges_are_those_of_the_first_candidate() -> None:
    assert made().ranges == {"starts.c0.x": (-1.0, 1.0), "starts.c0.y": (0.0, 2.0)}


def test_the_first_points_are_those_of_a_search_of_single_ones() -> None:
    shared = {name: getattr(made()._options, name) for name in ("trials", "initial")}
    alone = GPUCB(GPUCB.Options(PATHS, **shared), 5)
    job = asked(made(), 0)
    for row in range(2):
        trial = alone.ask(row)
        assert trial is not None
        assert list(trial.point.values()) == [job.point[f"starts.c{row}.{a}"] for a in "xy"]


def test_it_ends_after_all_points_and_finds_the_best() -> None:
    loop, jobs = made(candidates=3), []
    while (trial := loop.ask(len(jobs))) is not None:
        jobs.append(trial)
        loop.tell(report(trial))
    assert [len(job.point) // 2 for job in jobs] == [3, 3, 2]
    assert loop.share == 1.0
    rows = loop.summary()
    assert [row["job"] for row in rows] == ["job0"] * 3 + ["job1"] * 3 + ["job2"] * 2
    best = next(row for row in rows if row["found"] == "answer")
    assert best["objective"] == max(row["objective"] for row in rows)
    assert sum(row["samples"] for row in rows) == pytest.approx(900.0)


def test_it_goes_on_as_it_would_have() -> None:
    first, second = made(), made()
    for number in range(2):
        trial = asked(first, number)
        first.tell(report(trial))
        assert second.recall(trial)
        second.tell(report(trial))
    assert asked(first, 2) == asked(second, 2)
    moved = Trial("job0", point={**asked(third := made(), 0).point, "starts.c0.x": 0.123})
    with pytest.raises(ConfigError, match="at another point when this search began"):
        third.recall(moved)


def test_a_candidate_without_a_world_has_failed_and_cost_nothing() -> None:
    loop = made(candidates=3)
    trial = asked(loop, 0)
    loop.tell(report(trial, without="c1"))
    rows = loop.summary()
    assert [row["status"] for row in rows] == ["ok", "failed", "ok"]
    assert [row["samples"] for row in rows] == [150.0, 0.0, 150.0]


def test_a_job_that_is_asked_while_nothing_is_known_has_the_points_that_there_are() -> None:
    """Four at points that no model chose: with three a job, the second has one until the first is told."""
    loop = made(candidates=3)
    first, second = asked(loop, 0), asked(loop, 1)
    assert (len(first.point), len(second.point)) == (6, 2)
    assert loop.ask(2) is None
    loop.tell(report(first))
    assert len(asked(loop, 2).point) == 6


def test_a_job_that_failed_has_failed_for_all() -> None:
    loop = made()
    loop.tell(report(asked(loop, 0), status="failed: numbers"))
    assert {row["status"] for row in loop.summary()} == {"failed"}
    assert {row["y"] for row in loop.summary()} == {None}


def test_points_apart_and_together_are_inverses() -> None:
    trials = {n: Trial("k", point={p: float(i) for p in PATHS}) for i, n in enumerate("ab")}
    job = together("j", trials)
    assert apart(job, "b", "k", tuple(PATHS)) == trials["b"]
    assert apart(job, "c", "k", tuple(PATHS)) is None
    found = reports(Report("j", "ok", None, {"score_a": 1.0}), {"a": "ka", "b": "kb"}, "score_CANDIDATE")  # fmt: skip
    assert (found["a"].objective, found["b"].status[:6]) == (1.0, "failed")


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"candidates": 1}, "candidates=1"),
        ({"objective": "score"}, "'score' is the same for all candidates"),
        ({"parameters": {"starts.x": Parameter(0.0, 1.0)}}, "'starts.x' is the same"),
    ],
)
def test_what_is_no_job_of_several(changed: dict[str, Any], said: str) -> None:
    chosen = {"parameters": PATHS, "trials": 4, **changed}
    with pytest.raises(ValueError, match=said):
        SideBySide.Options(**chosen)


def test_a_trial_of_another_search_is_refused() -> None:
    with pytest.raises(ConfigError, match="no job of this search"):
        made().recall(Trial("job0"))
    job = asked(made(), 0)
    for key in ("trial0", "job1", "c0"):
        with pytest.raises(
            ConfigError, match=f"^Trial '{key}' stands where this search's 'job0' is"
        ):
            made().recall(dataclasses.replace(job, key=key))
