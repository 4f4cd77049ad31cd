"""Kinematics in torch beside MuJoCo's own, of characters with joints of every kind."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch
from random_characters import random_model
from torch import Tensor

from understudy_imagination.rigid import Rigid

#: Slides, anchors away from the body, several joints of one body, two free bodies, servos.
MIXED = """
<mujoco>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body pos="0 .1 1" euler="10 20 30">
      <joint name="s" type="slide" axis="0 1 0" pos=".1 0 0"/>
      <joint name="h" type="hinge" axis="0 0 1" pos="0 .2 .1"/>
      <joint type="hinge" axis="1 0 0" pos=".3 .2 .1" ref="20"/>
      <geom size=".1" pos=".1 .1 0"/>
      <body pos=".3 0 .2" euler="0 40 5">
        <joint name="b" type="ball" pos=".05 0 .1"/>
        <geom type="box" size=".1 .2 .3" euler="4 5 6"/>
        <site pos=".1 0 0"/>
        <body pos="0 0 .2"><geom size=".05"/></body>
      </body>
    </body>
    <body pos="0 0 2">
      <freejoint/>
      <geom type="capsule" size=".05 .2" euler="30 0 0"/>
      <body pos=".1 .1 .1" euler="9 8 7">
        <joint type="slide" axis="1 1 0"/>
        <geom type="cylinder" size=".1 .2"/>
      </body>
    </body>
    <body pos="1 0 2"><freejoint/><geom size=".1"/></body>
  </worldbody>
  <actuator>
    <position joint="h" kp="10" gear="2"/>
    <motor joint="s"/>
    <position joint="b" kp="10" gear="0 1 0"/>
  </actuator>
</mujoco>
"""
MODELS = [*range(6), "mixed"]


def model_of(which: int | str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(MIXED) if which == "mixed" else random_model(int(which))


def states(model: mujoco.MjModel, count: int = 4) -> tuple[Tensor, Tensor, list[mujoco.MjData]]:
    rng, found = np.random.default_rng(0), []
    for _ in range(count):
        data = mujoco.MjData(model)
        mujoco.mj_integratePos(model, data.qpos, rng.normal(size=model.nv), 1.0)
        data.qvel[:] = rng.normal(size=model.nv)
        mujoco.mj_forward(model, data)
        found.append(data)
    return *(tensor([getattr(d, name) for d in found]) for name in ("qpos", "qvel")), found


def tensor(rows: list[np.ndarray]) -> Tensor:
    return torch.from_numpy(np.array(rows)).float()


@pytest.mark.parametrize("which", MODELS)
def test_fields_are_mujocos(which: int | str) -> None:
    model = model_of(which)
    rigid = Rigid(model, torch.device("cpu"))
    qpos, qvel, datas = states(model)
    posed = rigid.posed(qpos, qvel)
    for name, shape in rigid.fields.items():
        theirs = tensor([getattr(data, name) for data in datas]).view(len(datas), *shape)
        torch.testing.assert_close(posed.field(name), theirs, rtol=1e-5, atol=2e-5)


@pytest.mark.parametrize("which", MODELS)
def test_steps_are_mujocos(which: int | str) -> None:
    model = model_of(which)
    rigid = Rigid(model, torch.device("cpu"))
    qpos, qvel, datas = states(model)
    after = []
    for data, rate in zip(datas, qvel.double().numpy(), strict=True):
        moved = data.qpos.copy()
        mujoco.mj_integratePos(model, moved, rate, 0.1)
        after.append(moved)
    torch.testing.assert_close(rigid.moved(qpos, 0.1 * qvel), tensor(after), rtol=0, atol=1e-6)
    found = rigid.difference(qpos, tensor(after))
    torch.testing.assert_close(found, 0.1 * qvel, rtol=0, atol=1e-5)


def test_servos_are_compared_with_the_lengths_that_mujoco_gives_them() -> None:
    model = model_of("mixed")
    rigid = Rigid(model, torch.device("cpu"))
    qpos, _, datas = states(model)
    control = torch.full((len(qpos), 3), 0.5)
    lengths = tensor([data.actuator_length for data in datas])
    expected = torch.where(torch.tensor([True, False, True]), control - lengths, control)
    found = rigid.deflection(control, rigid.lengths(qpos))
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-5)


def test_derivatives_of_fields_are_their_differences() -> None:
    model = model_of("mixed")
    rigid = Rigid(model, torch.device("cpu"))
    qpos, qvel, _ = states(model, 1)
    step = torch.zeros(1, model.nv, requires_grad=True)
    weight = torch.from_numpy(np.random.default_rng(1).normal(size=(1, model.nbody, 6))).float()

    def value(moved: Tensor) -> Tensor:
        return (rigid.posed(rigid.moved(qpos, moved), qvel).field("cvel") * weight).sum()

    (found,) = torch.autograd.grad(value(step), step)
    size = 1e-2
    for k in range(model.nv):
        nudge = size * torch.eye(model.nv)[k : k + 1]
        expected = (value(nudge) - value(-nudge)) / (2 * size)
        torch.testing.assert_close(found[0, k], expected.detach(), rtol=1e-2, atol=1e-2)


def test_velocities_turn_into_the_roots_frame_and_back() -> None:
    model = model_of("mixed")
    rigid = Rigid(model, torch.device("cpu"))
    qpos, qvel, _ = states(model)
    local = rigid.in_root(qpos, qvel)
    torch.testing.assert_close(rigid.in_root(qpos, local, back=True), qvel, rtol=0, atol=1e-5)
    assert (local - qvel).abs().max() > 0.1


def test_points_that_touch_are_the_lowest_of_their_shapes() -> None:
    """Of spheres and capsules the ball's lowest point, of boxes a corner."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body pos="0 0 1"><freejoint/><geom size=".1" pos="0 0 -.2"/>
        <geom type="capsule" size=".05 .3"/><geom type="box" size=".1 .2 .3" pos="0 0 .5"/>
        </body></worldbody></mujoco>"""
    )
    rigid = Rigid(model, torch.device("cpu"))
    assert rigid.touching == 1 + 2 + 8
    qpos = torch.from_numpy(model.qpos0).float()[None]
    qvel = torch.tensor([[1.0, 0.0, 0.0, 0.0, 2.0, 0.0]])
    height, speed = rigid.touch(rigid.posed(qpos, qvel).bodies, torch.arange(rigid.touching))
    assert height[0, :3].tolist() == pytest.approx([0.7, 0.65, 1.25], abs=1e-6)
    assert sorted(height[0, 3:].tolist()) == pytest.approx([1.2] * 4 + [1.8] * 4, abs=1e-6)
    # A turn about y by 2 rad/s carries what is 0.3 m below the origin back by 0.6 m/s.
    assert speed[0, 0].tolist() == pytest.approx([1.0 - 0.6, 0.0, 0.0], abs=1e-6)
