"""The search over styles: who is asked for, what a candidate without a pose costs, going on, bad input."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from understudy.errors import ConfigError
from understudy.inputs import Inputs
from understudy.setup.composition import compose_raw
from understudy.setup.plugins import Plugins
from understudy_chopsticks.search import GripSearch
from understudy_gripping.section import NONE_HOLDS, CandidateOptions, GripOptions, build_grips
from understudy_gripping.styles import styles, written
from understudy_hand.scene import HandScene
from understudy_reproduce.comparison import found_by
from understudy_sweeps.journal import Journal
from understudy_sweeps.loops import Report, Trial

TWO = ("11120", "11200")


def made(**options: object) -> GripSearch:
    chosen = {"styles": TWO, "evaluations": 4, "initial": 4, **options}
    return GripSearch(GripSearch.Options(**chosen), 3)  # type: ignore[arg-type]


def report(trial: Trial, score: float | None, cost: float = 100.0) -> Report:
    return Report(trial.key, "ok" if score is not None else "failed: no pose", score, cost=cost)


def asked(search: GripSearch, number: int) -> Trial:
    trial = search.ask(number)
    assert trial is not None
    return trial


def test_all_seventeen_styles_are_asked_in_turn() -> None:
    search = made(styles=())
    trials = [asked(search, n) for n in range(17)]
    expected = [written(style) for style in styles(5)]
    assert [t.overrides for t in trials] == [(f"grip.style='{style}'",) for style in expected]
    assert len({t.key for t in trials}) == 17
    for trial, style in zip(trials, styles(5), strict=True):
        assert len(trial.point) == sum(map(bool, style))
        assert all(name.startswith("grip.places.") for name in trial.point)


def test_each_style_learns_from_its_own_scores() -> None:
    """What others scored changes no candidate."""
    both, alone = made(evaluations=3, initial=2), made(styles=TWO[1:], evaluations=3, initial=2)
    own = [asked(alone, n) for n in range(2)]
    for number in range(4):
        trial = asked(both, number)
        score = 0.1 * number if trial.key.startswith(TWO[0]) else -trial.point["grip.places.thumb"]
        both.tell(report(trial, score))
    for trial in own:
        alone.tell(report(trial, -trial.point["grip.places.thumb"]))
    third = asked(both, 5)
    assert third == asked(alone, 2)
    assert third.point not in [t.point for t in own]
    both.tell(report(third, 0.3))
    assert both.ask(6) is None
    assert both.share == 5 / 6
    assert {row["search"] for row in both.summary() if row["found"] == "answer"} == set(TWO)


def test_a_style_without_a_feasible_candidate_ends_nothing() -> None:
    search = made()
    for number in range(8):
        trial = asked(search, number)
        feasible = trial.key.startswith("11120")
        search.tell(report(trial, 0.4 if feasible else None, 100.0 if feasible else 0.0))
    assert search.ask(8) is None
    best = [row for row in search.summary() if row["found"] == "answer"]
    assert [row["search"] for row in best] == ["11120"]


def test_a_search_in_which_nothing_begins_says_so() -> None:
    search = made()
    search.tell(report(asked(search, 0), None, 0.0))
    with pytest.raises(ConfigError, match="No style's first candidate could begin"):
        search.tell(report(asked(search, 1), None, 0.0))


def test_it_goes_on_as_it_would_have() -> None:
    """From the journal's trials and reports alone."""
    first, second = made(), made()
    trials = []
    for number in range(5):
        trials.append(asked(first, number))
        first.tell(report(trials[-1], 0.1 * number))
    for number, trial in enumerate(trials):
        assert second.recall(trial)
        second.tell(report(trial, 0.1 * number))
    assert asked(first, 5) == asked(second, 5)
    with pytest.raises(ConfigError, match="of a style that this search has not got"):
        made(styles=("11120",)).recall(trials[1])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"styles": ("12120",)}, "cross"),
        ({"styles": ("1120",)}, "it has 4 entries and the hand 5 fingers"),
        ({"styles": ("12200",)}, "only the thumb touches the upper stick"),
    ],
)
def test_styles_that_are_none(options: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said) as error:
        made(**options)
    assert "11120" in str(error.value), "the list of those that there are"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"style": "11120", "places": {"thumb": 0.03}}, "are those of thumb, index, middle, ring"),
        ({"style": "11200", "places": {"thumb": 0.3, "index": 0.0, "middle": 0.0}}, "grip.places.thumb=0.3 is not on"),
        ({"style": "12"}, "has 2 entries"),
        ({"finger_clearance": 1e-3}, "grip.finger_clearance is of grips that are found"),
        ({"style": "11211"}, "cross"),
    ],
)  # fmt: skip
def test_places_that_are_none(options: dict[str, object], said: str, plugins: Plugins) -> None:
    with pytest.raises(ConfigError, match=said):
        build_grips(GripOptions(**options), plugins.registry, Inputs())  # type: ignore[arg-type]


