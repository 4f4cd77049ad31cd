"""What the authors' release keeps jumps to: limits of joints, a cap on offsets, limbs that touch."""

from __future__ import annotations

import numpy as np

from understudy.setup.composition import load_experiment

#: Of the release's ``env/vae_env.py``: swing about x (forward), swing about z (right), twist about y (up).
RELEASE = {
    "chest": ((-0.43, 0.43), (-0.32, 0.32), (-0.25, 0.25)),
    "neck": ((-0.65, 0.65), (-0.6, 0.6), (-0.75, 0.75)),
    "right_hip": ((-0.52, -0.05), (-0.35, 1.57), (-0.2, 0.2)),
    "right_ankle": ((-0.2, 0.4), (-0.69, 0.69), (-0.2, 0.44)),
    "right_shoulder": ((-1.44, 0.2), (-0.1, 2.96), (-0.58, 0.3)),
}
HINGES = {"knee": (0.0, 2.0), "elbow": (0.0, 2.44)}


def test_the_limits_are_the_releases_and_the_left_mirrors_the_right() -> None:
    words = ["experiment=jumping/high_gpu", "actuation=jumping/poses_strict", "actuation.run=none"]
    experiment = load_experiment(words)
    given = experiment.need("actuation").effective()
    assert given["offset_limit"] == 12.0
    assert experiment.need("scene").effective()["self_collision"] is True
    limits = given["limits"]
    for name, (forward, (low, high), up) in RELEASE.items():
        assert np.allclose(limits[name], [forward, (-high, -low), up])
        if name.startswith("right_"):
            (a, b), (c, d) = forward, up
            left = limits[name.replace("right", "left")]
            assert np.allclose(left, [(-b, -a), (-high, -low), (-d, -c)])
    for name, axis in HINGES.items():
        for side in ("left", "right"):
            assert np.allclose(limits[f"{side}_{name}"], [axis])
    assert len(limits) == len(RELEASE) + 3 + 4
