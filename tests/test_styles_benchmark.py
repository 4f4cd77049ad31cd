"""What is recorded of a search over styles (``benchmarks/styles.py``), however far it is."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

from understudy_chopsticks.search import GripSearch
from understudy_sweeps.journal import Journal
from understudy_sweeps.loops import Report

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

import styles

OPTIONS = {"styles": ["10012", "11120"], "evaluations": 3, "initial": 3, "together": 2}


def test_failures_of_rounds_whose_folders_are_gone_are_those_on_record() -> None:
    """A journal that goes on elsewhere brings no folders of its first rounds; doing it again adds nothing."""
    known = {"evaluations": 7, "held": 3, "no_pose": 1, "falls": 3}
    found = {"evaluations": 10, "held": 4, "no_pose": 2, "falls": 0}
    whole = {"evaluations": 10, "held": 4, "no_pose": 3, "falls": 3}
    assert styles.with_known(found, known) == whole
    assert styles.with_known(found, whole) == whole
    assert styles.with_known(whole, known) == whole, "with all of its folders"
    assert styles.with_known(known, known) == known


def test_a_style_has_its_best_score_its_curve_and_its_grip(tmp_path: Path) -> None:
    search = GripSearch(GripSearch.Options(**{**OPTIONS, "styles": ("10012", "11120")}), 4)
    journal = Journal(tmp_path / "journal.jsonl")
    compared = {"seed": 4, "outer_loop": {"name": "chopsticks/grips", **OPTIONS}}
    (tmp_path / "sweep.json").write_text(json.dumps({"compared": compared}))
    # The first style holds in the first round only; of the third round there is no end.
    scores = [(0.2, 0.3), (math.nan, 0.5), (0.9, 0.9)]
    for number, (first, second) in enumerate(scores):
        trial = search.ask(number)
        assert trial is not None
        journal.ask(trial)
        for share in (0.5, 1.0):
            measures = {"score_s10012": share * first, "score_s11120": share * second}
            journal.tell(Report(trial.key, "running", 0.0, measures, 100.0 * share))
        if number < 2:
            end = {"score_s10012": first, "score_s11120": second}
            journal.tell(Report(trial.key, "ok", 0.0, end, 100.0))
        kept = tmp_path / trial.key / "inputs" / "0"
        kept.mkdir(parents=True)
        (kept / "s11120.json").write_text(trial.key)
        against = {"s10012": "The style 10012 has no pose: …"} if number == 1 else {}
        (kept / "against.txt").write_text(json.dumps(against))
    best, other = styles.rows(tmp_path)
    assert (best["style"], best["name"], best["rank"], best["of"]) == ("11120", "standard", 1, 2)
    assert (best["score"], best["trial"], best["held"], best["evaluations"]) == (0.5, "11120-1", 2, 2)  # fmt: skip
    assert best["curve"] == [[50.0, 0.25], [100.0, 0.5]], "it had the round for itself"
    assert best["learned"] == 100.0
    assert (best["evaluation"], best["first"], best["no_pose"], best["falls"]) == (2, 0.3, 0, 0)
    assert (other["evaluation"], other["first"], other["no_pose"], other["falls"]) == (1, 0.2, 1, 0)
    assert set(best["places"]) == {"thumb", "index", "middle", "ring"}
    assert (other["style"], other["score"], other["held"], other["evaluations"]) == ("10012", 0.2, 1, 2)  # fmt: skip
    assert other["curve"] == [[25.0, 0.1], [50.0, 0.2]]
    styles.keep_grip(tmp_path, best, tmp_path / "grips")
    assert (tmp_path / "grips" / "11120.json").read_text() == "round1-0"
