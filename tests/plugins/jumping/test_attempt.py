"""What counts as touching, crossing and landing."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from arena_worlds import arena_context, fields_at
from torch import Tensor

from understudy.task import Context
from understudy_characters.scene import CharacterScene
from understudy_jumping.attempt import Attempt, Jump
from understudy_jumping.terms import feet_first, fell, lying, safety, spin

STANDING = 0.882  #: m, of the root above the ground


@pytest.fixture(scope="module")
def context() -> Context:
    return arena_context()


def pose(context: Context, x: float, z: float, pitch: float = 0.0, **joints: float) -> Tensor:
    """(1, nq): the zero pose with the root at x and z, turned by `pitch` about the left axis; hinges."""
    scene = context.scene
    assert isinstance(scene, CharacterScene)
    qpos = torch.tensor(scene.model.qpos0)[None].clone()
    qpos[0, 0], qpos[0, 2] = x, z
    qpos[0, 3], qpos[0, 5] = math.cos(pitch / 2), math.sin(pitch / 2)
    for name, angle in joints.items():
        qpos[0, scene.model.joint(name).qposadr[0]] = angle
    return qpos


def follow(
    context: Context, poses: list[Tensor], difficulty: float = 0.0, **options: object
) -> dict[str, float]:
    """What an attempt has kept after these poses, one a control period."""
    attempt = Attempt(Attempt.Options(**options), context)  # type: ignore[arg-type]
    kept = attempt.begin(**fields_at(context, poses[0], difficulty))
    for qpos in poses[1:]:
        kept = attempt.advance(kept, **fields_at(context, qpos, difficulty))
    return {name: float(value) for name, value in kept.items() if value.dim() == 1}


def test_a_body_high_above_passes(context: Context) -> None:
    """The lowest point over the obstacle is a sole's, 0.882 m below the root."""
    found = follow(context, [pose(context, x, 2.0) for x in np.linspace(-1.5, 1.5, 31)])
    assert found["crashed"] == found["landed"] == 0.0
    assert found["lowest_pass"] == pytest.approx(2.0 - STANDING, abs=0.02)


def test_feet_that_pass_too_low_crash(context: Context) -> None:
    """Soles at 0.4 m over a wall of 0.5 m, even if no control period sees them in it."""
    for steps in (31, 4):
        poses = [pose(context, x, STANDING + 0.4) for x in np.linspace(-1.5, 1.5, steps)]
        assert follow(context, poses)["crashed"] == 1.0
        assert follow(context, poses)["lowest_pass"] < 0.45


def test_a_wall_does_not_fit_between_head_and_hips(context: Context) -> None:
    """Lying on its back over the wall: no sphere is at x = 0, but the spine is."""
    lying = pose(context, -0.3, 0.52, pitch=math.pi / 2)
    found = follow(context, [pose(context, -0.3, 1.5, pitch=math.pi / 2), lying])
    assert found["crashed"] == 1.0


def test_standing_before_the_wall_is_no_crash_but_leaning_on_it_is(context: Context) -> None:
    far, near = pose(context, -0.5, STANDING + 0.01), pose(context, -0.12, STANDING + 0.01)
    assert follow(context, [far, far])["crashed"] == 0.0
    assert follow(context, [far, near])["crashed"] == 1.0, "with the toes"


def test_only_the_take_off_foot_may_touch_the_ground(context: Context) -> None:
    both = pose(context, -1.0, STANDING)
    right = pose(context, -1.0, STANDING, left_knee=1.5)
    left = pose(context, -1.0, STANDING, right_knee=1.5)
    high = pose(context, -1.0, 1.5)
    assert follow(context, [high, right])["crashed"] == 0.0
    assert follow(context, [high, left])["crashed"] == 1.0
    assert follow(context, [high, both])["crashed"] == 1.0
    assert follow(context, [high, left], take_off="left_ankle")["crashed"] == 0.0


def test_what_was_before_its_stage_does_not_count(context: Context) -> None:
    """Both feet run, and the jump then begins: what they touched is forgotten, and where they were is not."""
    attempt = Attempt(Attempt.Options(stage=1), context)
    assert "stage" in attempt.reads
    both, high = pose(context, -1.0, STANDING), pose(context, -1.0, 1.5)
    far = pose(context, 1.0, 1.5)  # through the wall's place, where nothing is judged yet
    kept = attempt.begin(**fields_at(context, both))

    def go(qpos: Tensor, stage: float) -> dict[str, Tensor]:
        return attempt.advance(kept, **fields_at(context, qpos), stage=torch.full((1,), stage))

    for qpos in (both, far, both, high):
        kept = go(qpos, 0.0)
        assert float(kept["crashed"]) == 0.0
        assert float(kept["lowest_pass"]) == float("inf")
    begun = attempt.begin(**fields_at(context, high))
    torch.testing.assert_close(kept["body_ends"], begun["body_ends"])
    assert float(go(high, 1.0)["crashed"]) == 0.0
    assert float(go(both, 1.0)["crashed"]) == 1.0


