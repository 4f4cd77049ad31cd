"""``understudy export RUN page.html``: one file that plays what was recorded, without a network."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browsers import opened
from commands import begin_that_stops_writing, kill, wait_for
from recorded_runs import make_run

from understudy.command.cli import main
from understudy_export.page import write_page
from understudy_report.motion import FIGURES, Figures


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return make_run(tmp_path)


def add_figures(run: Path) -> None:
    lines = np.zeros((6, 2, 2, 3)) + np.arange(6)[:, None, None, None] / 10
    Figures(lines, None, 1 / 30).save(run / FIGURES)


def test_it_plays_and_needs_nothing_else(
    tmp_path: Path, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    add_figures(run)
    page = tmp_path / "crouch.html"
    assert main(["export", str(run), str(page)]) == 0
    assert "6 frames, 0.20 s · licence: CC BY 4.0" in capsys.readouterr().out
    html = page.read_text()
    assert '"frames":' in html
    assert html.count("<script") == 2  # the frames, and what plays them
    assert "Recorded by Ada." in html
    assert not re.search(r"(src|href)=\"(?!data:|#)", html)
    assert "default-src 'none'" in html
    assert main(["export", str(run), str(page)]) == 2
    assert "is there already" in capsys.readouterr().err


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    yield from opened()


def test_it_goes_on_whatever_a_frame_is_dated(tmp_path: Path, run: Path, browser: Any) -> None:
    """A browser dates a frame by when it began, which may be before the script that asked for it."""
    lines = np.zeros((40, 2, 2, 3)) + np.arange(40)[:, None, None, None] / 10
    Figures(lines, None, 1 / 30).save(run / FIGURES)
    assert main(["export", str(run), str(tmp_path / "page.html")]) == 0
    page = browser.new_page()
    wrong: list[str] = []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.add_init_script(
        "const now = performance.now.bind(performance); performance.now = () => now() + 100"
    )
    page.goto((tmp_path / "page.html").as_uri())
    page.wait_for_timeout(800)
    assert wrong == []
    first = page.locator(".player output").inner_text()
    page.wait_for_timeout(300)
    assert page.locator(".player output").inner_text() != first
    page.close()


def test_a_skills_page_says_on_what_terms(
    tmp_path: Path, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The folder in which a skill was recorded knows nothing of the package that it comes with."""
    add_figures(run)
    write_page(str(run), tmp_path / "of_run.html")
    said = write_page(str(run), tmp_path / "of_skill.html", "chopsticks/standard")
    assert "licence: Apache-2.0" in said
    assert "Licence: Apache-2.0" in (tmp_path / "of_skill.html").read_text()
    assert "CC BY 4.0" in (tmp_path / "of_run.html").read_text()


def test_what_has_no_licence_says_none(tmp_path: Path, run: Path) -> None:
    info = json.loads((run / "run.json").read_text())
    info["sources"] = {}
    (run / "run.json").write_text(json.dumps(info))
    add_figures(run)
    assert write_page(str(run), tmp_path / "page.html").endswith("6 frames, 0.20 s")
    assert "Licence:" not in (tmp_path / "page.html").read_text()


def test_its_name_ends_as_pages_do(
    tmp_path: Path, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    add_figures(run)
    for name in ("page.htm", "PAGE.HTML"):
        assert main(["export", str(run), str(tmp_path / name)]) == 0
        assert "<html" in (tmp_path / name).read_text()
    for name in ("page", "page.xyz"):
        assert main(["export", str(run), str(tmp_path / name)]) == 2
        said = capsys.readouterr().err
        assert "no format is written to" in said
        assert (
            "A run can also be written as .onnx, its policy, and .html, a page that plays it."
            in said
        )


def test_refused(tmp_path: Path, run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "p.html"
    assert main(["export", str(run), str(page)]) == 2
    said = capsys.readouterr().err
    assert "has no recording to play: `understudy render" in said
    assert "if its task has a figure" in said
    assert main(["export", str(run), str(page), "--rate", "30"]) == 2
    assert "--rate is for motions" in capsys.readouterr().err
    assert main(["export", "hop", str(page)]) == 2
    assert "hop is no run folder" in capsys.readouterr().err
    assert not page.exists()


def test_killed_it_leaves_what_was_there(tmp_path: Path, run: Path) -> None:
    add_figures(run)
    page, mark = tmp_path / "p.html", tmp_path / "written"
    page.write_text("mine")
    process = begin_that_stops_writing(mark, "export", str(run), str(page), "--overwrite")
    wait_for(process, mark)
    kill(process)
    assert page.read_text() == "mine"
