"""What learners of actions in [-1, 1] span of a character's joint targets."""

from __future__ import annotations

import mujoco
import numpy as np
import torch

from understudy.task import Box, Context
from understudy_characters.parts import JointTargets, joint_ranges
from understudy_characters.scene import CharacterScene

FREE_AND_LIMITED = """
<mujoco><compiler angle="radian" autolimits="true"/><worldbody><body><freejoint/><geom size="0.1"/>
  <body name="knee"><joint name="knee" axis="0 1 0" range="-2.5 0.1"/><geom size="0.1"/></body>
  <body name="wheel"><joint name="wheel" axis="0 1 0"/><geom size="0.1"/></body>
  <body name="hip"><joint name="hip" type="ball" range="0 1.2"/><geom size="0.1"/></body>
</body></worldbody><actuator>
  <position joint="wheel" kp="1"/><position joint="knee" kp="1"/>
  <position joint="hip" kp="1" gear="1 0 0"/><position joint="hip" kp="1" gear="0 1 0"/>
</actuator></mujoco>
"""


def context_of(scene: CharacterScene, **sections: object) -> Context:
    return Context(
        seed=0, device=torch.device("cpu"), num_worlds=1, control_dt=1 / 30, substeps=1, scene=scene,
        sections=sections,
    )  # fmt: skip


def test_ranges_of_hinges_and_balls() -> None:
    middle, half = joint_ranges(mujoco.MjModel.from_xml_string(FREE_AND_LIMITED))
    np.testing.assert_allclose(middle, [0.0, -1.2, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(half, [np.pi, 1.3, 1.2, 1.2], atol=1e-6)


def test_around_the_reference_where_there_is_one() -> None:
    scene = CharacterScene(CharacterScene.Options("humanoid"))
    spanned = JointTargets(None, context_of(scene, motion=object())).action_space.parts["action"]
    assert spanned == Box(28, reach=0.3, around="reference_joint_targets")


def test_the_joints_ranges_otherwise() -> None:
    scene = CharacterScene(CharacterScene.Options("humanoid"))
    spanned = JointTargets(None, context_of(scene)).action_space.parts["action"]
    assert isinstance(spanned, Box)
    assert (spanned.around, spanned.reach) == joint_ranges(scene.model)
