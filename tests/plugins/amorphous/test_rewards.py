"""Rewards of the three tasks against eq. 6 to 12 of Zhang et al. 2020, with Table 2's constants."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
import torch

from understudy.errors import ConfigError
from understudy.task import Context
from understudy_amorphous import flipping, gathering, spreading
from understudy_amorphous.scene import AmorphousScene
from understudy_tensors import rotations

STILL = torch.tensor([[[1.0, 0.0, 0.1], [2.0, 0.0, 0.3]]])
ALL = torch.ones(1, 2)


def one(value: float) -> torch.Tensor:
    return torch.tensor([value])


def gathered(far: float, before: float, tool: float, moved: float = 0.0, **more: float) -> float:
    after = STILL + torch.tensor([0.0, moved, 0.0])
    found = gathering.gathering(one(far), one(before), one(tool), after, STILL, ALL, **more)  # type: ignore[arg-type]
    return float(found)


def test_near_the_farthest_particle_its_way_to_the_goal_counts() -> None:
    # (10 + 2)² − (10 + 1.9)² = 2.39; two particles moved 0.1 m each
    assert gathered(1.9, 2.0, tool=0.5) == pytest.approx(0.03 + 2.39, abs=1e-4)
    assert gathered(1.9, 2.0, tool=0.5, moved=0.1) == pytest.approx(0.03 + 2.39 + 0.5, abs=1e-4)
    assert gathered(1.9, 2.0, tool=0.5, moved=0.1, mean=False) == pytest.approx(3.42, abs=1e-4)
    assert gathered(2.0, 1.9, tool=0.5) == pytest.approx(0.03 - 2.39, abs=1e-4)


def test_far_from_it_the_way_to_it_counts() -> None:
    assert gathered(5.0, 5.0, tool=1.5) == pytest.approx(-0.015)
    assert gathered(5.0, 5.5, tool=1.5, moved=1.0) == pytest.approx(-0.015), "nothing else"


def test_the_threshold_is_wider_where_the_material_is_nearer_the_goal() -> None:
    assert gathered(2.0, 2.0, tool=1.9) == pytest.approx(0.03), "4 / 2 m"
    assert gathered(2.0, 2.0, tool=2.1) == pytest.approx(-0.021)
    assert gathered(8.0, 8.0, tool=0.9) == pytest.approx(0.03), "never below c_5"


def test_all_within_a_metre_of_the_goal_is_rewarded() -> None:
    assert gathered(0.99, 0.99, tool=2.0) == pytest.approx(1.03)
    assert gathered(0.99, 0.99, tool=2.0, w_4=0.0) == pytest.approx(0.03)


def test_what_is_not_on_the_table_counts_for_nothing() -> None:
    positions = torch.tensor([[[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [90.0, 0.0, 0.0]]])
    found = gathering.Farthest(None, None).compute(  # type: ignore[arg-type]
        positions,
        torch.tensor([[1.0, 1.0, 0.0]]),
        torch.tensor([[0.0, 1.5, 0.4]]),
        torch.zeros(1, 2),
    )
    assert found["farthest_distance"].tolist() == [2.0]
    assert found["farthest_position"].tolist() == [[0.0, 2.0]]
    assert found["tool_distance"].tolist() == [0.5]
    moved = positions + 1.0
    active = torch.tensor([[1.0, 0.0, 0.0]])
    length = gathering.path_length(moved, positions, active, mean=True)
    torch.testing.assert_close(length, one(math.sqrt(3)))


def test_one_grain_that_was_left_behind_does_not_hide_what_was_gathered() -> None:
    x = torch.arange(1.0, 201.0) / 100  # 1 cm to 2 m
    x[[0, 199]] = torch.tensor([9.0, 9.0])  # one far away, and one that is not there
    positions = torch.stack([x, torch.zeros(200), torch.full((200,), 5.0)], dim=1)
    goal = torch.tensor([[0.0, 0.0], [1.0, 0.0]])
    positions = torch.stack([positions, positions + torch.tensor([1.0, 0.0, 0.0])])
    active = torch.ones(2, 200)
    active[:, 199] = 0.0
    share = gathering.gathered_share(positions, active, goal)
    torch.testing.assert_close(share, torch.full((2,), 149 / 199))
    for part, expected in ((0.95, 1.91), (0.5, 1.01), (1.0, 9.0), (1e-6, 0.02)):
        found = gathering.share_distance(positions, active, goal, share=part)
        torch.testing.assert_close(found, torch.full((2,), expected), msg=str(part))
    x = torch.arange(1.0, 201.0).view(1, -1, 1).expand(1, 200, 3) / 100
    found = gathering.share_distance(x, torch.ones(1, 200), torch.zeros(1, 2))
    torch.testing.assert_close(found, one(1.9 * math.sqrt(2)), msg="190 of 200")
    nothing = torch.zeros(1, 200)
    assert gathering.gathered_share(x, nothing, torch.zeros(1, 2)).tolist() == [0.0]
    assert gathering.share_distance(x, nothing, torch.zeros(1, 2)).tolist() == [0.0]


def test_spreading_rewards_by_hand() -> None:
    after = STILL + torch.tensor([[0.0, 0.1, 0.0], [0.0, 0.0, -0.05]])
    assert float(spreading.newly_occupied(one(103.0), one(100.0))) == 3.0
    assert float(spreading.lowered(after, STILL)) == pytest.approx(0.025)
    # one of the two is higher than 0.2 m, after it moved
    assert float(spreading.movement(after, STILL)) == pytest.approx((0.05 - 0.1 * 0.1) / 2)
    far = torch.tensor([[[3.0, 4.0, 9.0], [0.0, 3.1, 0.0], [0.0, -3.5, 0.0]]])
    assert float(spreading.outliers(far)) == pytest.approx(-(1.8 + 0.3), abs=1e-5)


def test_nothing_is_rewarded_where_nothing_moves() -> None:
    assert float(spreading.newly_occupied(one(100.0), one(100.0))) == 0.0
    assert float(spreading.lowered(STILL, STILL)) == 0.0
    assert float(spreading.movement(STILL, STILL)) == 0.0
    assert float(spreading.outliers(STILL)) == 0.0
    assert gathered(3.0, 3.0, tool=0.5, c_2=0.0) == 0.0


def test_flipping_rewards_by_hand() -> None:
    assert float(flipping.height(one(0.3))) == pytest.approx(0.1 + 3.0)
    assert float(flipping.height(one(-0.3))) == pytest.approx(-0.03)
    turning = torch.tensor([[0.0, 0.4, 0.0]])
    assert float(flipping.spin(one(0.6), turning)) == pytest.approx(1.6)
    assert float(flipping.spin(one(0.5), turning)) == 0.0, "not above c_2"
    assert float(flipping.spin(one(0.6), 9 * turning)) == pytest.approx(4.0)
    assert float(flipping.spin(one(0.6), turning, axis=(0.0, -1.0, 0.0))) == pytest.approx(-1.6)


def test_a_ring_that_turns_has_its_angular_velocity() -> None:
    angle = torch.arange(8) * math.pi / 4
    ring = torch.stack([angle.cos(), torch.zeros(8), angle.sin()], dim=1).unsqueeze(0)
    spin = torch.tensor([0.0, 1.7, 0.0])
    velocity = torch.linalg.cross(spin.expand_as(ring), ring) + torch.tensor([3.0, 0.0, -2.0])
    found = flipping.angular_velocity(ring + 5.0, velocity)
    torch.testing.assert_close(found, spin.unsqueeze(0), atol=1e-5, rtol=1e-5)


def test_a_flip_counts_once_it_is_caught() -> None:
    assert flipping.flipped(torch.tensor([3.1, 2.0, -3.1])).tolist() == [1.0, 0.0, 0.0]
    assert flipping.flipped(torch.tensor([3.1, -3.1]), direction=-1.0).tolist() == [0.0, 1.0]


def disk() -> tuple[flipping.Turned, Callable[..., dict[str, torch.Tensor]]]:
    """What counts the turns of a disk, and what it reads of one that is turned about its own axis by `yaw`,
    then about y by `angle`, `height` above a pan at rest."""
    context = Context(seed=0, device=torch.device("cpu"), num_worlds=1, control_dt=0.1, substeps=1)
    options = AmorphousScene.Options("elastic", blocks=1, round=True, tool="pan")
    context.scene = scene = AmorphousScene(options, context)
    block = torch.as_tensor(scene.block, dtype=torch.float32)
    block = block - block.mean(dim=0)
    pan = torch.zeros(1, 3)

    def seen(angle: float, height: float, yaw: float = 0.0) -> dict[str, torch.Tensor]:
        own = rotations.from_axis_angle(torch.tensor([0.0, 0.0, 1.0]), torch.tensor(yaw))
        turn = rotations.from_axis_angle(torch.tensor([0.0, 1.0, 0.0]), torch.tensor(angle))
        turned = rotations.rotate(rotations.multiply(turn, own), block)
        place = (turned + torch.tensor([0.1, 0.0, height])).unsqueeze(0)
        still = torch.zeros_like(place)
        fields = {"particle_position": place, "particle_velocity": still, "tool_position": pan}
        return fields | {"tool_velocity": pan, "clearance": place[..., 2].amin(dim=1)}

    return flipping.Turned(flipping.Turned.Options(), context), seen


def test_turns_are_counted_over_whole_turns_and_caught_in_the_pan() -> None:
    """A disk that turns about y by 0.9 of a turn a second, 2 m above the pan, and then lies in it."""
    memory, seen = disk()
    kept = memory.begin(**seen(0.0, 0.3))
    for i in range(1, 15):
        kept = memory.advance(kept, **seen(0.1 * i * 0.9 * 2 * math.pi, 2.0))
    assert float(kept["turned"]) == pytest.approx(1.4 * 0.9 * 2 * math.pi, abs=1e-3)
    assert float(kept["caught_turn"]) == 0.0
    assert float(kept["toss_height"]) > 1.4
    kept = memory.advance(kept, **seen(3 * math.pi, 0.3))
    assert float(kept["caught_turn"]) == pytest.approx(3 * math.pi, abs=1e-3)
    assert float(flipping.flipped(kept["caught_turn"])) == 1.0


def test_a_disk_that_turns_about_its_own_axis_is_not_turned_over() -> None:
    memory, seen = disk()
    kept = memory.begin(**seen(0.0, 0.3, yaw=0.3))
    for i in range(1, 60):  # around once and more, wobbling
        kept = memory.advance(kept, **seen(0.2 * math.sin(i), 0.3, yaw=0.3 + 0.12 * i))
        assert abs(float(kept["turned"])) < 0.25
    for angle in (0.5, 1.0, 1.5, 2.0, 2.5, math.pi):  # and over, from whatever it had turned to
        kept = memory.advance(kept, **seen(angle, 0.3, yaw=7.4))
    assert float(kept["turned"]) == pytest.approx(math.pi, abs=1e-3)


def test_a_disk_of_one_layer_has_no_sides_to_tell_apart() -> None:
    context = Context(seed=0, device=torch.device("cpu"), num_worlds=1, control_dt=0.1, substeps=1)
    options = AmorphousScene.Options("elastic", blocks=1, block=(5, 5, 1), round=True, tool="pan")
    context.scene = AmorphousScene(options, context)
    with pytest.raises(ConfigError, match="two layers or more"):
        flipping.Turned(flipping.Turned.Options(), context)
