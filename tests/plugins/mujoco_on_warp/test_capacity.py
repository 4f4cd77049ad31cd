"""Contact capacities come from the scene."""

from __future__ import annotations

import mujoco
import pytest

pytest.importorskip(
    "mujoco_warp", reason="MuJoCo Warp is not installed (pip install 'understudy[gpu]')"
)

from understudy_mujoco_warp.simulator import contact_capacity


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
