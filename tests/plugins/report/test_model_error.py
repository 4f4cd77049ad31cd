"""The section on a learned model's error: from metrics that may be anything."""

from __future__ import annotations

from pathlib import Path

from report_runs import EVIL, Page, make_run

from understudy_report.markup import check_markup
from understudy_report.model_error import ModelError


def test_a_run_without_a_model_has_no_section(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    run.append_metrics({"samples": 10, "reward": 1.0})
    assert ModelError().html(run) is None


def test_bodies_stand_by_their_error_of_the_last_look(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    looks = [
        {"model_error/hand/1": 0.5, "model_error/foot/1": 0.5},
        {
            "model_error/hand/1": 0.01, "model_error/hand/8": 0.02,
            "model_error/foot/1": 0.03, "model_error/foot/8": 0.04,
            f"model_error/{EVIL}/8": 0.001, "model_error/foot/deep": 1.0,
            "model_error/hand/4": "much",
        },
        {"reward": 1.0},
    ]  # fmt: skip
    for samples, look in enumerate(looks, start=1):
        run.append_metrics({"samples": samples, **look})
    html = ModelError().html(run)
    assert html is not None
    check_markup(html)
    assert EVIL not in html
    text = Page(html).text
    assert text.index("foot3.04.0") < text.index("hand1.02.0")
    assert "50.0" not in text
    assert "1 decision ahead" in text
    assert "8 decisions ahead" in text
