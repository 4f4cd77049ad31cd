"""Cloth that sub-steps are too long for: how much longer its weight makes it, and what is said of it."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from sheets import run, sheet, simulator, tube

from understudy.errors import ConfigError
from understudy_cloth.scene import ClothModel, Fabric, Grip, Tool
from understudy_cloth.weight import _pull, sub_steps_needed

FABRIC = Fabric(bending=0.0, damping=5.0)


def strip(edge: float = 0.025, rows: int = 17, fabric: Fabric = FABRIC) -> ClothModel:
    """Hangs from its first row along −z."""
    x, faces = sheet(5, rows, edge)
    return ClothModel(x[:, [0, 2, 1]] * (1, 1, -1), faces[:, [0, 2, 1]], fabric, pinned=range(5))


def pipe() -> ClothModel:
    x, faces = tube(16, 12, 0.064, 0.025)
    return ClothModel(x[:, [1, 2, 0]] * (1, 1, -1), faces[:, [0, 2, 1]], FABRIC, pinned=range(16))


def longer(model: ClothModel, dt: float) -> float:
    """By what share, once it hangs still."""
    found = simulator(model, substeps=1, period=dt, self_contact=False)
    low = run(found, round(4.0 / dt))[:, 2].min()
    assert found.read("cloth_velocity").abs().max() < 0.05, "it still swings"
    return float(low / model.positions[:, 2].min()) - 1


@pytest.mark.filterwarnings("ignore:The cloth's sub-step")
@pytest.mark.parametrize(
    "model",
    [strip(), strip(0.05, 9), strip(0.0125, 33), strip(rows=33), strip(fabric=replace(FABRIC, stretch=1e7)), pipe()],
    ids=["strip", "coarse", "fine", "long", "stiff", "tube"],
)  # fmt: skip
def test_its_weight_makes_it_longer_as_is_foreseen(model: ClothModel) -> None:
    for share in (0.01, 0.4):
        dt = (share / _pull(model)[0]) ** 0.5
        assert longer(model, dt) == pytest.approx(share, rel=0.35), f"{1e3 * dt:.2f} ms"


def test_stiffer_cloth_is_as_long() -> None:
    model = strip()
    dt = (0.2 / _pull(model)[0]) ** 0.5
    stiff = replace(model, fabric=replace(FABRIC, stretch=1e7, shear=1e7))
    with pytest.warns(UserWarning, match="however stiff its fabric"):
        found = longer(stiff, dt)
    with pytest.warns(UserWarning, match="however stiff its fabric"):
        assert longer(model, dt) == pytest.approx(found, rel=0.02)


def test_it_is_refused_told_or_neither() -> None:
    model = strip()
    need = sub_steps_needed(model)
    with warnings.catch_warnings(action="error"):
        simulator(model, substeps=1, period=0.999 / need)
        simulator(replace(model, gravity=(0.0, 0.0, 0.0)), substeps=1, period=1.0)
    with pytest.warns(UserWarning, match=rf"10 % longer.* {math.ceil(need)} sub-steps a second"):
        simulator(model, substeps=1, period=1 / (need - 0.7))
    with pytest.raises(ConfigError, match=r"100 % longer.*control\.substeps.*scene\.steps\.MEMBER"):
        simulator(model, substeps=1, period=10**0.5 / need)


def test_what_hangs_is_what_is_far_from_what_holds_it() -> None:
    model = strip()
    pull, edge = _pull(model)
    assert edge == pytest.approx(0.025 * (1 + (2**0.5 - 1) * 64 / 212)), "diagonals are edges"
    held = Grip(0, range(80, 85))  # the last row, too: a half hangs from each
    both = replace(model, tools=(Tool(()),), grips=(held,))
    assert _pull(both)[0] == pytest.approx(0.5 * pull)
    loose = replace(model, pinned=())
    assert _pull(loose)[0] == pytest.approx(0.5 * pull, rel=0.15), "over something in the middle"
    x, faces = model.positions, np.asarray(model.faces)
    two = ClothModel(
        np.concatenate([x, x + 1.0]),
        np.concatenate([faces, faces + len(x)]),
        FABRIC,
        pinned=range(5),
    )
    assert _pull(two)[0] == pytest.approx(pull), "what falls carries nothing"
