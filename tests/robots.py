"""A small robot of hinges, as a stranger's MJCF file has it: no floor, no lights, torque motors."""

from __future__ import annotations

from pathlib import Path

_LIMB = """
<body name="{side}_thigh" pos="0 {y} 0">
  <joint name="{side}_hip_x" axis="1 0 0"/><joint name="{side}_hip_z" axis="0 0 1"/>
  <joint name="{side}_hip_y" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 -.05 0 0 -.35" size=".05" mass="4"/>
  <body name="{side}_shin" pos="0 0 -.4"><joint name="{side}_knee" axis="0 1 0" range="0 2.5"/>
    <geom type="capsule" fromto="0 0 -.05 0 0 -.35" size=".04" mass="2.5"/>
    <body name="{side}_foot" pos="0 0 -.4"><joint name="{side}_ankle_y" axis="0 1 0"/>
      <joint name="{side}_ankle_x" axis="1 0 0"/>
      <geom type="box" size=".1 .045 .02" pos=".04 0 -.02" mass="1"/></body></body></body>"""
_ARM = """
<body name="{side}_upper_arm" pos="0 {y} .2" euler="{roll} 0 0">
  <joint name="{side}_shoulder_y" axis="0 1 0"/><joint name="{side}_shoulder_x" axis="1 0 0"/>
  <joint name="{side}_shoulder_z" axis="0 0 1"/>
  <geom type="capsule" fromto="0 0 -.03 0 0 -.25" size=".035" mass="1.5"/>
  <body name="{side}_forearm" pos="0 0 -.28"><joint name="{side}_elbow" axis="0 -1 0" range="0 2.5"/>
    <geom type="capsule" fromto="0 0 -.03 0 0 -.2" size=".03" mass="1"/>
    <body name="{side}_hand" pos="0 0 -.25"><geom size=".04" mass=".4"/></body></body></body>"""
#: N m, of the motors of each side; the waist has none.
MOTORS = {
    "hip_x": 120, "hip_z": 80, "hip_y": 120, "knee": 120, "ankle_y": 60, "ankle_x": 50,
    "shoulder_y": 40, "shoulder_x": 40, "shoulder_z": 30, "elbow": 30,
}  # fmt: skip


def robot_xml() -> str:
    """A pelvis, a waist of one hinge, legs and arms of three, and a head welded to the chest; the right
    arm's frames are turned in the zero pose."""
    legs = "".join(_LIMB.format(side=side, y=y) for side, y in (("left", 0.09), ("right", -0.09)))
    arms = "".join(
        _ARM.format(side=side, y=y, roll=roll)
        for side, y, roll in (("left", 0.2, 0.0), ("right", -0.2, 0.5))
    )
    motors = "".join(
        f'<motor joint="{side}_{joint}" gear="{gear}"/>'
        for side in ("left", "right")
        for joint, gear in MOTORS.items()
    )
    return f"""
<mujoco model="robot"><compiler autolimits="true" angle="radian"/>
<default><joint damping=".2" armature=".01"/><motor ctrlrange="-1 1"/></default>
<worldbody><body name="pelvis" pos="0 0 .84"><freejoint/>
  <geom type="box" size=".07 .1 .05" mass="6"/>{legs}
  <body name="chest" pos="0 0 .15"><joint name="waist" axis="0 0 1"/>
    <geom type="box" size=".08 .14 .12" pos="0 0 .1" mass="12"/>
    <body name="head" pos="0 0 .35"><geom size=".1" mass="3"/></body>{arms}</body>
</body></worldbody>
<actuator>{motors}</actuator></mujoco>"""


def robot_file(folder: Path) -> Path:
    path = folder / "robot.xml"
    path.write_text(robot_xml(), encoding="utf-8")
    return path
