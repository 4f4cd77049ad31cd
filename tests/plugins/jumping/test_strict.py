"""The jumps' limits that the authors' release has: ranges of targets, a cap on offsets, limbs that touch."""

from __future__ import annotations

import numpy as np

from understudy.setup.composition import load_experiment
from understudy_jumping.targets import RANGES

MARGIN = 0.5  #: rad beyond a person's ranges, as servo targets have


def test_ranges_are_a_persons_and_the_left_mirrors_the_right() -> None:
    words = ["experiment=jumping/high_gpu", "actuation=jumping/poses_strict", "actuation.run=none"]
    experiment = load_experiment(words)
    given = experiment.need("actuation").effective()
    assert given["offset_limit"] == 12.0
    assert experiment.need("scene").effective()["self_collision"] is True
    ranges = given["ranges"]
    for name, axes in RANGES.items():
        wide = [(low - MARGIN, high + MARGIN) for low, high in axes]
        assert np.allclose(ranges[name], wide)
        if name.startswith("right_") and len(axes) == 3:
            (a, b), middle, (c, d) = wide
            left = ranges[name.replace("right", "left")]
            assert np.allclose(left, [(-b, -a), middle, (-d, -c)])
