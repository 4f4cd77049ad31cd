"""Falling is what the clip does not do; a clip that ends, ends."""

from __future__ import annotations

import pytest
import torch

from understudy.errors import ConfigError
from understudy.setup.plugins import installed
from understudy.task import Context
from understudy_characters.parts import Fall, FloorContact, motion_end
from understudy_characters.reference import ReferenceMotion
from understudy_characters.scene import CharacterScene
from understudy_motion import library

SCENE = CharacterScene(CharacterScene.Options("humanoid"))
SKILLS = ("walk", "run", "jump", "roll", "cartwheel", "dance_a", "run_jump", "backflip")


@pytest.fixture
def context() -> Context:
    return Context(0, torch.device("cpu"), 2, control_dt=1 / 30, substeps=20, scene=SCENE)


def standing(height: float = 0.0) -> tuple[torch.Tensor, torch.Tensor]:
    data = SCENE.character.zero_pose
    xpos = torch.tensor(data.xpos).float()[None].repeat(2, 1, 1)
    xpos[1, :, 2] += height
    return xpos, torch.tensor(data.xmat).float()[None].repeat(2, 1, 1)


def test_a_trunk_on_the_floor_is_a_contact(context: Context) -> None:
    contact = FloorContact(FloorContact.Options(), context)
    height = SCENE.poses.state(torch.tensor(SCENE.model.qpos0)[None])["link_clearances"]
    root = height[0, SCENE.layout.link_names.index("root")].item()
    assert contact(*standing(-root + 1e-3)).tolist() == [False, False]
    assert contact(*standing(-root - 1e-3)).tolist() == [False, True]
    feet = FloorContact(FloorContact.Options(bodies=("left_ankle",)), context)
    assert feet(*standing(0.01)).tolist() == [True, False]


def test_what_the_reference_brings_to_the_floor_may_touch_it(context: Context) -> None:
    fall = Fall(Fall.Options(), context)
    links = SCENE.layout.link_names
    xpos, xmat = standing(-0.9)  # root in the floor
    high = torch.full((2, len(links)), 0.5)
    low = high.clone()
    low[:, links.index("root")] = 0.15
    assert fall(xpos, xmat, high).tolist() == [False, True]
    assert fall(xpos, xmat, low).tolist() == [False, False]
    others = high.clone()
    others[:, links.index("left_ankle")] = 0.0  # that the feet are down excuses no fall
    assert fall(xpos, xmat, others).tolist() == [False, True]


def test_how_near_a_fall_is_is_the_share_of_the_height_that_is_lost(context: Context) -> None:
    fall = Fall(Fall.Options(bodies=("root",)), context)
    links = SCENE.layout.link_names
    row = links.index("root")
    height = SCENE.poses.state(torch.tensor(SCENE.model.qpos0)[None])["link_clearances"][0, row]
    reference = torch.full((2, len(links)), float(height))
    for lost in (0.0, 0.5, 0.99, 1.01):
        used = fall.used(*standing(-lost * float(height)), reference)
        assert used[1].tolist() == pytest.approx([lost], abs=1e-4)
        assert fall(*standing(-lost * float(height)), reference).tolist() == [False, lost > 1]
    assert fall.used(*standing(1.0), reference)[1].tolist() == [0.0]  # higher than it
    meant = torch.full((2, len(links)), 0.1)  # where the motion has it near the floor
    assert fall.used(*standing(-0.9), meant).tolist() == [[0.0], [0.0]]


def test_no_body_of_another_name(context: Context) -> None:
    with pytest.raises(ConfigError, match=r"characters/fall: no body 'nek'\. Did you mean 'neck'"):
        Fall(Fall.Options(bodies=("nek",)), context)


@pytest.mark.skipif(library.data_folder() is None, reason="UNDERSTUDY_DATA is not set")
@pytest.mark.parametrize("skill", SKILLS)
def test_no_skills_reference_is_a_fall_even_where_it_touches(context: Context, skill: str) -> None:
    """Played up to 20 cm too low, which the bound on the centre of mass allows."""
    clip = library.load(f"humanoid3d_{skill}", None, installed().registry, {})
    reference = ReferenceMotion(clip, SCENE.character, SCENE.layout, control_dt=1 / 30)
    fields = reference.sample(torch.linspace(0.0, reference.duration, 200))
    clearance = fields["reference_link_clearances"]
    rows = [SCENE.layout.link_names.index(name) for name in SCENE.layout.upright]
    assert (clearance[:, rows] > 0.0).all()
    lowered = clearance[:, rows] - 0.2
    fall = (lowered <= 0.0) & (clearance[:, rows] > Fall.Options().margin)
    assert not fall.any()
    if skill == "roll":
        assert (lowered <= 0.0).any(), "the back comes near the floor, which this test is about"


def test_the_end_is_where_nothing_is_left() -> None:
    ended = torch.tensor([True, False])
    assert motion_end(ended) is ended
