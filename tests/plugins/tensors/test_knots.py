"""Straight lines between points."""

from __future__ import annotations

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st

from understudy_tensors.knots import Knots

CPU = torch.device("cpu")


@given(
    st.dictionaries(st.integers(-20, 20), st.floats(-5, 5, width=32), min_size=2, max_size=6),
    st.lists(st.floats(-30, 30, width=32), min_size=1, max_size=5),
)
def test_it_is_what_numpy_interpolates(points: dict[int, float], places: list[float]) -> None:
    ordered = sorted((float(place), value) for place, value in points.items())
    found = Knots(ordered, CPU).at(torch.tensor(places))
    expected = np.interp(places, [place for place, _ in ordered], [value for _, value in ordered])
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-4)


def test_one_point_is_the_same_everywhere() -> None:
    assert Knots([(0.5, 3.0)], CPU).at(torch.tensor([-1.0, 9.0])) == 3.0
