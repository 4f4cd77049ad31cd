"""Contacts of the feet with the ground, on motions whose contacts are known."""

# MuJoCo has no stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from dataclasses import replace

import mujoco
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from understudy_characters.character import Character
from understudy_characters.contacts import FAST, HIGH, SLOW, feet, foot_contacts, latched
from understudy_humanoid.character import build_spec
from understudy_humanoid.clips.walk import TOE_OFF, generated_walk
from understudy_motion.clip import Clip

DOG = """
<mujoco><worldbody><body name="trunk" pos="0 0 .5"><freejoint/>
  <geom type="box" size=".3 .1 .1"/>
  <body name="head" pos=".4 0 .1"><joint axis="0 1 0"/><geom type="sphere" size=".1"/></body>
  {legs}
</body></worldbody></mujoco>
"""
LEG = """
<body name="{name}_thigh" pos="{x} {y} 0"><joint axis="0 1 0"/>
  <geom type="capsule" size=".03" fromto="0 0 0 0 0 -.2"/>
  <body name="{name}_shin" pos="0 0 -.2"><joint axis="0 1 0"/>
    <geom type="capsule" size=".03" fromto="0 0 0 0 0 -.2"/></body></body>
"""
PAWS = {"front_left": (0.3, 0.1), "front_right": (0.3, -0.1), "left": (-0.3, 0.1), "right": (-0.3, -0.1)}  # fmt: skip


@pytest.fixture(scope="module")
def humanoid() -> Character:
    return Character("humanoid", build_spec().compile())


def still(character: Character, velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Clip:
    """The zero pose at 60 frames/s for a second, carried along at `velocity` m/s."""
    times = torch.arange(61, dtype=torch.float64) / 60
    qpos = torch.tensor(character.model.qpos0, dtype=torch.float64).repeat(61, 1)
    qpos[:, :3] += times[:, None] * torch.tensor(velocity, dtype=torch.float64)
    return character.clip(qpos, times, name="still")


def raised(clip: Clip, height: float) -> Clip:
    up = torch.tensor([0.0, 0.0, height], dtype=torch.float64)
    return replace(clip, root_position=clip.root_position + up)


def test_feet_are_what_the_zero_pose_stands_on(humanoid: Character) -> None:
    assert feet(humanoid) == ("right_ankle", "left_ankle")
    legs = "".join(LEG.format(name=name, x=x, y=y) for name, (x, y) in PAWS.items())
    dog = Character("dog", mujoco.MjModel.from_xml_string(DOG.format(legs=legs)))
    assert set(feet(dog)) == {f"{name}_shin" for name in PAWS}


def test_a_walk_is_in_contact_for_its_stance(humanoid: Character) -> None:
    walk = generated_walk()
    found = foot_contacts(humanoid, walk)
    assert found.shape == (walk.num_frames, 2)
    share = found[:-1].double().mean(dim=0)
    assert torch.allclose(share, torch.full((2,), TOE_OFF, dtype=torch.float64), atol=0.05)
    assert found.any(dim=1).all(), "a walk has a foot on the ground always"
    assert (found[:-1].int().diff(dim=0).abs().sum(dim=0) <= 2).all(), "it flickers"


def test_a_loop_begins_as_it_ends(humanoid: Character) -> None:
    found = foot_contacts(humanoid, generated_walk())
    assert torch.equal(found[0], found[-1])


def test_the_ground_may_be_at_any_height(humanoid: Character) -> None:
    walk = generated_walk()
    aloft = raised(walk, 0.3)
    assert not foot_contacts(humanoid, aloft).any()
    assert torch.equal(foot_contacts(humanoid, aloft, ground=0.3), foot_contacts(humanoid, walk))


@pytest.mark.parametrize(("speed", "touches"), [(0.0, True), (0.9 * SLOW, True), (FAST, False)])
def test_a_foot_that_moves_fast_is_not_in_contact(
    humanoid: Character, speed: float, touches: bool
) -> None:
    found = foot_contacts(humanoid, still(humanoid, (speed, 0.0, 0.0)))
    assert bool(found.all()) == touches
    assert bool(found.any()) == touches


def test_contact_once_begun_lasts_until_the_wider_limit(humanoid: Character) -> None:
    rising = still(humanoid, (0.0, 0.0, 0.1))
    found = foot_contacts(humanoid, rising)
    height = rising.root_position[:, 2] - rising.root_position[0, 2]
    assert torch.equal(found, (height < HIGH)[:, None].expand(-1, 2))
    falling = replace(rising, root_position=rising.root_position.flip(0))
    later = foot_contacts(humanoid, falling)
    assert 0 < later.sum() < found.sum()


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=40))
def test_latching_is_a_switch(frames: list[tuple[bool, bool]]) -> None:
    begins = torch.tensor([begin for begin, _ in frames])
    holds = torch.tensor([begin or hold for begin, hold in frames])
    on, expected = False, []
    for begin, hold in zip(begins.tolist(), holds.tolist(), strict=True):
        on = begin or (on and hold)
        expected.append(on)
    assert latched(begins, holds).tolist() == expected
