"""How far feet slide and sink, of a figure that stands, is moved, turns on its heel and is lifted."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from understudy.task import Context
from understudy_characters.contacts import foot_points
from understudy_characters.footing import Footing
from understudy_characters.scene import CharacterScene

SCENE = CharacterScene(CharacterScene.Options("humanoid"))
DT = 1 / 60
LOWEST = float(SCENE.character.clearance(torch.tensor(SCENE.model.qpos0)[None]).min())


@pytest.fixture
def footing() -> Footing:
    context = Context(0, torch.device("cpu"), 1, control_dt=DT, substeps=20, scene=SCENE)
    return Footing(Footing.Options(), context)


def placed(*, x: float = 0.0, z: float = 0.0) -> dict[str, Tensor]:
    """The zero pose with its soles `z` m above the floor."""
    data = SCENE.character.zero_pose
    xpos = torch.tensor(data.xpos).float()[None].clone()
    xpos += torch.tensor([x, 0.0, z - LOWEST])
    return {"xpos": xpos, "xmat": torch.tensor(data.xmat).float()[None]}


def kept(footing: Footing, *steps: dict[str, Tensor]) -> dict[str, float]:
    found = dict(footing.begin(**steps[0]))
    for fields in steps[1:]:
        found = dict(footing.advance(found, **fields))
    return {name: float(found[name]) for name in ("foot_slide", "foot_sink", "foot_contacts")}


def test_who_stands_does_not_slide(footing: Footing) -> None:
    found = kept(footing, *[placed()] * 3)
    assert found["foot_slide"] == 0
    assert found["foot_sink"] == pytest.approx(0, abs=1e-6)
    assert found["foot_contacts"] == 4, "two feet in two control periods"


def test_a_figure_that_is_pushed_slides_as_fast(footing: Footing) -> None:
    found = kept(footing, placed(), placed(x=0.01), placed(x=0.03))
    assert found["foot_slide"] == pytest.approx((0.6 + 1.2) / 2, rel=1e-3)


def test_feet_in_the_air_do_not_slide(footing: Footing) -> None:
    assert kept(footing, placed(z=0.02), placed(x=0.1, z=0.02))["foot_slide"] == 0
    landing = kept(footing, placed(z=0.05), placed(x=0.1), placed(x=0.1))
    assert landing["foot_contacts"] == 2
    assert landing["foot_slide"] == pytest.approx(0, abs=1e-4)


def test_the_deepest_counts(footing: Footing) -> None:
    found = kept(footing, placed(), placed(z=-0.03), placed(z=-0.01))
    assert found["foot_sink"] == pytest.approx(0.03, abs=1e-5)


def test_a_foot_that_turns_on_its_heel_does_not_slide(footing: Footing) -> None:
    """All of the figure turns about a corner of its right foot: that foot stays, the other slides."""
    before = placed()
    corners = footing.begin(**before)["foot_corners"][0]
    row = list(foot_points(SCENE.character)).index("right_ankle")
    pivot = corners[row, corners[row, :, 2].argmin()]
    angle = 0.05
    turn = torch.tensor(
        [
            [math.cos(angle), -math.sin(angle), 0.0],
            [math.sin(angle), math.cos(angle), 0.0],
            [0.0, 0.0, 1.0],
        ]
    )
    after = {
        "xpos": (before["xpos"] - pivot) @ turn.T + pivot,
        "xmat": (turn @ before["xmat"].view(1, -1, 3, 3)).view(before["xmat"].shape),
    }
    away = (corners[1 - row] - pivot)[:, :2].norm(dim=1).min()
    expected = (
        2 * math.sin(angle / 2) * float(away) / DT / 2
    )  # the mean of it and of the one at rest
    assert kept(footing, before, after)["foot_slide"] == pytest.approx(expected, rel=1e-3)
