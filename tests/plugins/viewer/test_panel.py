"""Texts and small pictures of the side panel."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from understudy_characters.character import Character
from understudy_characters.overlay import Gauge
from understudy_motion.clip import Clip
from understudy_viewer import panel
from understudy_viewer.stage import Scene, Stage, Subject, build

EVIL = '"><img src=x onerror=alert(1)>{alert(2)}'


@pytest.fixture(scope="module")
def stage(humanoid: Character, walk: Clip) -> Stage:
    gauge = Gauge("height", np.linspace(0.0, 2.0, walk.num_frames), np.ones(walk.num_frames), "m")
    return build(Scene([Subject(walk, humanoid)], [gauge], ["a note"]))


def texts(stage: Stage) -> str:
    return "".join(
        part(stage, 0)
        for part in (
            lambda stage, _: panel.heading(stage),
            panel.clock,
            panel.contact_strips,
            panel.gauges,
        )
    )


def columns(svg: str) -> np.ndarray:
    """(300,) bool: the columns that the path of a strip colours."""
    found = np.zeros(300, dtype=bool)
    for start, stop in re.findall(r"M(\d+) 0H(\d+)V8", svg):
        found[int(start) : int(stop)] = True
    return found


def test_says_what_is_shown(stage: Stage) -> None:
    shown = texts(stage)
    for said in ("walk", "65 frames", "1.05 s", "loops", "right ankle", "a note", "frame 0 of 64"):
        assert said in shown


def test_text_of_strangers_is_escaped(humanoid: Character, walk: Clip) -> None:
    told = replace(walk, name=EVIL, licence=EVIL, attribution=EVIL)
    values = np.ones(walk.num_frames)
    marks = [Gauge(EVIL, values, values, EVIL)]
    stage = build(Scene([Subject(told, humanoid, role=EVIL)], marks, [EVIL]))
    stage = replace(
        stage,
        actors=(
            replace(stage.actors[0], figure=replace(stage.actors[0].figure, feet=(EVIL, EVIL))),
        ),
    )
    shown = texts(stage)
    assert "<img" not in shown
    assert shown.count("&lt;img") == 9


def test_long_and_unprintable_text_is_cut(humanoid: Character, walk: Clip) -> None:
    told = replace(walk, name="a\x00b\u202e" + "c" * 10_000)
    assert len(panel.heading(build(Scene([Subject(told, humanoid)])))) < 2000


def test_the_strip_shows_the_contacts(stage: Stage) -> None:
    shown = stage.actors[0].figure
    strips = re.findall(r"<svg.*?</svg>", panel.contact_strips(stage, 0))
    assert len(strips) == 2
    for strip, contact in zip(strips, shown.contacts.T, strict=True):
        assert columns(strip).mean() == pytest.approx(contact.mean(), abs=0.02)


def test_the_line_in_the_strip_is_at_the_time(stage: Stage) -> None:
    for frame in (0, 32, 64):
        (at,) = set(re.findall(r'<rect x="([-\d.]+)"', panel.contact_strips(stage, frame)))
        assert float(at) + 0.75 == pytest.approx(300 * frame / 64, abs=0.01)


def test_a_gauge_is_a_bar_against_its_limit(stage: Stage) -> None:
    widths = [
        re.findall(r"width:([\d.]+)%;background:(#\w+)", panel.gauges(stage, frame))
        for frame in (0, 16, 32, 48)
    ]
    inside, outside = panel.css(panel.INSIDE), panel.css(panel.OUTSIDE)
    assert [w[0][0] for w in widths] == ["0.0", "50.0", "100.0", "100.0"]
    assert [w[0][1] for w in widths] == [inside, inside, inside, outside]
    assert "0.50 of 1.00 m" in panel.gauges(stage, 16)
    beyond = columns(panel.gauges(stage, 0))
    assert beyond[:149].sum() == 0
    assert beyond[160:].all()


def test_a_single_frame_beyond_its_limit_is_seen_in_a_long_motion() -> None:
    times = np.arange(100_000) / 100.0
    on = np.zeros(len(times), dtype=bool)
    on[31_415] = True
    assert np.flatnonzero(panel._columns(on, times)).tolist() == [int(300 * 0.31415)]


def test_a_limit_of_nothing_is_no_division_by_zero(stage: Stage) -> None:
    ones = np.ones(len(stage.times))
    none = replace(stage, gauges=(Gauge("still", ones, 0.0 * ones, "m"),))
    assert panel.css(panel.OUTSIDE) in panel.gauges(none, 0)
