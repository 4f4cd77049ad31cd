"""Whether a motion depends on its time step: the verdict, the file, the page."""

from __future__ import annotations

import pytest

from understudy_judging.half_step import compared, difference, verdict
from understudy_reinforcement.evaluation import Evaluation


def judged(rate: float | None, episodes: int) -> Evaluation:
    return Evaluation(episodes, success_rate=rate)


def test_the_interval_of_a_difference_is_newcombes() -> None:
    """56 of 70 and 48 of 80: 0.20, 95 % interval 0.0524 to 0.3339 (Newcombe 1998, table II, method 10)."""
    found = difference(judged(48 / 80, 80), judged(56 / 70, 70))
    assert found == pytest.approx((0.2, 0.0524, 0.3339), abs=5e-5)


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        ((1.0, 128), (1.0, 128), "independent"),
        ((1.0, 128), (0.98, 128), "independent"),
        ((1.0, 128), (0.0, 128), "depends"),
        ((0.5, 512), (0.6, 512), "depends"),  # for the better, too
        ((0.9, 16), (0.85, 16), "undecided"),
    ],
)
def test_the_verdict(first: tuple[float, int], second: tuple[float, int], expected: str) -> None:
    apart = difference(judged(*first), judged(*second))
    assert apart is not None
    assert verdict(apart[1:]) == expected


def test_episodes_of_one_start_decide_nothing() -> None:
    alike = Evaluation(128, success_rate=1.0, different_starts=1)
    apart = difference(alike, alike)
    assert apart is not None
    assert verdict(apart[1:]) == "undecided"


def test_what_the_file_says() -> None:
    found = compared(judged(1.0, 64), 1200.0, judged(0.25, 64))
    assert found["physics_hz"] == 1200.0
    assert found["success_rate"] == 0.25
    assert found["verdict"] == "depends"
    nothing = compared(judged(None, 64), 1200.0, judged(None, 64))
    assert "verdict" not in nothing  # no success is defined
