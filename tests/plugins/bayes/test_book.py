"""What a search keeps of its trials: y, failures, the budget, its answer."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from understudy.errors import ConfigError
from understudy_bayes.book import Book, SearchOptions
from understudy_bayes.fidelity import Fidelity
from understudy_bayes.space import Parameter
from understudy_sweeps.loops import Report, Trial

SPACE = {"a.x": Parameter(0.0, 2.0), "a.y": Parameter(0.0, 1.0)}


def book(**options: Any) -> Book:
    given = {"parameters": SPACE, "trials": 20, **options}
    return Book(SearchOptions(**given), Fidelity())


def tell(book: Book, number: int, objective: float | None, **more: Any) -> None:
    status = more.pop("status", "ok")
    book.tell(Report(f"trial{number}", status, objective, **more))


def test_learning_faster_is_better() -> None:
    """y = objective · exp(-N / C), eq. 6.5."""
    b = book(sample_scale=1e7)
    for number, (objective, cost) in enumerate([(0.8, 1e7), (0.6, 1e6), (-0.5, 1e7)]):
        b.ask(number, [0.5, 0.5], 1.0)
        tell(b, number, objective, cost=cost)
    expected = [0.8 * math.exp(-1), 0.6 * math.exp(-0.1), -0.5]
    assert b.data().y.tolist() == pytest.approx(expected)
    assert b.best() == "trial1"


@pytest.mark.parametrize("objective", [None, math.nan, math.inf])
def test_a_trial_without_a_number_counts_as_the_worst(objective: float | None) -> None:
    b = book()
    for number in range(3):
        b.ask(number, [0.1 * number, 0.5], 0.0)
    tell(b, 0, 0.3)
    tell(b, 1, objective, cost=5.0)
    tell(b, 2, 0.7, status="failed: something", cost=5.0)
    assert b.data().y.tolist() == [0.3, 0.3, 0.3]
    assert b.best(whole=False) == "trial0"
    assert [row["status"] for row in b.summary()] == ["ok", "ok", "failed"]


def test_a_failure_counts_as_told() -> None:
    b = book(failed=-2.0)
    b.ask(0, [0.5, 0.5], 0.0)
    tell(b, 0, None, status="failed: something", cost=5.0)
    assert b.data().y.tolist() == [-2.0]


def test_a_trial_that_cannot_be_the_best_is_stopped() -> None:
    """With at most 1.0, and 0.8 at no cost to beat: from N = C·ln(1 / 0.8) on."""
    b = book(sample_scale=1e7, ceiling=1.0)
    for number, z in enumerate([0.0, 0.0, 1.0]):
        b.ask(number, [0.5, 0.1 * number], z)
    limit = 1e7 * math.log(1 / 0.8)

    def running(number: int, cost: float) -> str | None:
        return b.tell(Report(f"trial{number}", "running", 0.1, cost=cost))

    assert running(1, 1e9) is None  # nothing to compare it with yet
    tell(b, 0, 0.8)
    assert running(1, limit * 0.999) is None
    assert running(1, limit * 1.001) == "stop"
    assert running(2, limit * 1.001) is None  # at another fidelity
    assert book(sample_scale=1e7).tell(Report("trial0", "running", 0.1, cost=1e9)) is None


def test_a_ceiling_needs_a_scale() -> None:
    with pytest.raises(ValueError, match="ceiling needs sample_scale"):
        book(ceiling=1.0)


def test_reports_of_running_trials_change_nothing() -> None:
    b = book()
    b.ask(0, [0.5, 0.5], 0.0)
    tell(b, 0, 0.5, status="running")
    assert [t.key for t in b.pending] == ["trial0"]
    assert len(b.data().y) == 0


def test_data_are_where_the_trials_were() -> None:
    b = book()
    b.ask(0, [0.25, 0.75], 0.5)
    tell(b, 0, 1.0, cost=7.0)
    data = b.data()
    assert (data.x.tolist(), data.z.tolist(), data.cost.tolist()) == ([[0.25, 0.75]], [0.5], [7.0])
    assert data.x.dtype == data.y.dtype == data.z.dtype
    assert b.trials["trial0"] == Trial("trial0", point={"a.x": 0.5, "a.y": 0.75}, fidelity=0.5)


def test_it_is_over_when_the_samples_are_spent() -> None:
    """Trials that still run count at what finished ones cost."""
    b = book(trials=None, budget=100.0)
    for number in range(4):
        assert not b.over(number)
        b.ask(number, [0.5, 0.5], 0.0)
    tell(b, 0, 1.0, cost=24.0)
    assert not b.over(4)
    tell(b, 1, 1.0, cost=30.0)  # 54 spent, two more at 27
    assert b.over(4)
    tell(b, 2, 1.0, cost=1.0)
    tell(b, 3, 1.0, cost=1.0)
    assert not b.over(4)


def test_it_is_over_after_the_last_trial() -> None:
    assert book(trials=3).over(3)
    assert not book(trials=3).over(2)


def test_the_answer_is_a_whole_trial() -> None:
    """An easy task's higher value is no answer; algorithm 4's own, the highest of all, is marked."""
    b = book()
    for number, (z, y) in enumerate([(0.0, 0.9), (1.0, 0.4), (1.0, 0.6), (1.0, 0.5)]):
        b.ask(number, [0.1 * number, 0.5], z, {"trial": "trial0"} if number == 3 else None)
        tell(b, number, y)
    rows = b.summary()
    assert [row["best"] for row in rows] == [None, 0.4, 0.6, 0.6]
    assert [row["found"] for row in rows] == ["highest y", "", "answer", ""]
    assert [row["start"] for row in rows] == [None, None, None, "trial0"]
    assert rows[2]["a.x"] == 0.4


@pytest.mark.parametrize(
    ("option", "outcome", "whole"),
    [
        ("budget.samples", "criterion", True),
        ("budget.samples", "budget", False),
        ("budget.samples", "stopped", False),
        ("learner.batch", "criterion", False),
    ],
)
def test_a_trial_that_was_done_within_a_smaller_budget_is_whole(
    option: str, outcome: str, whole: bool
) -> None:
    fidelity = Fidelity(option, low=100, high=1000, integer=True)
    b = Book(SearchOptions(parameters=SPACE, trials=20), fidelity)
    for number, z in enumerate([0.5, 1.0]):
        b.ask(number, [0.5, 0.5], z)
    tell(b, 0, 0.9, outcome=outcome)
    tell(b, 1, 0.4, outcome="budget")
    assert [row["whole"] for row in b.summary()] == [whole, True]
    assert b.best() == ("trial0" if whole else "trial1")
    assert b.data().z.tolist() == pytest.approx([0.5, 1.0])  # the model learns at which z it was


def test_trials_of_another_search_are_refused() -> None:
    b = book()
    trial = b.ask(0, [0.5, 0.5], 0.0)
    assert b.recall(trial)
    with pytest.raises(ConfigError, match="at another point when this search began"):
        b.recall(Trial("trial0", point={"a.x": 0.1, "a.y": 0.1}, fidelity=0.0))
    with pytest.raises(ConfigError, match="at another point when this search began"):
        b.recall(Trial("trial1", point={"a.x": 0.1}))
    for x in (math.nan, -1.0, 1e300):  # of a scale that has no logarithm of it, or anywhere
        with pytest.raises(ConfigError, match="at another point when this search began"):
            b.recall(Trial("trial1", point={**trial.point, "a.x": x}, fidelity=0.0))


@pytest.mark.parametrize(
    "key", ["ppo/seed0", "trial", "trial2", "trial00", "trial01", "job1", "Trial1"]
)
def test_a_row_that_is_none_of_its_own_is_not_counted(key: str) -> None:
    """It was, so that one trial fewer was made; the number of the next trial is that of the rows."""
    b = book()
    first = b.ask(0, [0.5, 0.5], 0.0)
    with pytest.raises(ConfigError, match=f"^Trial '{key}' stands where this search's 'trial1' is"):
        b.recall(replace(first, key=key))
    assert [row["trial"] for row in b.summary()] == ["trial0"]
    assert b.recall(replace(first, key="trial1"))


def test_a_search_none_of_whose_trials_can_begin_is_wrong() -> None:
    b = book(initial=2)
    for number in range(2):
        b.ask(number, [0.5, 0.5], 0.0)
    why = "failed: learner has no option 'epoch'. Did you mean 'epochs'?"
    tell(b, 0, None, status=why)
    with pytest.raises(ConfigError, match=r"None of the first 2 trials could begin.*'epoch'"):
        tell(b, 1, None, status=why)


def test_one_trial_that_began_is_enough() -> None:
    b = book(initial=2)
    for number in range(2):
        b.ask(number, [0.5, 0.5], 0.0)
    tell(b, 0, None, status="failed: numbers left the finite", cost=100.0)
    tell(b, 1, None, status="failed: no such thing")
    assert b.data().y.tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"parameters": {}}, "parameters must not be empty"),
        ({"trials": None}, "say when the search ends"),
        ({"trials": 0}, "trials=0"),
        ({"initial": 0}, "initial=0"),
        ({"budget": 0.0}, "budget=0.0"),
        ({"sample_scale": -1.0}, "sample_scale=-1.0"),
    ],
)
def test_impossible_options_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        book(**options)


def test_the_share_that_is_done_counts_what_is_finished() -> None:
    b = book(trials=8, budget=1000.0)
    for number in range(3):
        b.ask(number, [0.1 * number, 0.5], 0.0)
    shares = [b.done]
    for number, cost in enumerate((100.0, 300.0, 900.0)):
        tell(b, number, 1.0, cost=cost)
        shares.append(b.done)
    assert shares == pytest.approx([0.0, 1 / 8, 0.4, 1.0])


@pytest.mark.parametrize(("counts", "share"), [(True, 0.8), (False, 0.3)])
def test_first_trials_need_not_count(counts: bool, share: float) -> None:
    """Searches whose first trials cost more are left with as much as others after them."""
    options = SearchOptions(
        {"a.x": Parameter(0.0, 1.0)}, budget=10.0, initial=2, initial_counts=counts
    )
    book = Book(options)
    for number, cost in enumerate((2.0, 3.0, 3.0)):
        trial = book.ask(number, [0.5])
        book.tell(Report(trial.key, "ok", 1.0, cost=cost))
    assert book.spent(3) == pytest.approx(share)
    assert book.done == pytest.approx(share)


def test_what_is_searched_is_no_fidelity() -> None:
    """The fidelity's value took the place of the point's."""
    with pytest.raises(ConfigError, match=r"fidelity\.option=a\.x is not possible: it is among"):
        Book(SearchOptions(parameters=SPACE, trials=20), Fidelity("a.x", low=0.1, high=0.9))
