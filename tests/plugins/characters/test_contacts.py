"""What a character's feet are, and a switch with two limits."""

# MuJoCo has no stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import mujoco
import torch
from hypothesis import given
from hypothesis import strategies as st

from understudy_characters.character import Character
from understudy_characters.contacts import feet, latched

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


def test_feet_are_what_the_zero_pose_stands_on(humanoid: Character) -> None:
    assert feet(humanoid) == ("right_ankle", "left_ankle")
    legs = "".join(LEG.format(name=name, x=x, y=y) for name, (x, y) in PAWS.items())
    dog = Character("dog", mujoco.MjModel.from_xml_string(DOG.format(legs=legs)))
    assert set(feet(dog)) == {f"{name}_shin" for name in PAWS}


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=40))
def test_latching_is_a_switch(frames: list[tuple[bool, bool]]) -> None:
    begins = torch.tensor([begin for begin, _ in frames])
    holds = torch.tensor([begin or hold for begin, hold in frames])
    on, expected = False, []
    for begin, hold in zip(begins.tolist(), holds.tolist(), strict=True):
        on = begin or (on and hold)
        expected.append(on)
    assert latched(begins, holds).tolist() == expected
