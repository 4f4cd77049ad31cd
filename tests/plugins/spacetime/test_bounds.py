"""The bounds of section 3.5.1, just inside and just outside."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.task import Context
from understudy.task.terms import parameters_of
from understudy_spacetime.bounds import (
    BoundSize,
    ComBound,
    EndEffectorBound,
    JointBound,
    RootBound,
    Size,
)
from understudy_tensors import rotations

CPU = torch.device("cpu")
PHASE = torch.tensor([0.0, 0.5])


def turned(angle: Tensor, axis: tuple[float, float, float] = (0.6, 0.0, 0.8)) -> Tensor:
    return rotations.from_axis_angle(torch.tensor(axis), angle)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_centre_of_mass_is_bounded_by_20_cm_along_each_axis(
    context: Context, axis: int, sign: float
) -> None:
    reference = torch.tensor([[5.0, -3.0, 0.9]]).repeat(2, 1)
    com = reference.clone()
    com[:, axis] += sign * torch.tensor([0.199, 0.201])
    assert ComBound(ComBound.Options(), context)(com, reference, PHASE).tolist() == [False, True]


def test_centre_of_mass_bound_is_a_box_and_no_ball(context: Context) -> None:
    com = torch.full((2, 3), 0.19)  # 0.33 m away
    assert not ComBound(ComBound.Options(), context)(com, torch.zeros(2, 3), PHASE).any()


def test_root_is_bounded_by_0_7_rad(context: Context) -> None:
    root_bound = RootBound(RootBound.Options(), context)
    reference = turned(torch.tensor([2.0, -1.0]), (0.0, 0.0, 1.0))
    root = rotations.multiply(reference, turned(torch.tensor([0.69, 0.71])))
    assert root_bound(root, reference, PHASE).tolist() == [False, True]
    assert root_bound(-root, reference, PHASE).tolist() == [False, True]


def test_every_joint_is_bounded_by_0_7_rad(context: Context) -> None:
    bound = JointBound(JointBound.Options(), context)
    reference = turned(torch.linspace(-3.0, 3.0, 24)).view(2, 12, 4)
    for joint in range(12):
        joints = reference.clone()
        joints[:, joint] = rotations.multiply(joints[:, joint], turned(torch.tensor([-0.69, 0.71])))
        assert bound(joints, reference, PHASE).tolist() == [False, True]


def test_a_subset_of_joints_leaves_the_others_free(context: Context) -> None:
    assert context.scene is not None
    names = context.scene.layout.joint_names  # type: ignore[attr-defined]
    bound = JointBound(JointBound.Options(joints=("left_knee", "chest")), context)
    reference = torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(2, 12, 1)
    for joint, name in enumerate(names):
        joints = reference.clone()
        joints[:, joint] = turned(torch.tensor([0.1, 2.0]))
        assert bound(joints, reference, PHASE)[1].item() == (name in ("left_knee", "chest"))


def test_an_unknown_joint_is_named(context: Context) -> None:
    with pytest.raises(ConfigError, match=r"no joint 'left_nee'\. Did you mean 'left_knee'"):
        JointBound(JointBound.Options(joints=("left_nee",)), context)


def test_every_end_effector_is_bounded_by_half_a_metre(context: Context) -> None:
    bound = EndEffectorBound(EndEffectorBound.Options(), context)
    reference = torch.randn(2, 4, 3, generator=torch.Generator().manual_seed(0))
    for effector in range(4):
        moved = reference.clone()
        direction = torch.tensor([2.0, -1.0, 2.0]) / 3.0
        moved[:, effector] += torch.tensor([[0.499], [0.501]]) * direction
        assert bound(moved, reference, PHASE).tolist() == [False, True]


@pytest.mark.parametrize("bound", [ComBound, RootBound, JointBound, EndEffectorBound])
def test_a_bound_is_left_where_all_of_it_is_used(context: Context, bound: Any) -> None:
    """From nothing in the middle to 1 where it begins to hold, growing all the way."""
    term = bound(bound.Options(size=0.4), context)
    share = torch.tensor([0.0, 0.5, 0.99, 1.01, 2.0])
    many, phase = len(share), torch.zeros(len(share))
    turn = turned(0.4 * share, (0.0, 1.0, 0.0))
    places = torch.zeros(many, 3)
    places[:, 1] = -0.4 * share
    value, reference = {
        ComBound: (places, torch.zeros(many, 3)),
        RootBound: (turn, turned(torch.zeros(many))),
        JointBound: (turn[:, None].repeat(1, 12, 1), turned(torch.zeros(many, 12))),
        EndEffectorBound: (places[:, None].repeat(1, 4, 1), torch.zeros(many, 4, 3)),
    }[bound]
    own, meant, *_ = parameters_of(term)
    fields = {own: value, meant: reference, "phase": phase}
    used = term.used(**fields)
    assert used.dim() == 2
    torch.testing.assert_close(used.amax(1), share, rtol=1e-4, atol=1e-4)
    assert term(value, reference, phase).tolist() == [False, False, False, True, True]
    scales = torch.full((many, 1), 2.0)  # twice as wide a bound
    torch.testing.assert_close(
        term.used(**fields, bound_scales=scales).amax(1), share / 2, rtol=1e-4, atol=1e-4
    )


def test_a_bound_of_no_size_is_used_up_at_once(context: Context) -> None:
    bound = ComBound(ComBound.Options(size=0.0), context)
    com = torch.tensor([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]], requires_grad=True)
    used = bound.used(PHASE, com_position=com, reference_com_position=torch.zeros(2, 3))
    assert used[0].tolist() == [0.0, 0.0, 0.0]
    assert used[1].amax() > 1
    used.sum().backward()
    assert com.grad is not None
    assert com.grad.isfinite().all()


def size_at(size: Size, phase: Tensor) -> Tensor:
    return BoundSize(size, "here", CPU).at(phase)


def test_a_size_follows_its_knots_over_the_phase(context: Context) -> None:
    knots = [[0.75, 0.2], [0.25, 0.6]]  # in any order
    phase = torch.tensor([0.0, 0.25, 0.5, 0.625, 0.75, 0.999])
    torch.testing.assert_close(size_at(knots, phase), torch.tensor([0.6, 0.6, 0.4, 0.3, 0.2, 0.2]))
    com = torch.tensor([[0.0, 0.35, 0.0]]).repeat(6, 1)
    left = ComBound(ComBound.Options(knots), context)(com, torch.zeros(6, 3), phase)
    assert left.tolist() == [False, False, False, True, True, True]


def test_one_knot_and_a_step_are_sizes_too() -> None:
    torch.testing.assert_close(size_at([[0.3, 0.4]], PHASE), torch.tensor(0.4))
    step = size_at([[0.5, 0.1], [0.5, 0.9]], torch.tensor([0.49, 0.51]))
    torch.testing.assert_close(step, torch.tensor([0.1, 0.9]))


@pytest.mark.parametrize(
    "size",
    [[], [[]], [[0.1]], [[0.1, 0.2], [0.3]], [[0.1, 0.2, 0.3]], -0.1, [[0.1, -1.0]], [[1.5, 0.2]]],
)
@pytest.mark.parametrize(
    ("bound", "name"),
    [
        (ComBound, "com_bound"),
        (RootBound, "root_bound"),
        (JointBound, "joint_bound"),
        (EndEffectorBound, "end_effector_bound"),
    ],
)
def test_impossible_sizes_are_refused_when_the_task_is_built(
    context: Context, bound: Any, name: str, size: Size
) -> None:
    with pytest.raises(ConfigError, match=rf"spacetime/{name}: size="):
        bound(bound.Options(size=size), context)
