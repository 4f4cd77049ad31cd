"""Curves over seeds: where the mean is, and how wide its band."""

from __future__ import annotations

import numpy as np
import pytest

from understudy_sweeps.curves import mean_curve, style_of


def curve(*points: tuple[float, float]) -> np.ndarray:
    return np.array(points, dtype=float)


def test_the_mean_of_curves_at_different_samples() -> None:
    """On a common axis, as far as all have come: one more seed that ended early draws no jump."""
    line, band = mean_curve(
        [curve((0, 0), (100, 10)), curve((20, 4), (60, 8)), curve((0, 2), (200, 2))]
    )
    assert (line[0, 0], line[-1, 0]) == (20, 60)
    assert line[0, 1] == pytest.approx((2 + 4 + 2) / 3)
    assert line[-1, 1] == pytest.approx((6 + 8 + 2) / 3)
    assert band is not None
    reach = 4.302653 * np.std([2, 4, 2], ddof=1) / np.sqrt(3)
    assert band[0][0].tolist() == [20, pytest.approx(8 / 3 - reach, abs=1e-5)]
    assert band[1][0].tolist() == [20, pytest.approx(8 / 3 + reach, abs=1e-5)]


def test_two_seeds_span_the_band_and_one_has_none() -> None:
    line, band = mean_curve([curve((0, 0), (10, 4)), curve((0, 2), (10, 8))])
    assert band is not None
    assert (band[0][-1, 1], line[-1, 1], band[1][-1, 1]) == (4, 6, 8)
    line, band = mean_curve([curve((0, 0), (10, 4))])
    assert band is None
    assert line[-1].tolist() == [10, 4]


def test_nothing_in_common() -> None:
    line, band = mean_curve([curve((0, 0), (10, 4)), curve((20, 0), (30, 4))])
    assert (len(line), band) == (0, None)
    assert mean_curve([])[1] is None


def test_variants_look_different() -> None:
    assert len({style_of(i) for i in range(18)}) == 18