def test_a_candidate_out_of_reach_is_refused_before_any_training(plugins: Plugins) -> None:
    far = GripOptions(style="11200", places={"thumb": 0.12, "index": -0.12, "middle": -0.12})
    said = "mm are left between a stick and what shall touch it"
    with torch.no_grad(), pytest.raises(ConfigError, match=said):  # as what is played is built
        build_grips(far, plugins.registry, Inputs()).in_hand(HandScene(HandScene.Options()))


@pytest.mark.parametrize(
    ("style", "hand", "said"),
    [
        ("112", {}, "112 is not possible: it has 3 entries and the hand 5 fingers. A hand of 5 fingers has: 10012"),
        ("1112", {}, "it has 4 entries and the hand 5 fingers"),
        ("11120", {"fingers": 3}, "it has 5 entries and the hand 3 fingers"),
        ("11120", {"size": 2.0}, "finds a grip of the human hand, and the scene's is another one"),
        ("11120", {"tool": "tongs"}, "is of two sticks, and the scene has tongs"),
    ],
)  # fmt: skip
def test_a_style_of_another_hand_is_refused_before_it_is_searched_for(
    style: str, hand: dict[str, Any], said: str, plugins: Plugins, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("understudy_gripping.section.find_grip", None)
    asked_for = build_grips(GripOptions(style=style), plugins.registry, Inputs())
    with pytest.raises(ConfigError, match=said):
        asked_for.in_hand(HandScene(HandScene.Options(**hand)))


def test_a_trial_is_a_run_with_its_own_grip(plugins: Plugins) -> None:
    trial = asked(made(), 0)
    words = [f"{name}={value!r}" for name, value in trial.point.items()]
    raw = compose_raw(["experiment=chopsticks/open_close", *trial.overrides, *words], plugins)
    grip = raw["grip"]
    assert str(grip["style"]) == "11120"
    assert [grip["places"][n.rpartition(".")[2]] for n in trial.point] == list(trial.point.values())


# ------------------------------------------------------------------ candidates that share one job


BROKEN = "failed: The grip does not hold the sticks with the arm at [0.161] rad"


def joint(trial: Trial, without: str = "") -> Report:
    styles = sorted({path.split(".")[2] for path in trial.point})
    scores = {f"score_{s}": trial.point[f"grip.candidates.{s}.places.thumb"] for s in styles}
    return Report(trial.key, "ok", 0.0, {k: v for k, v in scores.items() if k != f"score_{without}"}, 100.0)  # fmt: skip


def test_a_round_is_one_job_with_a_candidate_of_each_style() -> None:
    search, alone = made(together=17, styles=()), made(styles=())
    trial = asked(search, 0)
    assert trial.key == "round0-0"
    for number, style in enumerate(map(written, styles(5))):
        own = asked(alone, number)
        assert f"grip.candidates.s{style}.style='{style}'" in trial.overrides
        for path, value in own.point.items():
            assert trial.point[path.replace("grip.", f"grip.candidates.s{style}.")] == value
    assert asked(search, 1).key == "round1-0"


def test_each_style_of_a_job_is_told_its_own_score() -> None:
    search = made(together=2)
    for number in range(4):
        trial = asked(search, number)
        search.tell(joint(trial, without="s11200" if number == 1 else ""))
    assert search.ask(4) is None
    assert search.share == 1.0
    rows = [row for row in search.summary() if row["search"] == "11200"]
    assert [row["status"] for row in rows] == ["ok", "failed", "ok", "ok"]
    assert [row["samples"] for row in rows] == [50.0, 0.0, 50.0, 50.0]
    for row in rows:
        assert row["objective"] is None or row["objective"] == row["grip.places.thumb"]


def test_a_job_ends_once_each_that_holds_has_had_its_samples() -> None:
    """Of two, one of which has no world."""
    search, patient = made(together=2, samples=100), made(together=2)
    trial = asked(search, 0)
    asked(patient, 0)

    def running(cost: float, *scores: float) -> Report:
        measures = {"score_s11120": scores[0], "score_s11200": scores[1]}
        return Report(trial.key, "running", 0.1, measures, cost)

    assert search.tell(running(99, 0.1, math.nan)) is None
    assert search.tell(running(100, 0.1, math.nan)) == "stop"
    assert search.tell(running(199, 0.1, 0.2)) is None
    assert search.tell(running(200, 0.1, 0.2)) == "stop"
    assert patient.tell(running(200, 0.1, 0.2)) is None
    assert search.tell(joint(trial)) is None


def test_what_styles_found_is_compared_by_style(tmp_path: Path) -> None:
    """Of a search whose rounds are one job each."""
    search, journal = made(together=2), Journal(tmp_path / "journal.jsonl")
    for number in range(4):
        trial = asked(search, number)
        journal.ask(trial)
        journal.tell(joint(trial, without="s11200" if number == 1 else ""))
    found = found_by(made(together=2), journal, 5)
    assert list(found) == list(TWO)
    for style, one in found.items():
        scores = [t.point[f"grip.candidates.s{style}.places.thumb"] for t in journal.asked]
        if style == "11200":
            scores[1] = scores[0]  # it had none
        assert one.curve[:, 1].tolist() == np.maximum.accumulate(scores).tolist()
        assert (one.seed, one.finished, len(one.curve)) == (5, True, 4)
    assert [one.spent for one in found.values()] == [250.0, 150.0]


def test_a_search_of_jobs_goes_on_as_it_would_have() -> None:
    first, second = made(together=2), made(together=2)
    for number in range(3):
        trial = asked(first, number)
        first.tell(joint(trial))
        assert second.recall(trial)
        second.tell(joint(trial))
    assert asked(first, 3) == asked(second, 3)
    with pytest.raises(ConfigError, match="of a search with other jobs"):
        made(together=2).recall(asked(made(), 0))


def test_a_job_that_says_nothing_of_its_candidates_is_asked_once_more() -> None:
    """As where one of them took the others with it."""
    search = made(together=2)
    lost = asked(search, 0)
    search.tell(Report(lost.key, BROKEN))
    assert {row["status"] for row in search.summary()} == {"running"}, "not failed"
    again = asked(search, 1)
    assert (again.key, again.point, again.overrides) == ("round0-0-again", lost.point, lost.overrides)  # fmt: skip
    search.tell(joint(again))
    for number in range(2, 5):
        trial = asked(search, number)
        assert trial.key == f"round{number - 1}-0"
        search.tell(joint(trial))
    assert search.ask(5) is None
    assert search.share == 1.0
    rows = [row for row in search.summary() if row["search"] == "11200"]
    assert [row["status"] for row in rows] == ["ok"] * 4
    assert [row["job"] for row in rows] == ["round0-0-again", "round1-0", "round2-0", "round3-0"]


def test_a_journal_whose_lost_round_was_passed_over_makes_up_for_it() -> None:
    """It was written when a round that could not begin counted as failed, and goes on in the middle of a later one."""
    source, search = made(together=2), made(together=2)
    trials = [asked(source, number) for number in range(4)]
    for number, trial in enumerate(trials[:3]):
        assert search.recall(trial)
        if number < 2:
            search.tell(joint(trial) if number else Report(trial.key, BROKEN))
    again = asked(search, 3)
    assert (again.key, again.point) == ("round0-0-again", trials[0].point)
    assert asked(search, 4) == trials[3]
    for trial in (trials[2], again, trials[3]):
        search.tell(joint(trial))
    assert search.ask(5) is None
    assert search.share == 1.0


@pytest.mark.parametrize(
    ("status", "cost"),
    [(f"failed: {NONE_HOLDS} The style …", 0.0), ("failed: numbers are none any more", 50.0)],
)
def test_a_job_that_says_something_counts(status: str, cost: float) -> None:
    search = made(together=2)
    search.tell(joint(asked(search, 0)))
    search.tell(Report(asked(search, 1).key, status, cost=cost))
    assert [row["status"] for row in search.summary()[1::2]] == ["failed"] * 2
    assert asked(search, 2).key == "round2-0"


def test_a_job_that_fails_twice_has_failed() -> None:
    search = made(together=2)
    search.tell(joint(asked(search, 0)))
    for number, key in ((1, "round1-0"), (2, "round1-0-again")):
        trial = asked(search, number)
        assert trial.key == key
        search.tell(Report(trial.key, "failed: the process died"))
    assert [row["status"] for row in search.summary()[1::2]] == ["failed"] * 2
    assert asked(search, 3).key == "round2-0"


def test_of_a_job_whose_question_is_lost_nothing_is_asked_again() -> None:
    """As where its row of a journal is damaged, and that of its end is not."""
    search = made(together=2)
    search.tell(Report("round0-0", BROKEN))
    search.tell(Report("round7-0-again", BROKEN))
    assert asked(search, 0).key == "round0-0"


def test_what_was_asked_once_more_is_known_when_the_search_goes_on() -> None:
    first, second = made(together=2), made(together=2)
    lost = asked(first, 0)
    first.tell(Report(lost.key, BROKEN))
    again = asked(first, 1)
    for trial in (lost, again):
        assert second.recall(trial)
        second.tell(Report(trial.key, BROKEN) if trial is lost else joint(trial))
    first.tell(joint(again))
    assert second.summary() == first.summary()
    assert asked(second, 2) == asked(first, 2)


@pytest.mark.parametrize("options", [{}, {"together": 2}])
def test_a_journal_asks_for_nothing_of_its_own(options: dict[str, int]) -> None:
    """As one of a stranger's would, of whom the folder came."""
    trial = asked(made(**options), 0)
    assert made(**options).recall(trial)
    more = replace(trial, overrides=(*trial.overrides, "motion.file=/etc/passwd"))
    with pytest.raises(ConfigError, match=r"had other overrides .* motion\.file=/etc/passwd"):
        made(**options).recall(more)


def test_a_job_composes_with_a_measure_for_each(plugins: Plugins) -> None:
    trial = asked(made(together=2), 0)
    words = [f"{name}={value!r}" for name, value in trial.point.items()]
    raw = compose_raw(["experiment=chopsticks/open_close", *trial.overrides, *words], plugins)
    assert set(raw["grip"]["candidates"]) == {"s11120", "s11200"}
    assert raw["measure"]["score_s11200"]["reads"]["where"] == "from_s11200"


@pytest.mark.parametrize(
    ("candidates", "said"),
    [
        ({"a": CandidateOptions("11120"), "b": CandidateOptions("112")}, "hands of 3 and 5 fingers"),
        ({"a": CandidateOptions("11120"), "b": CandidateOptions("12120")}, "cross"),
    ],
)  # fmt: skip
def test_candidates_that_cannot_share_a_job(
    candidates: dict[str, CandidateOptions], said: str, plugins: Plugins
) -> None:
    with pytest.raises(ConfigError, match=said):
        build_grips(GripOptions(candidates=candidates), plugins.registry, Inputs())


def test_candidates_have_names_of_fields() -> None:
    with pytest.raises(ValueError, match="candidates names '1'"):
        GripOptions(candidates={"1": CandidateOptions("11120")})
