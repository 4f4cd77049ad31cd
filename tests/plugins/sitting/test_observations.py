"""What the skills see: sizes and frames of section 4."""

from __future__ import annotations

import math

import pytest
import torch
from sitting_tasks import build, follow_clip

from understudy.setup.building import Built
from understudy_characters.scene import CharacterScene
from understudy_sitting.state import Seat, chair_of
from understudy_tensors import rotations


def test_sizes_of_section_4(sit: Built) -> None:
    assert sit.environment.observation_shapes == {"state": (57,)}
    assert build("experiment=sitting/walk", "num_worlds=1").environment.observation_shapes == {
        "state": (52,)
    }
    turn = build("experiment=sitting/turn_right", "num_worlds=1")
    assert turn.environment.observation_shapes == {"state": (50,)}
    assert turn.environment.action_size == 21


def test_proprioception_in_order(sit: Built) -> None:
    environment = sit.environment
    environment.reset()
    table = environment.table
    seen = table["proprioception"][0]
    torch.testing.assert_close(seen[:21].sort()[0], table["qpos"][0, 7:].sort()[0])
    torch.testing.assert_close(seen[21:42].sort()[0], table["qvel"][0, 6:].sort()[0])
    assert float(seen[42]) == pytest.approx(float(table["torso_position"][0, 2]))
    assert float(seen[42]) == pytest.approx(1.11, abs=0.03)  # standing
    pitch, yaw, roll = table["torso_angles"][0].tolist()
    assert seen[46:48].tolist() == pytest.approx([pitch, roll])
    assert abs(yaw) < 1e-3
    follow_clip(environment, 10)
    assert environment.table["proprioception"][0, 48:].tolist() == [1.0, 1.0]  # on both feet


@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_the_chair_as_the_figure_sees_it(sit: Built, heading: float) -> None:
    """Whoever faces the chair from 1 m ahead of its seat sees it 1 m ahead, turned by half a turn."""
    environment = sit.environment
    environment.reset()
    state = {
        name: environment.table[name].clone()
        for name in ("qpos", "qvel", "mocap_pos/chair", "mocap_quat/chair")
    }
    angle = torch.full((4,), heading)
    state["qpos"][:, :2] = torch.stack([angle.cos(), angle.sin()], dim=1)
    state["qpos"][:, 3:7] = rotations.from_heading(angle + math.pi - 0.001)
    state["mocap_pos/chair"][:] = 0.0
    state["mocap_quat/chair"][:] = rotations.from_heading(angle)
    everywhere = torch.ones(4, dtype=torch.bool)
    environment.parts.simulator.set_state(everywhere, state)
    environment.refresh()
    seen = environment.table["chair_state"][0]
    height = 0.45 - float(state["qpos"][0, 2])
    assert seen[:3].tolist() == pytest.approx([1.0, 0.001, height], abs=2e-2)
    assert seen[3:].abs().tolist() == pytest.approx([0, 0, 0, 1], abs=2e-2)
    assert float(environment.table["seat_distance"][0]) == pytest.approx(
        math.hypot(1.0, height), abs=1e-3
    )


def test_the_pelvis_is_felt_on_the_seat(sit: Built) -> None:
    sit.environment.reset()
    follow_clip(sit.environment, 20)
    assert not sit.environment.table["seated"].any()
    environment = build("experiment=sitting/sit", "num_worlds=2", "initial_states.span=[1,1]")
    environment = environment.environment
    environment.reset()
    follow_clip(environment, 30)
    assert environment.table["seat_contact"].all()
    assert environment.table["seated"].all()
    assert float(environment.table["seat_distance"].max()) < 0.2
    assert float(environment.table["seated_seconds"].min()) == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize(
    ("degrees", "about", "aside", "sits"),
    [
        (40.0, "y", 0.0, True),
        (50.0, "y", 0.0, False),
        (-50.0, "x", 0.0, False),
        (50.0, "z", 0.0, True),
        (70.0, "z", 0.0, False),
        (0.0, "z", 0.2, True),
        (0.0, "z", 0.25, False),
    ],
)
def test_who_lies_across_the_seat_faces_elsewhere_or_is_on_its_edge_does_not_sit(
    sit: Built, degrees: float, about: str, aside: float, sits: bool
) -> None:
    """The same contact: the torso tilted by 45° or more, turned by 60° or more from where the chair faces, or the
    pelvis 0.25 m or more from the seat's middle, 0.1 m above it."""
    tilt, turn = (degrees, 0.0) if about != "z" else (0.0, degrees)
    pitch, roll = (tilt, 0.0) if about == "y" else (0.0, tilt)
    angles = torch.deg2rad(torch.tensor([[pitch, turn, roll]]))
    table, scene = sit.environment.table, sit.context.scene
    assert isinstance(scene, CharacterScene)
    seat = table["geom_xpos"][:1, chair_of(scene.model)[1]]
    xpos = table["xpos"][:1].clone()
    xpos[:, scene.character.root] = seat + torch.tensor([0.0, aside, 0.1])
    found = Seat(Seat.Options(), sit.context).compute(
        xpos=xpos,
        xquat=torch.tensor([1.0, 0.0, 0.0, 0.0]).expand_as(table["xquat"][:1]),
        geom_xpos=table["geom_xpos"][:1],
        torso_angles=angles,
        sensor_seated=torch.ones(1, 1),
    )
    assert float(found["seat_contact"]) == 1.0
    assert bool(found["seated"]) is sits