def over(context: Context, *after: Tensor) -> list[Tensor]:
    """Across the wall high above, 2 m behind it, then `after`."""
    return [pose(context, x, 2.5) for x in np.linspace(-1.5, 2.0, 20)] + list(after)


def test_landing_on_the_back_is_a_success(context: Context) -> None:
    lying = pose(context, 2.0, 0.18, pitch=-math.pi / 2)  # the mat is 0.1 m high
    found = follow(context, over(context, lying))
    assert (found["landed"], found["crashed"]) == (1.0, 0.0)
    assert found["cleared"] == pytest.approx(2.5 - STANDING, abs=0.02)


def test_landing_needs_the_trunk_or_four_links(context: Context) -> None:
    standing = pose(context, 2.0, STANDING + 0.1)
    found = follow(context, over(context, standing))
    assert found["landed"] == found["crashed"] == found["cleared"] == 0.0


def test_the_mat_may_not_be_touched_before_all_is_behind(context: Context) -> None:
    """Lying with the crown 16 cm behind the wall, and 26 cm."""
    begin = pose(context, -1.0, 2.0, pitch=-math.pi / 2)
    for x, landed in ((0.9, 0.0), (1.0, 1.0)):
        above, low = (pose(context, x, z, pitch=-math.pi / 2) for z in (2.0, 0.16))
        found = follow(context, [begin, above, low])
        assert (found["landed"], found["crashed"]) == (landed, 1.0 - landed)


def test_a_landing_beside_the_mat_is_none(context: Context) -> None:
    beside = pose(context, 2.0, 0.05, pitch=-math.pi / 2)
    beside[0, 1] = 6.0
    away = [p.clone() for p in over(context)]
    for row in away:
        row[0, 1] = 6.0
    found = follow(context, [*away, beside])
    assert (found["landed"], found["crashed"]) == (0.0, 1.0)


def test_headfirst_is_noticed(context: Context) -> None:
    """Upside down, the head's top 0.76 m below the root."""
    down = pose(context, 2.0, 0.735 + 0.1, pitch=math.pi)
    found = follow(context, over(context, down))
    assert found["head_first"] == 1.0
    assert follow(context, over(context))["head_first"] == 0.0


def test_landing_on_feet(context: Context) -> None:
    """Section 4.7.2: both feet, and nothing before them. What lies there first fails, and is told how near it came."""
    standing = pose(context, 2.0, STANDING + 0.1)
    one = pose(context, 2.0, STANDING + 0.1, left_knee=1.5)
    lying = pose(context, 2.0, 0.18, pitch=-math.pi / 2)
    for way, on_feet in (
        ([standing], 1.0), ([one, standing], 1.0), ([lying], 0.0), ([lying, standing], 0.0), ([one, lying], 0.5),
        ([one, lying, standing], 0.5),
    ):  # fmt: skip
        found = follow(context, over(context, *way), landing="feet")
        assert (found["on_feet"], found["landed"]) == (on_feet, float(on_feet == 1.0))
        assert (found["came_down"], found["crashed"]) == (1.0, 0.0)
    found = follow(context, over(context, one), landing="feet")
    assert (found["on_feet"], found["came_down"]) == (0.5, 0.0), "one foot is on its way"


def test_feet_on_the_mat_too_early_have_not_come_down(context: Context) -> None:
    near = pose(context, 0.25, STANDING + 0.1)
    found = follow(
        context, [pose(context, -1.0, 2.0), pose(context, 0.25, 2.0), near], landing="feet"
    )
    assert (found["landed"], found["came_down"], found["crashed"]) == (0.0, 0.0, 1.0)


def test_a_landing_on_feet_is_worth_more() -> None:
    """Section 4.6.1's r_safety, engineered: less for what lies down, some for one foot."""
    on_feet = torch.tensor([0.0, 0.5, 1.0])
    torch.testing.assert_close(feet_first(on_feet, fallen=0.2), torch.tensor([0.2, 0.6, 1.0]))
    down, landed = torch.tensor([0.0, 1.0, 1.0]), torch.tensor([0.0, 0.0, 1.0])
    assert fell(down, landed).tolist() == [False, True, False]


def test_the_obstacle_grows_with_the_difficulty(context: Context) -> None:
    """Table 4.1: what clears 50 cm does not clear 125 cm."""
    poses = [pose(context, x, 2.0) for x in np.linspace(-1.5, 1.5, 31)]
    assert follow(context, poses, 0.0)["crashed"] == 0.0
    assert follow(context, poses, 0.5)["crashed"] == 1.0


