"""Success by where episodes begin: parts of the clip, what cannot be flown left out, and the page's words."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from understudy.errors import ConfigError
from understudy.random import WorldStreams
from understudy.records.runs import Run
from understudy.task import Context
from understudy_characters.letting_go import LettingGo
from understudy_characters.scene import reference_motion
from understudy_spacetime import clip_starts
from understudy_spacetime.by_phase import by_part, drawn, measured, sentence, worst
from understudy_spacetime.clip_starts import Flyable, Phases


def streams(worlds: int = 4_000) -> WorldStreams:
    return WorldStreams(0, "test", worlds, "cpu")


def fallen(bad: list[bool], duration: float) -> LettingGo:
    """A start in each equal part of the clip; the bad ones land a metre away."""
    times = duration * np.arange(len(bad)) / len(bad)
    return LettingGo(times, np.zeros(len(bad)), np.array(bad, dtype=float), np.zeros(len(bad)))


def test_a_part_is_begun_in_evenly(context: Context) -> None:
    reference = reference_motion(context)
    found = Phases(Phases.Options(low=0.3, high=0.4), context).sample(streams())
    phase = found["motion_start"] / reference.duration
    assert 0.3 <= phase.min() < 0.301
    assert 0.399 < phase.max() <= 0.4
    assert torch.equal(found["qpos"], reference.sample(found["motion_start"])["reference_qpos"])


@pytest.mark.parametrize("ends", [(0.4, 0.4), (0.5, 0.2), (-0.1, 1.0), (0.0, 1.1)])
def test_a_part_that_is_none_is_refused(ends: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match=r"low|high"):
        Phases.Options(*ends)


def test_starts_that_cannot_be_flown_are_left_out(
    context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    duration = reference_motion(context).duration
    bad = [3 <= i < 6 for i in range(10)]
    monkeypatch.setattr(clip_starts, "let_go", lambda *_: fallen(bad, duration))
    start = Flyable(None, context).sample(streams())["motion_start"] / duration
    assert not ((start > 0.251) & (start < 0.549)).any()  # within half a step of a bad one alone
    for phase in (0.1, 0.2, 0.6, 0.9):
        assert ((start - phase).abs() < 0.05).any()


def test_a_clip_that_nobody_can_fly_is_refused(
    context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clip_starts, "let_go", lambda *_: fallen([True] * 4, 1.0))
    with pytest.raises(ConfigError, match="--fix"):
        Flyable(None, context)


def judged(**means: float) -> dict[str, Any]:
    return {name: {"mean": mean} for name, mean in means.items()}


def test_the_page_says_what_was_left_out_and_the_share_without() -> None:
    found = judged(success_from_flyable=0.9, success_from_any_phase=0.7)
    text = sentence(found, 0.267)
    assert "cannot be flown, 26.7% of the clip's" in text
    assert "Without those starts 90% of episodes succeed." in text
    assert "With no start left out 70% do." in text


def test_parts_are_read_in_order_and_as_many_as_there_are() -> None:
    found = judged(success_from_phase_1=0.5, success_from_phase_0=0.25, success_from_phase_3=1.0)
    assert by_part(found) == [0.25, 0.5]
    assert by_part(judged(success_rate=1.0)) == []


def test_the_chart_is_in_seconds_of_the_clip_and_has_grey_where_nobody_can_follow() -> None:
    page = drawn([0.25, 0.5], [1.0, 0.0], 1.75)
    assert ">1.5</text>" in page  # s, not a phase
    assert ">100</text>" in page  # %
    assert 'd="M44.0 142.0L44.0 8.0L185.0 8.0L185.0 142.0L326.0 142.0L326.0 142.0Z"' in page


def test_the_page_says_where_episodes_succeed_least_and_how_sure_that_is() -> None:
    found = judged(success_from_phase_0=1.0, success_from_phase_1=0.25)
    found["success_from_phase_1"]["mean_95"] = [0.13, 0.42]
    text = worst(found, [1.0, 0.25], 2.0)
    assert (
        "between 1.00 and 2.00 s of it succeed least often, 25% (95% interval 13% to 42%)." in text
    )
    found["success_from_phase_1"]["mean_95"] = ["much", None]
    assert worst(found, [1.0, 0.25], 2.0).endswith("25%.")


@pytest.mark.parametrize("size", [3, 40 * 2**30])
def test_an_evaluation_that_is_none_has_no_parts(tmp_path: Path, size: int) -> None:
    (tmp_path / "evaluation.json").touch()
    os.truncate(tmp_path / "evaluation.json", size)
    assert measured(Run(tmp_path, {})) == {}
