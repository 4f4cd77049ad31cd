"""How far the targets of servos may go."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import mujoco
import pytest
import torch

from understudy.errors import ConfigError
from understudy_characters.target_limits import servo_axes, target_limits

MODEL = """
<mujoco>
  <worldbody>
    <body name="chest">
      <joint name="cx" axis="1 0 0"/> <joint name="cy" axis="0 1 0"/> <geom size="0.1"/>
      <body name="arm"> <joint name="a" type="ball"/> <geom size="0.1"/> </body>
    </body>
  </worldbody>
  <actuator>
    <position name="p" joint="a" gear="0 0 1 0 0 0"/> <position name="q" joint="cy"/>
    <position name="r" joint="cx"/> <position name="s" joint="a" gear="1 0 0 0 0 0"/>
  </actuator>
</mujoco>
"""


def test_servos_go_by_their_axes_in_whatever_order_they_are() -> None:
    model = mujoco.MjModel.from_xml_string(MODEL)
    assert servo_axes(model) == [("arm", 2), ("chest", 1), ("chest", 0), ("arm", 0)]


def test_ranges_end_where_the_models_servos_do() -> None:
    model = mujoco.MjModel.from_xml_string(
        MODEL.replace('name="q"', 'name="q" ctrlrange="-0.5 0.7"')
    )
    scene: Any = SimpleNamespace(layout=SimpleNamespace(joint_names=("chest", "arm")), model=model)
    low, high = target_limits(scene, {"chest": ((-1.0, 1.0), (0.2, 2.0))}, torch.device("cpu"), 3.0)
    assert low.tolist() == pytest.approx([-3.0, 0.2, -1.0, -3.0])
    assert high.tolist() == pytest.approx([3.0, 0.7, 1.0, 3.0])
    with pytest.raises(
        ConfigError, match=r"actuation\.ranges\.chest: 0\.8 to 2 rad of axis 1 .* -0\.5 to 0\.7"
    ):
        target_limits(scene, {"chest": ((-1.0, 1.0), (0.8, 2.0))}, torch.device("cpu"))