def test_a_box_is_touched_in_its_middle() -> None:
    context = arena_context(height=(0.5, 0.5), width=(0.05, 2.5))
    poses = [pose(context, x, STANDING + 0.7 - 0.5 * x) for x in np.linspace(-1.5, 1.2, 28)]
    assert follow(context, poses, 0.0)["crashed"] == 0.0
    assert follow(context, poses, 0.5)["crashed"] == 1.0


def test_how_wide_a_box_it_had_cleared() -> None:
    """Lying across and coming down steeply behind: what is lower than 0.5 m first, of 5 and 58 cm."""
    context = arena_context(height=(0.5, 0.5), width=(0.05, 2.5))
    found = {}
    for x in (0.6, 1.4):
        above = [pose(context, at, 1.2, pitch=-math.pi / 2) for at in np.linspace(-2, x, 40)]
        down = [pose(context, x, z, pitch=-math.pi / 2) for z in np.linspace(1.2, 0.18, 20)]
        found[x] = follow(context, [*above, *down])
        assert found[x]["landed"] == (x > 1.0)
    assert found[0.6]["cleared_width"] == 0.0
    crown = 1.4 - 0.735  # upside down it is as far below the root
    assert found[1.4]["cleared_width"] == pytest.approx(crown, abs=0.02)


def test_strategy_features(context: Context) -> None:
    """Facing up on its back, down on its belly; crossing is the centre of mass's."""
    scene = context.scene
    assert isinstance(scene, CharacterScene)
    jump = Jump(Jump.Options(), context)
    turned = [pose(context, 0.0, 1.0, pitch=a)[0].float() for a in (-math.pi / 2, math.pi / 2, 0.0)]
    com = torch.zeros(3, scene.model.nbody, 3)
    com[:, scene.layout.root_body, 0] = torch.tensor([-0.1, 0.0, 0.2])
    found = jump.compute(
        qpos=torch.stack(turned),
        qvel=torch.tensor([0.0] * 3 + [1.0, 2.0, -2.0] + [0.0] * 28).repeat(3, 1),
        subtree_com=com,
        obstacle_width=torch.full((3,), 0.02),
        ctrl=torch.full((3, 28), 0.5),
        actuator_length=torch.full((3, 28), 0.25),
        difficulty=torch.tensor([0.0, 1 / 6, 1.0]),
    )
    np.testing.assert_allclose(found["facing_up"], [0, math.pi, math.pi / 2], atol=1e-3)
    on_its_back = [[0, 0, 1], [-1, 0, 0]]  # the root's x axis and z axis
    np.testing.assert_allclose(found["root_axes"][0].view(2, 3), on_its_back, atol=1e-6)
    np.testing.assert_allclose(found["crossing"], [0, 0, 1])
    np.testing.assert_allclose(found["root_spin"], [3.0] * 3)
    np.testing.assert_allclose(found["target_offset"], [7.0] * 3)
    # c_offset = 48 - 33 ρ, ρ = 2 z - 1 at 0.5, 0.75 and 2 m
    np.testing.assert_allclose(found["offset_limit"], [48.0, 31.5, 15.0], rtol=1e-5)


def test_rewards_are_those_of_the_paper() -> None:
    """Eq. 4.15; eq. 4.3 is pose_vae's."""
    np.testing.assert_allclose(spin(torch.tensor([0.0, 5.0])), [1.0, math.exp(-0.1)])
    np.testing.assert_allclose(safety(torch.tensor([0.0, 1.0])), [1.0, 0.7])


def test_what_has_crashed_does_not_land(context: Context) -> None:
    """Through the wall, then as one that has cleared it."""
    through = [pose(context, x, STANDING) for x in (-1.5, 2.0)]
    lying = pose(context, 2.0, 0.18, pitch=-math.pi / 2)
    found = follow(context, [*through, *over(context, lying)])
    assert (found["landed"], found["crashed"], found["cleared"]) == (0.0, 1.0, 0.0)


def test_what_is_touched_after_landing_on_feet_is_no_crash(context: Context) -> None:
    standing, lying = (
        pose(context, 2.0, STANDING + 0.1),
        pose(context, 2.0, 0.18, pitch=-math.pi / 2),
    )
    found = follow(context, over(context, standing, lying), landing="feet")
    assert (found["landed"], found["crashed"]) == (1.0, 0.0)


def test_a_trunk_that_lands_upside_down_is_worth_less() -> None:
    """Lying on the back or upright costs nothing; between, in proportion."""
    up = torch.tensor([1.0, 0.0, -0.5, -1.0])
    axes = torch.stack([torch.zeros(4)] * 5 + [up], dim=1)
    np.testing.assert_allclose(lying(axes), [1.0, 1.0, 0.65, 0.3], rtol=1e-6)
    np.testing.assert_allclose(lying(axes, upside_down=0.0), [1.0, 1.0, 0.5, 0.0], rtol=1e-6)
