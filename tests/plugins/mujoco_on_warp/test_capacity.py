"""Contact capacities come from the scene."""

from __future__ import annotations

import mujoco
import pytest

pytest.importorskip(
    "mujoco_warp", reason="MuJoCo Warp is not installed (pip install 'understudy[gpu]')"
)

from understudy_mujoco_warp.capacity import constraint_capacity, contact_capacity


def model(bodies: str) -> mujoco.MjModel:
    floor = '<geom type="plane" size="5 5 1"/>'
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody>{floor}{bodies}</worldbody></mujoco>"
    )


def body(kind: str, size: str) -> str:
    return f'<body pos="0 0 1"><freejoint/><geom type="{kind}" size="{size}"/></body>'


@pytest.mark.parametrize(
    ("bodies", "expected"),
    [
        (body("sphere", ".1"), 1),
        (body("capsule", ".1 .2"), 2),
        (body("box", ".1 .1 .1"), 4),
        (body("sphere", ".1") + body("box", ".1 .1 .1"), 1 + 4 + 1),
    ],
)
def test_planes_and_pairs_are_counted(bodies: str, expected: int) -> None:
    assert contact_capacity(model(bodies)) == expected


PAIR = """<mujoco><worldbody><geom name="floor" type="plane" size="5 5 1" contype="0" conaffinity="0"/>
  <body><freejoint/><geom name="a" size=".1" contype="0" conaffinity="0"/></body>
  <body><freejoint/><geom name="b" type="box" size=".1 .1 .1" contype="0" conaffinity="0"/></body>
  </worldbody><contact><pair geom1="a" geom2="b"/><pair geom1="floor" geom2="b"/></contact></mujoco>"""


def test_predefined_pairs_are_counted() -> None:
    assert contact_capacity(mujoco.MjModel.from_xml_string(PAIR)) == 1 + 4


ROWS = """<mujoco><option cone="{cone}"/><worldbody><geom type="plane" size="5 5 1" condim="{condim}"/>
  <body pos="0 0 1"><joint name="a" type="slide" range="0 1" limited="true" frictionloss="{loss}"/>
    <geom size=".1"/></body>
  <body pos="1 0 1"><joint name="b" type="slide"/><geom size=".1"/></body>
  </worldbody><equality>{equality}</equality></mujoco>"""


@pytest.mark.parametrize(
    ("cone", "condim", "loss", "equality", "expected"),
    [
        ("pyramidal", 3, 0, "", 4 * 5 + 1),
        ("pyramidal", 4, 0, "", 6 * 5 + 1),
        ("pyramidal", 6, 0, "", 10 * 5 + 1),
        ("elliptic", 3, 0, "", 3 * 5 + 1),
        ("elliptic", 4, 0.1, "", 4 * 5 + 1 + 1),
        ("pyramidal", 3, 0, '<joint joint1="a" joint2="b"/>', 4 * 5 + 1 + 6),
    ],
)
def test_rows_follow_from_cone_dimensions_losses_and_equalities(
    cone: str, condim: int, loss: float, equality: str, expected: int
) -> None:
    text = ROWS.format(cone=cone, condim=condim, loss=loss, equality=equality)
    found = constraint_capacity(mujoco.MjModel.from_xml_string(text), 5)
    assert found == expected
    assert type(found) is int, "Warp compiles it into kernels"
