"""Stick figures that survive odd motions."""

from __future__ import annotations

import json
import re
from xml.etree import ElementTree

import numpy as np
import pytest

from understudy_report.stick_figures import stick_figure_animation, stick_figure_svg


def walker(steps: int = 40, segments: int = 5) -> np.ndarray:
    """A bundle of upright lines 1 m high that moves along x at 1 m a frame, (T, S, 2, 3)."""
    figure = np.zeros((steps, segments, 2, 3))
    figure[..., 0] = np.arange(steps)[:, None, None] + 0.1 * np.arange(segments)[:, None]
    figure[..., 1] = np.linspace(-0.2, 0.2, segments)[:, None]
    figure[..., 1, 2] = 1.0
    return figure


def test_filmstrip_shows_ten_poses_and_their_times() -> None:
    svg = stick_figure_svg(walker(31), walker(31), 0.1)
    ElementTree.fromstring(svg)
    assert svg.count("</text>") == 10
    assert ">0.0 s<" in svg
    assert ">3.0 s<" in svg
    assert svg.count("--reference") == 20  # far and near limbs of each pose


def test_filmstrip_keeps_poses_centred() -> None:
    """However far the figure walks, its coordinates are about its own middle."""
    far_away = stick_figure_svg(walker() + np.array([500.0, 0, 0]), None, 0.1)
    assert far_away == stick_figure_svg(walker(), None, 0.1)
    assert "--reference" not in far_away


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_filmstrip_of_few_frames(frames: int) -> None:
    assert stick_figure_svg(walker(frames), None, 0.1).count("</text>") == frames


@pytest.mark.parametrize("shape", [(0, 5, 2, 3), (5, 0, 2, 3)])
def test_nothing_to_draw(shape: tuple[int, ...]) -> None:
    assert stick_figure_svg(np.zeros(shape), None, 0.1) == ""
    assert stick_figure_animation(np.zeros(shape), None, 0.1) == ""


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e30])
def test_numbers_that_cannot_be_drawn_are_left_out(bad: float) -> None:
    motion, reference = walker(), walker()
    motion[20:] = bad
    reference[3, 1, 0, 2] = bad
    strip = stick_figure_svg(motion, reference, 0.1)
    ElementTree.fromstring(strip)
    text = strip + stick_figure_animation(motion, reference, 0.1)
    assert not re.search(r"nan|inf\b|e\+|\d{12}", text, re.IGNORECASE)


def test_shapes_that_are_no_stick_figures() -> None:
    with pytest.raises(ValueError, match="T, S, 2, 3"):
        stick_figure_svg(np.zeros((4, 2, 3)), None, 0.1)
    with pytest.raises(ValueError, match="T, S, 2, 3"):
        stick_figure_animation(walker(4), walker(5), 0.1)


def test_animation_holds_every_frame_in_millimetres() -> None:
    html = stick_figure_animation(walker(7), walker(7), 1 / 30)
    found = re.search(r'<script type="application/json">(.*?)</script>', html)
    assert found is not None
    data = json.loads(found[1])
    assert data["dt"] == pytest.approx(1 / 30, abs=1e-6)
    assert len(data["frames"]) == 7
    *paths, centre = data["frames"][3]
    assert centre == 3200
    assert paths[2:] == [
        "M100 0L100 -1000M200 0L200 -1000",
        "M-200 0L-200 -1000M-100 0L-100 -1000M0 0L0 -1000",
    ]
    assert 'max="6"' in html
