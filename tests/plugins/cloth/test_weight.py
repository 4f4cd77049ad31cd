"""Cloth that sub-steps are too long for: how much longer its weight makes it, and what is said of it."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch
from sheets import control, run, sheet, simulator, tube
from torch import Tensor

from understudy.errors import ConfigError
from understudy_cloth.scene import ClothModel, Fabric, Grip, Tool
from understudy_cloth.simulator import ClothSimulator
from understudy_cloth.weight import compliance_of, sub_steps_needed

FABRIC = Fabric(bending=0.0, damping=5.0)


def strip(edge: float = 0.025, rows: int = 17, fabric: Fabric = FABRIC) -> ClothModel:
    """Hangs from its first row along −z."""
    x, faces = sheet(5, rows, edge)
    return ClothModel(x[:, [0, 2, 1]] * (1, 1, -1), faces[:, [0, 2, 1]], fabric, pinned=range(5))


def pipe() -> ClothModel:
    x, faces = tube(16, 12, 0.064, 0.025)
    return ClothModel(x[:, [1, 2, 0]] * (1, 1, -1), faces[:, [0, 2, 1]], FABRIC, pinned=range(16))


def pull(model: ClothModel) -> float:
    """1/s², times Δt² the share by which its weight makes it longer."""
    return compliance_of(model).share(9.81, 1.0)


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
        dt = (share / pull(model)) ** 0.5
        assert longer(model, dt) == pytest.approx(share, rel=0.35), f"{1e3 * dt:.2f} ms"


def test_stiffer_cloth_is_as_long() -> None:
    model = strip()
    dt = (0.2 / pull(model)) ** 0.5
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
    edge = 0.025 * (1 + (2**0.5 - 1) * 64 / 212)  # diagonals are edges
    assert pull(model) == pytest.approx(0.45 * 9.81 * 16 * 0.025 / edge**2)
    held = Grip(0, range(80, 85))  # the last row, too: a half hangs from each
    both = replace(model, tools=(Tool(()),), grips=(held,))
    assert pull(both) == pytest.approx(0.5 * pull(model))
    loose = replace(model, pinned=())
    assert pull(loose) == pytest.approx(0.5 * pull(model), rel=0.15), "over something in the middle"
    x, faces = model.positions, np.asarray(model.faces)
    two = ClothModel(
        np.concatenate([x, x + 1.0]),
        np.concatenate([faces, faces + len(x)]),
        FABRIC,
        pinned=range(5),
    )
    assert pull(two) == pytest.approx(pull(model)), "what falls carries nothing"


def begun(found: ClothSimulator, **values: Tensor) -> ClothSimulator:
    state = {name: found.read(name).clone() for name in found.state_fields}
    found.set_state(
        torch.ones(len(found.read("cloth_position")), dtype=torch.bool), {**state, **values}
    )
    return found


def test_the_strongest_gravity_of_all_worlds_counts() -> None:
    model = strip()
    dt = (0.05 / pull(model)) ** 0.5

    def varied(*times: float) -> ClothSimulator:
        found = simulator(model, len(times), substeps=1, period=dt, self_contact=False)
        found.vary(["gravity"])
        return begun(found, gravity=torch.tensor([[0.0, 0.0, -9.81 * each] for each in times]))

    with warnings.catch_warnings(action="error"):
        found = varied(1.0, 1.9)
    with pytest.warns(UserWarning, match=r"15 % longer.* strongest gravity .* 29\.4 m/s²"):
        varied(1.0, 3.0)
    with pytest.raises(ConfigError, match=r"60 % longer.* strongest gravity .* 118 m/s²"):
        varied(1.0, 12.0)
    found.step(control(found))
    assert not found.report()
    begun(found, gravity=torch.tensor([[0.0, 0.0, -9.0], [0.0, 30.0, 0.0]]))  # a later draw
    found.step(control(found))
    assert found.report() == {"sub_steps_too_long": 1}


HELD = replace(strip(fabric=replace(FABRIC, damping=1.0)), pinned=(), tools=(Tool(()),), grips=(Grip(0, range(5)),))  # fmt: skip


def lifted(
    acceleration: float, seconds: float, hangs: float = 4.0, closed: float = 1.0
) -> tuple[float, ClothSimulator]:
    """The share by which it is longer at most after it `hangs`, of a gripper that then accelerates upwards and stops."""
    dt = (0.08 / pull(HELD)) ** 0.5
    found = begun(simulator(HELD, substeps=1, period=dt, self_contact=False))
    most, height, speed = 0.0, 0.0, 0.0
    for step in range(round((hangs + seconds) / dt)):
        speed += acceleration * dt if step * dt > hangs else 0.0
        height += speed * dt
        low = run(found, 1, 0.0, 0.0, height, 0.0, 0.0, 0.0, closed)[:, 2].min()
        if step * dt > hangs:
            most = max(most, float(height - low) / 0.4 - 1)
    return most, found


def test_a_gripper_that_accelerates_pulls_like_gravity() -> None:
    most, found = lifted(0.0, 0.3)
    assert most == pytest.approx(0.08, rel=0.35)
    assert not found.report()
    most, found = lifted(9.81, 0.5)
    assert 0.16 < most < 0.33, "twice its weight, which it overshoots"
    assert found.report()["sub_steps_too_long"] > 30
    assert not lifted(-9.81, 0.5)[1].report(), "it falls with the gripper"
    assert not lifted(9.81, 0.01)[1].report(), "over before the cloth has given way"
    assert not lifted(9.81, 0.5, closed=0.0)[1].report(), "nothing is held"
