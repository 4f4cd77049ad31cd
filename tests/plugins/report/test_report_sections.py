"""Sections of any plugin: shown in their order, escaped, checked, and named where they fail."""

from __future__ import annotations

from pathlib import Path

import pytest
from report_runs import EVIL, STILL, Page, add_metrics, make_run, report

from understudy.records.runs import Run
from understudy.setup.plugins import hookimpl, load
from understudy.setup.registry import Registrar, Registry
from understudy_report.charts import Chart, Mark, draw_chart
from understudy_report.configuration import Configuration
from understudy_report.learning import AT_MOST, LearningCurves, marks_of, with_success
from understudy_report.markup import bar, check_markup, grid, nested, piece, table
from understudy_report.section import ReportSection
from understudy_report.stick_figures import stick_figure_animation


class Density(ReportSection):
    """Where the search has been."""

    title = f"Density {EVIL}"
    order = 30

    def html(self, run: Run) -> str | None:
        picture = '<img alt="map" src="data:image/png;base64,AAAA">'
        return (
            table([(EVIL, nested({EVIL: [EVIL]}))]) + picture + f"<p>seed {run.config['seed']}</p>"
        )


class Silent(ReportSection):
    """Nothing to show."""

    title = "Silence"

    def html(self, run: Run) -> str | None:
        return None


class Raising(ReportSection):
    """Fails."""

    title = "Raising"
    order = -5

    def html(self, run: Run) -> str | None:
        raise KeyError(f"no {EVIL}")


class Unclosed(ReportSection):
    """Would swallow what follows."""

    title = "Unclosed"
    order = 95

    def html(self, run: Run) -> str | None:
        return "<div><table><tr><td>"


class Unmade(ReportSection):
    """Is abstract still."""

    title = "Unmade"


class Stranger:
    @hookimpl
    def understudy_register(self, register: Registrar) -> None:
        register.component("report_section", "density/map", Density)
        register.component("report_section", "silent", Silent)
        register.component("report_section", "raising", Raising)
        register.component("report_section", "unclosed", Unclosed)
        register.component("report_section", "unmade", Unmade)
        register.component("report_section", "absent", "no_such_module:Nothing")


@pytest.fixture
def registry() -> Registry:
    loaded = load(only=["report"], extra=[("stranger", Stranger())])
    assert not loaded.registry.broken
    return loaded.registry


def test_a_strangers_section_stands_in_its_place(tmp_path: Path, registry: Registry) -> None:
    page, html = report(make_run(tmp_path), STILL, registry=registry)
    shown = [h for h in page.headings if h in ("Motion", "Provenance") or h.startswith("Density")]
    assert shown == ["Motion", f"Density {EVIL}", "Provenance"]
    assert "seed 3" in page.text
    assert page.addresses == ["data:image/png;base64,AAAA"]
    assert EVIL not in html
    assert page.text.count(EVIL) >= 4
    assert page.scripts == [{"type": "application/json"}, {}]  # the player's alone
    assert "img-src data:" in html
    assert "Silence" not in page.text


def test_sections_that_fail_are_named_and_the_others_shown(
    tmp_path: Path, registry: Registry
) -> None:
    page, html = report(make_run(tmp_path), registry=registry)
    for name, why in (
        ("raising", "KeyError"),
        ("unclosed", "its <td> is not closed"),
        ("unmade", "abstract"),
        ("absent", "cannot be used"),
    ):
        assert f"The section '{name}' of plugin 'stranger' is left out" in page.text
        assert why in page.text
    assert html.count('class="failed"') == 4
    assert page.headings[0] == "Raising"
    assert page.headings[-1] == "Unclosed"
    assert {"Provenance", "Configuration"} <= set(page.headings)


@pytest.mark.parametrize(
    ("html", "why"),
    [
        ("<p>", "<p> is not closed"),
        ("</section>", "</section> stands where none is open"),
        ("<b><i></b></i>", "</b> stands in <i>"),
        ('<img src="https://example.org/a.png">', "would be loaded"),
        ('<img src="//example.org/a.png"/>', "would be loaded"),
        ('<svg><image href="a.png"/></svg>', "would be loaded"),
        ('<video poster="x"></video>', "would be loaded"),
        ('<a href="javascript:alert(1)">x</a>', "is no link"),
        ('<b onclick="x()">x</b>', "would not run"),
        ("<script>alert(1)</script>", "would not run"),
        ('<script type="module">import "a"</script>', "would not run"),
        ('<link rel="stylesheet" href="a.css">', "<link> has no place"),
        ("<style>p { color: red }</style>", "<style> has no place"),
        ("<iframe></iframe>", "<iframe> has no place"),
        ('<form action="/x"></form>', "<form> has no place"),
        ("<!doctype html>", "declaration"),
        ("<?php ?>", "processing instruction"),
    ],
)
def test_markup_that_a_page_cannot_hold(html: str, why: str) -> None:
    with pytest.raises(ValueError, match=why.replace("(", r"\(")):
        check_markup(html)


@pytest.mark.parametrize(
    "html",
    [
        "",
        "plain & text",
        '<p>a<br>b <a href="../other/report.html">c</a> <a href="https://example.org">d</a></p>',
        '<svg viewBox="0 0 1 1"><path d="M0 0"/><path d="M1 1"><title>x</title></path></svg>',
        '<img src="data:image/png;base64,AAAA" alt="">',
        '<script type="application/json">{"a": "</b>"}</script>',
        grid(("a", "b"), [(EVIL, EVIL)]) + bar(0.5) + table([(EVIL, nested({EVIL: EVIL}))]),
        stick_figure_animation(STILL, STILL, 0.1),
        f'<video src="data:video/mp4;base64,{"A" * 3_000_000}"></video>',
    ],
    ids=range(9),
)
def test_markup_that_a_page_can_hold(html: str) -> None:
    check_markup(html)


