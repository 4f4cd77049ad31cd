"""Products of many rotations, worked out by numpy."""

from __future__ import annotations

import platform

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from understudy_humanoid.clips.figure import product


@pytest.mark.parametrize(
    ("one", "other"), [(500, 500), (1, 500), (500, 1), (None, 500), (500, None), (1, 1), (33, 33)]
)
def test_they_have_scipys_bits(one: int | None, other: int | None) -> None:
    numbers = np.random.default_rng(0)
    left, right = (Rotation.random(count, rng=numbers) for count in (one, other))
    wanted = (left * right).as_quat()
    found = product(left, right).as_quat()
    assert found.shape == wanted.shape
    exact = platform.machine() in ("x86_64", "AMD64")  # elsewhere compilers fuse scipy's sums
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=0.0 if exact else 1e-15)
    if one == other == 500:
        assert (product(right, left).as_quat() != wanted).any()
