"""What tools feel: forces by weight and by momentum, sensors, and the face that is touched."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from granular import MASS, PERIOD, RADIUS, Scene, control, lattice, run, simulator, tied
from torch import Tensor

from understudy.errors import ConfigError
from understudy.task import Context
from understudy_pbd.scene import Box, ParticleModel, Tool, pan
from understudy_pbd.simulator import ParticleSimulator
from understudy_pbd.touch import Touch, felt

G = 9.81
PLATE = Tool((Box((0.08, 0.08, 0.005)),), friction=0.4)


def touch(model: ParticleModel, **options: Any) -> Touch:
    context = Context(0, torch.device("cpu"), 1, PERIOD, 4, scene=Scene(model))
    return Touch(Touch.Options(**options), context)


def feel(part: Touch, found: ParticleSimulator) -> Tensor:
    """(4 S,) of the first world."""
    return part.encode(**{name: found.read(name) for name in part.reads})[0]


@pytest.mark.parametrize("springs", [False, True])
@pytest.mark.parametrize("iterations", [4, 8])
def test_a_pan_feels_the_weight_that_lies_in_it(springs: bool, iterations: int) -> None:
    grains = lattice((4, 4, 2), 2.05 * RADIUS, (-0.03, -0.03, 0.115))
    ties = {"springs": tied(grains, 4.2 * RADIUS)} if springs else {}
    model = ParticleModel(grains, RADIUS, MASS, tools=(Tool(pan(0.1, 0.04), (0, 0, 0.1)),), **ties)
    found = simulator(model, iterations=iterations)
    run(found, 60, 0, 0, 0.1, 0, 0, 0)
    total = found.read("contact_force")[0].sum(dim=0)
    assert total.tolist() == pytest.approx([0, 0, 32 * MASS * G], abs=0.03 * 32 * MASS * G)
    assert feel(touch(model), found).tolist() == pytest.approx([0, 0, -1, 1], abs=0.03)
    in_newtons = feel(touch(model, force=2.0), found)
    assert in_newtons[2] == pytest.approx(-32 * MASS * G / 2, rel=0.03)


@pytest.mark.parametrize(
    "speed", [0.3, 3.0, 12.0]
)  # the last two miss the particle but for the sweep
def test_what_a_tool_gives_is_the_change_of_momentum(speed: float) -> None:
    model = ParticleModel(
        [[0.05, 0.0, 0.5]], RADIUS, MASS, tools=(Tool((Box((0.005, 0.05, 0.05)),), (0, 0, 0.5)),),
        gravity=(0, 0, 0), table=None,
    )  # fmt: skip
    found = simulator(model)
    given = torch.zeros(3)
    for period in range(1, 20):
        found.step(control(found, speed * PERIOD * period, 0.0, 0.5, 0.0, 0.0, 0.0))
        given += PERIOD * found.read("contact_force")[0, 0]
    velocity = found.read("particle_velocity")[0, 0]
    assert velocity[0] > 0.9 * speed
    torch.testing.assert_close(given, MASS * velocity, rtol=1e-3, atol=1e-6)


def test_it_is_the_last_period_alone_and_nothing_when_an_episode_begins() -> None:
    grains = lattice((3, 3, 1), 2.05 * RADIUS, (-0.02, -0.02, 0.12))
    found = simulator(
        ParticleModel(grains, RADIUS, MASS, tools=(Tool(pan(0.1, 0.04), (0, 0, 0.1)),))
    )
    begin = {name: found.read(name).clone() for name in found.state_fields}
    run(found, 30, 0, 0, 0.1, 0, 0, 0)
    assert (found.read("contact_force")[0, :, 2] > 0).all()
    found.step(control(found, 0, 0, 0.05, 0, 0, 0))  # from under them
    found.step(control(found, 0, 0, 0.02, 0, 0, 0))
    assert (found.read("contact_force") == 0).all()
    run(found, 30, 0, 0, 0.02, 0, 0, 0)
    assert (found.read("contact_force")[0, :, 2] > 0).all()
    found.set_state(torch.ones(1, dtype=torch.bool), begin)
    assert (found.read("contact_force") == 0).all()


@pytest.mark.parametrize(("roll", "upper"), [(0.0, 1), (torch.pi, -1)])
def test_the_sign_says_on_which_face_it_is(roll: float, upper: int) -> None:
    """Above a plate that goes up, or below one that goes down; turned over, it is the other face."""
    block = lattice((3, 3, 2), 2.0 * RADIUS, (-0.02, -0.02, RADIUS))
    for below, sign in ((False, upper), (True, -upper)):
        height = 0.05 if below else 0.1
        places = block if below else block + np.array([0.0, 0.0, 0.11])
        plate = Tool(PLATE.shapes, (0, 0, height), (np.cos(0.5 * roll), np.sin(0.5 * roll), 0, 0))
        model = ParticleModel(places, RADIUS, MASS, tools=(plate,), gravity=(0, 0, 0))
        found = simulator(model)
        for k in range(20):  # against the table, or with nothing but inertia behind it
            by = -0.0005 * k if below else 0.002 * k * k / 30
            found.step(control(found, 0, 0, height + by, roll, 0, 0))
        force = feel(touch(model, force=1.0), found)
        assert force[3] == sign
        assert force[2] * sign < 0, "it presses into the face that is touched"
        assert force[2].abs() > 10 * force[:2].abs().max()


def test_each_contact_goes_to_the_nearest_sensor_and_most_of_them_say_the_side() -> None:
    places = torch.tensor([[[1.0, 0, 0], [1.2, 0, 0], [0.8, 0, 0], [-1.0, 0.1, 0], [-2.0, 0, 0]]])
    forces = torch.tensor([[[0, 0, 1.0], [0, 0, 2.0], [0, 0.5, -4.0], [0, 3.0, -1.0], [0, 0, 0]]])
    sensors = torch.tensor([[1.0, 0, 0], [-1.0, 0, 0], [0, 9.0, 0]])
    force, side = felt(places, forces, sensors, torch.tensor([0, 0, 1.0]))
    assert force[0].tolist() == [[0, -0.5, 1], [0, -3, 1], [0, 0, 0]]
    assert side[0].tolist() == [1, -1, 0]  # two of three; the only one; none
    assert felt(places, forces, sensors, torch.tensor([0, 1.0, 0]))[1][0].tolist() == [1, 1, 0]


def test_it_turns_with_its_tool() -> None:
    part = touch(
        ParticleModel([[0.0, 0, 1]], RADIUS, MASS, tools=(PLATE,)),
        force=1.0,
        sensors=((0.1, 0, 0), (-0.1, 0, 0)),
    )
    half = 0.5**0.5  # a quarter turn to the left: the tool's x is the world's y
    found = part.encode(
        particle_position=torch.tensor([[[1.0, 2.1, 3.0]]]),
        contact_force=torch.tensor([[[0.0, 5.0, 7.0]]]),
        tool_position=torch.tensor([[1.0, 2.0, 3.0]]),
        tool_orientation=torch.tensor([[half, 0.0, 0.0, half]]),
    )[0]
    assert found.tolist() == pytest.approx([-5, 0, -7, 0, 0, 0, 1, 0], abs=1e-5)


def test_what_cannot_be_felt_is_refused() -> None:
    one = [[0.0, 0.0, 1.0]]
    with pytest.raises(ConfigError, match="one tool; this one has 2"):
        touch(ParticleModel(one, RADIUS, MASS, tools=(PLATE, PLATE)))
    with pytest.raises(ConfigError, match="give encoder 'pbd/touch' a force"):
        touch(ParticleModel(one, RADIUS, MASS, tools=(PLATE,), gravity=(0, 0, 0)))
    with pytest.raises(ValueError, match="at least one place"):
        Touch.Options(sensors=())
    with pytest.raises(ValueError, match="no direction"):
        Touch.Options(face=(0.0, 0.0, 0.0))
