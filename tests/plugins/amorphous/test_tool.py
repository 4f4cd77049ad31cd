"""The tool's integration (eq. 5), its action in its own frame, and what the policy sees of it."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch

from understudy.errors import ConfigError
from understudy.task import Context
from understudy_amorphous.tool import ToolState, ToolTarget, euler_angles, integrate, orientation
from understudy_tensors import rotations

DT = 1 / 30


def tool(frequency: float = 30.0, **options: Any) -> ToolTarget:
    context = Context(
        seed=0, device=torch.device("cpu"), num_worlds=1, control_dt=1 / frequency, substeps=2
    )
    return ToolTarget(ToolTarget.Options(**options), context)


def started(part: ToolTarget, *, x: float = 0.0, yaw: float = 0.0) -> dict[str, torch.Tensor]:
    given = {
        "tool_position": torch.tensor([[x, 0.0, 0.0]]),
        "tool_orientation": orientation(torch.tensor([[0.0, 0.0, yaw]])),
    }
    nothing = torch.zeros(1, 6)
    return given | part.begin(**given, tool_pose=nothing, tool_rate=nothing)


def driven(
    part: ToolTarget, state: dict[str, torch.Tensor], action: list[float], periods: int
) -> dict[str, torch.Tensor]:
    for _ in range(periods):
        state = state | part.advance(torch.tensor([action]), **state)
    return state


def test_eq_5_by_hand() -> None:
    pose, rate, away = torch.full((1, 6), 2.0), torch.full((1, 6), 0.5), torch.full((1, 6), 0.1)
    after = integrate(pose, rate, away, k_p=40.0, k_d=10.0, dt=0.1)
    torch.testing.assert_close(after[0], torch.full((1, 6), 2.05))  # the old rate, explicitly
    torch.testing.assert_close(after[1], torch.full((1, 6), 0.5 + 0.1 * (4.0 - 5.0)))


def test_angles_and_orientations_agree_with_those_of_tensors() -> None:
    angles = torch.rand(50, 3, generator=torch.Generator().manual_seed(0)) * 2.8 - 1.4
    axes = torch.eye(3)
    one_by_one = rotations.multiply(
        rotations.from_axis_angle(axes[2], angles[:, 2]),
        rotations.multiply(
            rotations.from_axis_angle(axes[1], angles[:, 1]),
            rotations.from_axis_angle(axes[0], angles[:, 0]),
        ),
    )
    torch.testing.assert_close(orientation(angles), one_by_one)
    torch.testing.assert_close(euler_angles(orientation(angles)), angles, atol=1e-5, rtol=1e-5)


def test_without_an_action_the_tool_rests() -> None:
    part = tool(tilt=0.4, reach={"x": 0.5, "y": 0.5, "z": 0.2, "yaw": 0.6})
    begun = started(part, x=1.0, yaw=0.7)
    rested = driven(part, begun, [0.0] * 4, 50)
    torch.testing.assert_close(rested["tool_pose"], begun["tool_pose"], atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize(("frame", "yaw"), [("tool", 0.0), ("tool", math.pi / 2), ("world", 1.2)])
def test_an_action_forward_moves_it_where_it_faces(frame: str, yaw: float) -> None:
    part = tool(frame=frame)
    moved = driven(part, started(part, yaw=yaw), [9.0, 0.0, 0.0], 60)
    facing = yaw if frame == "tool" else 0.0
    pose, rate = moved["tool_pose"][0], moved["tool_rate"][0]
    assert float(pose[:2].norm()) > 2.0
    assert math.atan2(float(pose[1]), float(pose[0])) == pytest.approx(facing, abs=1e-4)
    # a target that stays 0.5 m ahead: k_p · 0.5 / k_d
    assert float(rate[:2].norm()) == pytest.approx(2.0, abs=1e-3)


def test_its_turns_stay_below_half_a_turn_a_second() -> None:
    part = tool()
    turned = driven(part, started(part), [0.0, 0.0, -9.0], 90)
    assert -math.pi < float(turned["tool_rate"][0, 5]) < -2.0


def test_it_stops_where_it_may_not_go() -> None:
    part = tool(limits={"x": (-1.0, 1.0)})
    stopped = driven(part, started(part), [9.0, 0.0, 0.0], 60)
    assert float(stopped["tool_pose"][0, 0]) == 1.0
    assert float(stopped["tool_rate"][0, 0]) == 0.0
    back = driven(part, stopped, [-9.0, 0.0, 0.0], 10)
    assert float(back["tool_pose"][0, 0]) < 1.0


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_it_leans_in_the_direction_of_its_motion(direction: float) -> None:
    part = tool(tilt=0.4, reach={"x": 0.5, "y": 0.5, "yaw": 0.6})
    leaning = driven(part, started(part, yaw=2.0), [9.0 * direction, 0.0, 0.0], 60)
    assert float(leaning["tool_pose"][0, 4]) == pytest.approx(0.4 * direction, abs=0.01)
    control = part.control(torch.zeros(1, 3), **leaning)
    up = rotations.rotate(
        rotations.from_exponential_map(control[:, 3:]), torch.tensor([[0.0, 0.0, 1.0]])
    )[0]
    forward = direction * torch.tensor([math.cos(2.0), math.sin(2.0)])
    assert float(up[:2] @ forward) > 0.3, "its upper edge is ahead"


def test_what_the_policy_sees_of_it() -> None:
    context = Context(seed=0, device=torch.device("cpu"), num_worlds=1, control_dt=DT, substeps=1)
    pose, rate = torch.tensor([[1.0, 2, 3, 4, 5, 6]]), torch.tensor([[7.0, 8, 9, 10, 11, 12]])
    seen = ToolState(ToolState.Options(), context)
    expected = [1, 2, math.cos(6), math.sin(6), 7, 8, math.cos(12), math.sin(12)]
    assert seen.encode(pose, rate)[0].tolist() == pytest.approx(expected)
    assert seen.shape == (8,)
    spin = ToolState(ToolState.Options(("x", "z", "pitch"), material_spin=True), context)
    found = spin.encode(pose, rate, torch.tensor([[0.1, 0.2, 0.3]]))
    assert spin.shape == (11,) == found[0].shape
    assert found[0, :2].tolist() == [1, 3]


@pytest.mark.parametrize(
    "options",
    [
        {"reach": {"forward": 0.5}},
        {"limits": {"x": (1.0, 0.0)}},
        {"reach": {"pitch": 0.5}, "tilt": 0.3},
        {"reach": {}},
    ],
)
def test_impossible_tools_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"not possible|there is no"):
        ToolTarget.Options(**options)


def test_gains_that_eq_5_cannot_integrate_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"unstable.*above 5 Hz"):
        tool(frequency=4.0)
