"""How far the targets of servos may go."""

from __future__ import annotations

import mujoco

from understudy_characters.target_limits import servo_axes

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
