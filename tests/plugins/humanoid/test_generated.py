"""The generated walk: symmetric, planted, closed, within a human's range."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch
from torch import Tensor

from understudy import rotations
from understudy.errors import ConfigError
from understudy_humanoid.character import BODIES, build_spec
from understudy_humanoid.generated import TOE_OFF, generated_walk
from understudy_humanoid.kinematics import character_layout
from understudy_humanoid.reference import clip_to_qpos
from understudy_motion.clip import Clip, cycle_transform, resample

WALKS = [(1.2, 1.05), (0.8, 1.2), (1.5, 0.95)]
FOOT = next(row for row in BODIES if row.name == "right_ankle")


@pytest.fixture(params=WALKS, ids=lambda walk: f"{walk[0]} m/s")
def walk(request: pytest.FixtureRequest) -> Clip:
    speed, cycle = request.param
    return generated_walk(speed=speed, cycle=cycle)


def soles(clip: Clip, side: str) -> Tensor:
    """(F, 2, 3) m: the middles of the rear and front edges of one sole, world."""
    model = build_spec().compile()
    data, found = mujoco.MjData(model), []
    ends = [
        [FOOT.centre[0] + k * FOOT.size[0], 0.0, FOOT.centre[2] - FOOT.size[2]] for k in (-1, 1)
    ]
    for qpos in clip_to_qpos(clip, model, character_layout(model), clip.times):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        body = data.body(f"{side}_ankle")
        found.append(body.xpos + np.array(ends) @ body.xmat.reshape(3, 3).T)
    return torch.from_numpy(np.array(found))


def test_cycle_goes_straight_ahead_and_closes(walk: Clip) -> None:
    transform = cycle_transform(walk)
    speed = transform.displacement / walk.duration
    assert speed[0].item() == pytest.approx(walk.root_position[-1, 0].item() / walk.duration)
    assert abs(transform.heading) < 1e-9
    assert abs(speed[1]) < 1e-9
    assert rotations.angle_between(walk.rotations[0], walk.rotations[-1]).max() < 1e-6
    assert abs(walk.root_position[0, 2] - walk.root_position[-1, 2]) < 1e-9


def test_second_half_mirrors_the_first(walk: Clip) -> None:
    half = walk.num_frames // 2
    mirrored = [
        name.replace("left", "L").replace("right", "left").replace("L", "right")
        for name in walk.joint_names
    ]
    order = [walk.joint_names.index(name) for name in mirrored]
    flip = torch.tensor([1.0, -1.0, 1.0, -1.0], dtype=torch.float64)  # mirror in the xz plane
    expected = walk.rotations[: half + 1, order] * flip
    assert rotations.angle_between(walk.rotations[half:], expected).max() < 1e-6
    moved = walk.root_position[half:] - walk.root_position[: half + 1]
    assert torch.allclose(moved[:, 0], moved[:1, 0].expand(half + 1))
    assert torch.allclose(walk.root_position[half:, 1], -walk.root_position[: half + 1, 1])


def test_stance_foot_neither_slides_nor_sinks(walk: Clip) -> None:
    points = soles(walk, "right")
    assert points[..., 2].min() > -0.005
    stance = points[: int(TOE_OFF * (walk.num_frames - 1))]
    for end in (0, 1):
        planted = stance[:, end, 2] < 0.001
        assert planted.sum() > 0.2 * walk.num_frames
        places = stance[planted, end, :2]
        assert (places.amax(0) - places.amin(0)).max() < 0.01
    swing = points[int(TOE_OFF * walk.num_frames) + 2 : -4]
    assert swing[..., 2].min() > -0.001
    middle = points[int(0.75 * walk.num_frames) : int(0.9 * walk.num_frames)]
    assert middle[..., 2].min() > 0.01


def test_knees_and_elbows_bend_the_human_way(walk: Clip) -> None:
    axis = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
    for side in ("left", "right"):
        knee = rotations.twist_angle(
            walk.rotations[:, walk.joint_names.index(f"{side}_knee")], axis
        )
        elbow = rotations.twist_angle(
            walk.rotations[:, walk.joint_names.index(f"{side}_elbow")], -axis
        )
        assert 0.1 < knee.min() < 0.6
        assert 0.8 < knee.max() < 1.4
        assert 0.0 < elbow.min() < elbow.max() < 1.0


def test_nothing_jumps(walk: Clip) -> None:
    dense = resample(walk, 240.0)
    step = rotations.angle_between(dense.rotations[1:], dense.rotations[:-1])
    assert step.max() * 240.0 < 12.0  # rad/s


def test_impossible_walks_are_refused() -> None:
    with pytest.raises(ConfigError, match="too long for the legs"):
        generated_walk(speed=3.0)
    with pytest.raises(ConfigError, match="above 0"):
        generated_walk(cycle=0.0)
    with pytest.raises(ConfigError, match="above 0"):
        generated_walk(cycle=float("nan"))
