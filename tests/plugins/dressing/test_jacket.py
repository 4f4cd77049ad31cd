"""The jacket in the hand that holds it, and the subtask that begins there."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy_cloth.mesh import face_areas
from understudy_dressing.jacket import JacketScene
from understudy_dressing.person import PersonScene, depth_in

pytest.importorskip("potpourri3d", reason="potpourri3d is not installed")
JACKET = JacketScene(JacketScene.Options(edge=0.03))


def test_it_hangs_from_the_hand_in_nobody() -> None:
    pose, x = JACKET.hung()
    assert (face_areas(x[JACKET.faces]) / face_areas(JACKET.corners)).max() < 1.5
    assert depth_in(PersonScene(PersonScene.Options()), pose)(x).max() < 0.0
    held = x[JACKET.patch].mean(axis=0)
    assert held == pytest.approx(JACKET.begins[JACKET.patch].mean(axis=0), abs=0.01)
    assert held[2] - np.median(x[:, 2]) > 0.15, "the rest hangs below"
    entrance = JACKET.garment.positions[JACKET.garment.loops["right_entrance"]]
    patch = JACKET.garment.positions[JACKET.patch].mean(axis=0)
    assert np.linalg.norm(entrance - patch, axis=1).min() == pytest.approx(0.145, abs=0.03)


def test_the_first_subtask_begins_untorn_and_runs() -> None:
    words = ["experiment=dressing/jacket_sleeve", "device=cpu", "curriculum=null", "simulators.person.name=mujoco",
             "scenes.cloth.edge=0.03", "num_worlds=2"]  # fmt: skip
    environment = build_environment(load_experiment(words)).environment
    try:
        environment.reset(seed=1)
        table = environment.table
        assert (table["area_ratio"] < 1.5).all()
        assert (table["progress"] < 0).all(), "no arm is in it"
        for _ in range(3):
            step = environment.advance(torch.zeros(2, environment.action_size))
            assert torch.isfinite(step.rewards).all()
            assert not step.ended.any()
        assert (table["area_ratio"] < 1.3).all()
        assert (table["grip_closed"] == 1).all()
    finally:
        environment.close()