# ---------------------------------------------------------------------- learning curves


def test_marks_stand_on_every_curve(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    add_metrics(run, 10)
    run.append_metrics({"samples": 4000, "mark/difficulty 2 <b>": 1.0})
    run.append_metrics({"samples": 8000, "reward": 0.5, "mark/difficulty 3": 1.0, "mark/never": 0})
    page, html = report(run)
    curves = html.count('class="card chart"')
    assert curves == 7
    assert html.count('<path class="mark"') == 2 * curves
    assert page.text.count("difficulty 2 <b> (4,000 samples)") == curves
    assert page.text.count("difficulty 3 (8,000 samples)") == curves
    assert "never" not in page.text


def test_marks_are_at_their_samples_and_labels_where_there_is_room() -> None:
    rows = [{"samples": x, "reward": 1.0} for x in (0, 1000)]
    marks = [Mark(500.0, "half"), Mark(501.0, "too close"), Mark(1000.0, "the end")]
    html = draw_chart(Chart("Reward", "reward"), rows, marks)
    # The plot goes from x = 44 to x = 326.
    assert '<path class="mark" d="M185.0 ' in html
    assert '<path class="mark" d="M326.0 ' in html
    assert ">half</text>" in html
    assert ">the end</text>" in html
    assert ">too close</text>" not in html
    assert "too close (501 samples)</title>" in html


def test_marks_of_odd_rows() -> None:
    rows = [
        {"mark/a": 1.0},
        {"samples": "x", "mark/a": 1.0},
        {"samples": 3, "mark/a": float("nan"), "mark/b": "x", "mark/c": None, "mark/d": 1},
    ]
    assert marks_of(rows) == [Mark(3.0, "d")]


def test_evaluations_are_a_curve_of_success(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    add_metrics(run, 10)
    for samples, rate in ((2000, 0.25), (6000, 0.5)):
        run.append_metrics(
            {
                "samples": samples,
                "evaluation/success_rate": rate,
                "evaluation/objective": rate,
                "evaluation/jump_height": 2 * rate,
            }
        )
    page, html = report(run)
    assert "Episodes that succeeded50 %" in page.text
    assert "jump height1" in page.text
    assert "Objective" not in page.text  # it is the success rate
    assert html.count('class="dot"') == 4
    # All curves share the samples' axis, to 10,000: 2,000 are a fifth of 282 pixels from x = 44.
    assert html.count('cx="100.4"') == 2
    assert "15.0 s" not in page.text
    assert "30.0 s of training" in page.text  # rows of evaluations say nothing of the time


def test_an_objective_of_its_own_is_shown(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    run.append_metrics({"samples": 1, "evaluation/success_rate": 0.5, "evaluation/objective": 1.7})
    page, _ = report(run)
    assert "Objective1.7" in page.text


def test_success_is_one_curve() -> None:
    """Bounds of evaluations that were stopped, confirmations in place of what they confirmed, and
    the last evaluation at the end."""
    rows = [
        {"samples": 100, "evaluation/success_rate_at_most": 0.4},
        {"samples": 200},
        {"samples": 300, "evaluation/success_rate": 0.95, "confirmation/success_rate": 0.8},
        {"samples": 400, "evaluation/success_rate": 0.9},
    ]
    found = with_success(rows, {"samples": 500, "success_rate": 0.97})
    shares = [row.get("evaluation/success_rate") for row in found]
    assert shares == [0.4, None, 0.8, 0.9, 0.97]
    assert [row.get(AT_MOST) for row in found] == [True, None, False, False, None]
    assert len(with_success(rows, {})) == 4


def test_bounds_are_rings(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    for i, key in enumerate(
        ("evaluation/success_rate_at_most",) * 2 + ("evaluation/success_rate",)
    ):
        run.append_metrics({"samples": 1000 * (i + 1), key: 0.2 * (i + 1)})
    html = LearningCurves().html(run)
    assert html is not None
    assert (html.count('class="ring"'), html.count('class="dot"')) == (2, 1)
    assert "○ at most" in html
    assert html.count("<h4>Episodes that succeeded") == 1
    first = html.partition("</svg>")[0]
    assert 'class="line"' not in first, "no line through bounds"
    assert "bound" not in html, "no curve of what is only a mark"


def test_the_configuration_says_what_set_each_value(tmp_path: Path) -> None:
    config = {"seed": 3, "learner": {"name": "ppo", "gamma": 0.95}, "memory": {}}
    origins = {"seed": "command line: seed=3", "learner.gamma": f"default of learner {EVIL}"}
    html = Configuration().html(make_run(tmp_path, config=config, origins=origins))
    assert html is not None
    check_markup(html)
    page = Page(html)
    assert "What files and the command line set (3 values)" in page.text
    assert "Defaults (1 values)" in page.text
    assert f"learner.gamma0.95default of learner {EVIL}" in page.text
    assert "<script>" not in html


def test_pieces_escape_whatever_is_no_piece() -> None:
    made = piece("card", EVIL, piece("verbatim", EVIL))
    assert "<script" not in made
    assert Page(str(made)).text == EVIL * 2
    assert "<pre>" in made, "a piece within one stays what it is"
