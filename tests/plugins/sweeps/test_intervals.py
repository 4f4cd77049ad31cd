"""Means and their intervals against numbers worked by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from understudy_sweeps.intervals import Mean, mean_of, paired_difference, t_quantile
from understudy_sweeps.results import SUCCESS
from understudy_sweeps.tables import shown_mean


@pytest.mark.parametrize(
    ("values", "mean", "reach"),
    [
        ([1.0, 2.0, 3.0], 2.0, 4.302653 / math.sqrt(3)),  # s = 1, t(2) from a table
        ([0.8, 0.9, 0.7, 0.8, 0.8], 0.8, 2.776445 * math.sqrt(0.02 / 4 / 5)),  # t(4)
        ([4.0, 4.0, 4.0], 4.0, 0.0),
    ],
)
def test_student(values: list[float], mean: float, reach: float) -> None:
    found = mean_of(values)
    assert found is not None
    assert found.low is not None
    assert found.high is not None
    assert found.value == pytest.approx(mean)
    assert (found.low, found.high) == (pytest.approx(mean - reach), pytest.approx(mean + reach))


def test_one_value_or_two_say_nothing_of_their_spread() -> None:
    assert mean_of([0.7]) == Mean(0.7, 1)
    assert mean_of([0.0, 1.0]) == Mean(0.5, 2)  # its interval would be from -5.9 to 6.9
    assert paired_difference({0: 0.1, 1: 0.9}, {0: 0.9, 1: 0.1}) == Mean(0.0, 2)
    assert mean_of([]) is None


def test_many_values_are_nearly_normal() -> None:
    assert t_quantile(10_000) == pytest.approx(1.96, abs=1e-3)


@pytest.mark.parametrize("count", [3, 4, 5])
def test_the_interval_holds_in_19_of_20_cases(count: int) -> None:
    """However few values there are; with 1.96 in place of t it would be 0.81 of cases of three."""
    draws = np.random.default_rng(0).normal(3.0, 2.0, (4000, count))
    found = [mean_of(row.tolist()) for row in draws]
    held = [m.low <= 3.0 <= m.high for m in found if m and m.low is not None and m.high is not None]
    assert np.mean(held) == pytest.approx(0.95, abs=0.012)


def test_differences_by_seed() -> None:
    """What differs between seeds alone falls out; seeds that one lacks do not count."""
    first = {0: 1.0, 1: 20.0, 2: 4.0, 7: 5.0}
    second = {2: 6.0, 1: 21.0, 0: 2.0, 9: 100.0}
    found = paired_difference(first, second)  # 1, 1, 2: mean 4/3, s = 1/√3
    assert found is not None
    assert (found.value, found.count) == (pytest.approx(4 / 3), 3)
    assert found.high == pytest.approx(4 / 3 + 4.302653 / 3)
    assert found.low == pytest.approx(4 / 3 - 4.302653 / 3)
    assert paired_difference({0: 1.0}, {1: 1.0}) is None


def test_shares_stay_shares() -> None:
    assert Mean(0.9, 2, 0.4, 1.4).clipped(0.0, 1.0) == Mean(0.9, 2, 0.4, 1.0)
    assert Mean(0.9, 1).clipped(0.0, 1.0) == Mean(0.9, 1)


@pytest.mark.parametrize(
    ("values", "name", "sign", "text"),
    [
        ([1.0, 0.9, 1.0], SUCCESS, False, "96.7 % [82.3, 100]"),
        ([0.0, 0.0, 0.1], SUCCESS, False, "3.33 % [0, 17.7]"),
        ([1.0, 0.0], SUCCESS, False, "50 % (2 seeds)"),
        ([1.0, -0.5], SUCCESS, True, "+25 points (2 seeds)"),
        ([1.0, 1.0, 0.0], SUCCESS, True, "+66.7 points [-76.8, +100]"),
        ([1.0], SUCCESS, False, "100 %"),
        ([3.0, 5.0], "objective", False, "4 (2 seeds)"),
    ],
)
def test_shown_intervals_are_possible(
    values: list[float], name: str, sign: bool, text: str
) -> None:
    assert shown_mean(mean_of(values), name, sign=sign).replace("\u2212", "-") == text
