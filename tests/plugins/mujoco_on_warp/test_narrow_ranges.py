"""Where both limits of a joint act at once, MuJoCo Warp would compute another motion than MuJoCo."""

from __future__ import annotations

import mujoco
import pytest
import torch

pytest.importorskip(
    "mujoco_warp", reason="MuJoCo Warp is not installed (pip install 'understudy[gpu]')"
)

from understudy.errors import ConfigError
from understudy.task import Context
from understudy_mujoco.scene import MujocoScene
from understudy_mujoco_warp.narrow import refuse_narrow_ranges
from understudy_mujoco_warp.simulator import MujocoWarpSimulator

BODY = """<body><joint name="{name}" type="{kind}" range="{low} {high}" margin="{margin}"/>
  <geom size=".1"/></body>"""
STRING = """<tendon><fixed name="string" range="{low} {high}" margin="{margin}">
  <joint joint="knee" coef="1"/></fixed></tendon>"""


def text(
    kind: str, low: float, high: float, margin: float, tendon: str = "", name: str = "knee"
) -> str:
    body = BODY.format(kind=kind, low=low, high=high, margin=margin, name=name)
    return f'<mujoco><compiler angle="radian"/><worldbody>{body}</worldbody>{tendon}</mujoco>'


def check(xml: str) -> None:
    refuse_narrow_ranges(mujoco.MjModel.from_xml_string(xml))


@pytest.mark.parametrize("kind", ["hinge", "slide"])
def test_a_joint_of_which_both_limits_act_is_refused(kind: str) -> None:
    said = r"joint 'knee' has a range of 0\.015 and a margin of 0\.01, .* at most 0\.0075"
    with pytest.raises(ConfigError, match=said):
        check(text(kind, -0.01, 0.005, 0.01))


def test_a_joint_without_a_name_is_known_by_its_number() -> None:
    with pytest.raises(ConfigError, match="joint '0' has"):
        check(text("hinge", -0.01, 0.005, 0.01, name=""))


def test_a_tendon_is_refused_too() -> None:
    tendon = STRING.format(low=0.0, high=0.019, margin=0.01)
    with pytest.raises(ConfigError, match=r"tendon 'string' has a range of 0\.019"):
        check(text("hinge", -1.0, 1.0, 0.01, tendon))


def test_where_one_limit_acts_at_a_time_nothing_is_refused() -> None:
    check(text("hinge", -0.01, 0.01, 0.01))  # they meet in the middle
    check(text("hinge", 0.0, 0.001, 0.0))
    check(text("ball", 0.0, 0.001, 0.01))  # has one limit
    check(text("hinge", -1.0, 1.0, 0.01, STRING.format(low=0.0, high=0.02, margin=0.01)))


class Narrow(MujocoScene):
    """A body on a hinge of too narrow a range."""

    def spec(self) -> mujoco.MjSpec:
        return mujoco.MjSpec.from_string(text("hinge", 0.0, 0.001, 0.01))

    @property
    def model(self) -> mujoco.MjModel:
        return self.spec().compile()


def test_the_simulator_asks() -> None:
    context = Context(0, torch.device("cpu"), 1, control_dt=0.01, substeps=2)
    context.scene = Narrow()
    with pytest.raises(ConfigError, match="use simulator=mujoco"):
        MujocoWarpSimulator(MujocoWarpSimulator.Options(), context)
