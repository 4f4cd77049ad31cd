"""Particles that sub-steps are too long for: how far piles sink into themselves, and what is said of it."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from granular import MASS, RADIUS, Scene, control, lattice, tied
from torch import Tensor

from understudy.errors import ConfigError
from understudy.task import Context
from understudy_pbd.scene import Fluid, Material, ParticleModel, Table
from understudy_pbd.simulator import ParticleSimulator
from understudy_warp_torch.tools import Box, Tool


def pile(layers: int, springs: bool = False) -> ParticleModel:
    """On a table with walls that fit."""
    x = lattice((4, 4, layers), 2 * RADIUS, (RADIUS, RADIUS, RADIUS))
    table = Table(0.4, (0.0, 0.0), (8 * RADIUS, 8 * RADIUS))
    found = ParticleModel(x, RADIUS, MASS, table=table)
    return replace(found, springs=tied(x, 3.6 * RADIUS)) if springs else found


def built(model: ParticleModel, rate: float, worlds: int = 1, **options: Any) -> ParticleSimulator:
    """With so many sub-steps a second."""
    context = Context(0, torch.device("cpu"), worlds, 1 / rate, 1, scene=Scene(model))
    return ParticleSimulator(ParticleSimulator.Options(**options), context)


@pytest.mark.parametrize(("layers", "springs"), [(6, False), (12, False), (12, True)])
def test_a_pile_sinks_as_is_foreseen(layers: int, springs: bool) -> None:
    model, rate = pile(layers, springs), 170.0
    share = (3.0 if springs else 1.2) * layers * 9.81 / rate**2 / (2 * RADIUS) / 8
    found = built(model, rate)
    for _ in range(round(3 * rate)):
        found.step(torch.zeros(1, 0))
    top = float(found.read("particle_position")[0, :, 2].max()) + RADIUS
    assert 1 - top / (2 * RADIUS * layers) == pytest.approx(share, rel=0.4)


def test_it_is_refused_told_or_neither() -> None:
    model = pile(12)
    need = (1.2 * 12 * 9.81 / (2 * RADIUS) / 8 / 0.15) ** 0.5
    with warnings.catch_warnings(action="error"):
        built(model, 1.01 * need)
        built(model, 0.6 * need, iterations=24)
        built(pile(4), 0.6 * need)
        built(replace(model, gravity=(0.0, 0.0, 0.0)), 1.0)
    with pytest.warns(
        UserWarning, match=rf"pile of 12 layers some 1\d % .* {int(need) + 1} sub-steps"
    ):
        built(model, 0.95 * need)
    with pytest.warns(UserWarning, match="pile of 12 layers"):
        built(pile(12, springs=True), 1.01 * need)
    with pytest.raises(ConfigError, match=r"60 % lower, .*control\.substeps.*iterations"):
        built(model, 0.5 * need)


def test_a_fluid_stands_on_its_density() -> None:
    fluid = Material(fluid=Fluid(MASS / (2 * RADIUS) ** 3, 4 * RADIUS))
    model = replace(pile(12), materials=(fluid,))
    with warnings.catch_warnings(action="error"):
        built(model, 13.0)
    grain = np.zeros(len(model.positions), int)
    grain[0] = 1  # one alone is no pile
    with warnings.catch_warnings(action="error"):
        built(replace(model, material=grain, materials=(fluid, Material())), 60.0)


def begun(found: ParticleSimulator, **values: Tensor) -> ParticleSimulator:
    state = {name: found.read(name).clone() for name in found.state_fields}
    found.set_state(
        torch.ones(len(found.read("particle_position")), dtype=torch.bool), {**state, **values}
    )
    return found


def test_the_strongest_gravity_of_all_worlds_counts() -> None:
    model = pile(12)
    need = (1.2 * 12 * 9.81 / (2 * RADIUS) / 8 / 0.15) ** 0.5

    def varied(*times: float) -> ParticleSimulator:
        found = built(model, 1.5 * need, len(times))
        found.vary(["gravity"])
        return begun(found, gravity=torch.tensor([[0.0, 0.0, -9.81 * each] for each in times]))

    with warnings.catch_warnings(action="error"):
        varied(2.0, 1.0)
    with pytest.warns(UserWarning, match=r"20 % lower.* strongest gravity .* 29\.4 m/s²"):
        varied(3.0, 1.0)
    with pytest.raises(ConfigError, match=r"67 % lower.* strongest gravity .* 98\.1 m/s²"):
        varied(1.0, 10.0)


@pytest.mark.parametrize(("below", "ends", "counted"), [(0.0, 9.0, True), (0.5, -0.3, False)])
def test_a_tool_that_lifts_a_pile_counts_once_it_touches_it(
    below: float, ends: float, counted: bool
) -> None:
    floor = Tool((Box((0.1, 0.1, 0.02)),), (0.04, 0.04, -0.02 - below))
    model = replace(pile(6), table=None, tools=(floor,), gravity=(0.0, 0.0, -1.0))
    found = begun(built(model, 120.0))
    height, speed = -0.02 - below, 0.0
    for _ in range(30):
        speed += 100.0 / 120
        height += speed / 120
        found.step(control(found, 0.04, 0.04, min(height, ends), 0.0, 0.0, 0.0))
    assert ("sub_steps_too_long" in found.report()) == counted
