"""The hand, its variants and its tools as models."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch

from understudy.errors import ConfigError
from understudy.options import make_options
from understudy_hand import tools
from understudy_hand.scene import HandScene
from understudy_hand.table import ARM, FINGERS


def scene(**options: object) -> HandScene:
    return HandScene(make_options(HandScene.Options, options, "scene"))


def span(model: mujoco.MjModel, finger: str) -> float:
    """m, from the finger's first link to its last."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    ends = [data.xpos[model.body(f"{finger}_{part}").id] for part in ("proximal", "distal")]
    return float(np.linalg.norm(ends[1] - ends[0]))


def test_the_human_hand_has_29_hinges_on_an_arm_of_seven() -> None:
    model = scene().model
    assert (model.nu, model.nq, model.nv) == (7 + 29, 36 + 14, 36 + 12)
    assert [model.actuator(i).name for i in range(model.nu)] == [
        model.joint(i).name for i in range(model.nu)
    ]
    assert model.body("upper_stick").mass[0] == pytest.approx(0.0133, abs=1e-4)
    # 26 cm of 8 mm and round ends.
    assert model.geom("upper_stick").size[:2].tolist() == [0.004, 0.13]


@pytest.mark.parametrize(("fingers", "hinges"), [(3, 17), (4, 23), (5, 29)])
def test_the_number_of_fingers_is_a_parameter(fingers: int, hinges: int) -> None:
    made = scene(fingers=fingers)
    assert made.model.nu == 7 + hinges
    assert [n for n in FINGERS if f"{n}_distal" in made.links] == list(FINGERS[:fingers])


@pytest.mark.parametrize("self_collision", [False, True])
def test_fingers_touch_one_another_only_on_request(self_collision: bool) -> None:
    """Straight and side by side nothing does: bones of the palm, which lie in one another, do not count."""
    model = scene(tool="none", self_collision=self_collision).model
    data = mujoco.MjData(model)
    data.joint("thumb_spread").qpos, data.joint("thumb_bend").qpos = 0.6, 0.6
    mujoco.mj_forward(model, data)
    assert data.ncon == 0
    data.joint("index_spread").qpos = -0.13  # towards the middle finger, which is straight
    data.joint("middle_spread").qpos = 0.13
    mujoco.mj_forward(model, data)
    names = {model.geom(geom).name.partition("_")[0] for pair in data.contact.geom for geom in pair}
    assert names == ({"index", "middle"} if self_collision else set())


def test_long_fingers_are_twice_as_long_and_as_thick_as_before() -> None:
    human, long = scene().model, scene(finger_length=2.0).model
    for finger in FINGERS:
        assert span(long, finger) == pytest.approx(2.0 * span(human, finger))
    tip = "index_distal"
    assert long.geom(tip).size[0] == human.geom(tip).size[0]
    assert long.body(tip).mass[0] == pytest.approx(2.0 * human.body(tip).mass[0])
    palm = "index_metacarpal"
    assert (long.body(palm).pos == human.body(palm).pos).all()


def test_a_large_hand_is_twice_as_large_and_its_arm_is_not() -> None:
    human, large = scene().model, scene(size=2.0).model
    for link in scene().links:
        factor = 1.0 if link in {row.name for row in ARM} else 2.0
        np.testing.assert_allclose(large.body(link).pos, factor * human.body(link).pos)
        if link != "palm":
            np.testing.assert_allclose(large.geom(link).size, factor * human.geom(link).size)
    np.testing.assert_allclose(large.jnt_pos[7:36], 2.0 * human.jnt_pos[7:36])
    assert large.body("thumb_distal").mass[0] == pytest.approx(
        8 * human.body("thumb_distal").mass[0]
    )


def test_the_spring_of_the_tongs_pulls_them_to_their_rest() -> None:
    """-k (θ - θ_rest), k = 20 N m, θ_rest = 0.2 rad (section 5.7.4)."""
    model = scene(fingers=3, tool="tongs").model
    data = mujoco.MjData(model)
    for angle in (0.0, 0.2, 0.35):
        data.joint("opening").qpos = angle
        mujoco.mj_forward(model, data)
        at = model.joint("opening").dofadr[0]
        assert data.qfrc_spring[at] == pytest.approx(-20.0 * (angle - 0.2))
    assert model.geom("upper_bar").size.tolist() == [0.13, 0.004, 0.01]


def upper(
    position: list[float], rotation: list[float], angle: float, gripper: tools.Gripper
) -> tuple[np.ndarray, np.ndarray]:
    numbers = [torch.tensor(value, dtype=torch.float64) for value in (position, rotation, angle)]
    place, turn = tools.upper_pose(*numbers, gripper)
    return place.numpy(), turn.numpy()


def tip_distance(angle: float, gripper: tools.Gripper) -> float:
    """m between the tips."""
    place, turn = upper([0, 0, 0], [1, 0, 0, 0], angle, gripper)
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, turn)
    return float(np.linalg.norm(place + matrix.reshape(3, 3) @ tools.TIP - tools.TIP))


def test_the_gripper_is_what_the_tongs_do() -> None:
    model = scene(tool="tongs").model
    data, angle = mujoco.MjData(model), 0.17
    data.joint("opening").qpos = angle
    data.joint("lower_bar").qpos[3:] = [0.5, 0.5, -0.5, 0.5]
    mujoco.mj_kinematics(model, data)
    lower, above = data.body("lower_bar"), data.body("upper_bar")
    closed = tools.REST - angle  # the hinge says how open they are
    place, turn = upper(lower.xpos.tolist(), lower.xquat.tolist(), closed, tools.TONGS)
    np.testing.assert_allclose(place, above.xpos, atol=1e-12)
    np.testing.assert_allclose(turn, above.xquat, atol=1e-12)


def test_what_angles_mean() -> None:
    """The pivot of sticks is 17.5 cm from their tips, that of tongs 26 cm."""
    assert tip_distance(0.0, tools.STICKS) == pytest.approx(0.035)
    assert tip_distance(0.12, tools.STICKS) == pytest.approx(0.035 - 0.175 * 0.12, abs=2e-3)
    assert tip_distance(0.2, tools.TONGS) == pytest.approx(0.008)
    assert tip_distance(0.0, tools.TONGS) == pytest.approx(0.008 + 0.26 * 0.2, abs=2e-3)


def test_a_brush_is_one_round_handle() -> None:
    model = scene(tool="brush").model
    assert (model.nq, model.nv) == (36 + 7, 36 + 6)
    assert model.geom("brush").size[:2].tolist() == [0.004, 0.13]
    assert model.sensor("touch_brush_tip").type == mujoco.mjtSensor.mjSENS_TOUCH


@pytest.mark.parametrize("fingers", [3, 4, 5])
@pytest.mark.parametrize("tool", ["sticks", "tongs", "brush"])
def test_one_limit_of_a_hinge_acts_at_a_time(fingers: int, tool: str) -> None:
    """Else MuJoCo balances both, and MuJoCo Warp, which has the nearer one only, hits to and fro."""
    model = scene(fingers=fingers, tool=tool).model
    limited = model.jnt_limited != 0
    assert limited.sum() >= model.nu
    low, high = model.jnt_range[limited].T
    margin = model.jnt_margin[limited]
    assert (2.0 * margin < high - low).all()
    wide = high - low > 0.05
    assert (margin[: model.nu][wide[: model.nu]] == 0.01).all()  # the release


def test_hand_links_touch_tools_and_not_one_another() -> None:
    model = scene().model
    kind, affinity = model.geom_contype, model.geom_conaffinity
    meet = (kind[:, None] & affinity) | (affinity[:, None] & kind)
    hand = [model.geom(name).id for name in ("thumb_distal", "index_metacarpal", "ring_middle")]
    sticks = [model.geom(name).id for name in scene().tool_bodies]
    assert not meet[np.ix_(hand, hand)].any()
    assert meet[np.ix_(hand, sticks)].all()
    assert meet[sticks[0], sticks[1]]
    assert not meet[model.geom("forearm").id].any()


def test_arm_and_hand_bear_their_weight() -> None:
    """No servo has anything to do in the pose that is wanted."""
    model = scene(tool="none").model
    data = mujoco.MjData(model)
    low, high = model.jnt_range.T
    wide = high - low > 0.1  # at the ends of narrow ranges there is a push of its own
    data.qpos[:] = 0.5 * (low + high)
    data.ctrl[:] = data.qpos[: model.nu]
    before = data.qpos.copy()
    for _ in range(200):
        mujoco.mj_step(model, data)
    assert np.abs(data.qpos - before)[wide].max() < 1e-3


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"fingers": 2}, "fingers=2 is not possible: it must be at least 3"),
        ({"fingers": 6}, "fingers=6 is not possible: it must be at most 5"),
        ({"size": 0.0}, "size=0.0 is not possible"),
        ({"tool": "fork"}, "scene.tool='fork' is not possible"),
        ({"friction": -1.0}, "friction=-1.0 is not possible"),
        ({"contact": {"integrator": "discrete", "noslip_iterations": 4}}, "noslip_iterations=4"),
    ],
)
def test_what_cannot_be_is_refused(options: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        scene(**options)


def test_contacts_are_firm_but_for_what_is_set() -> None:
    """One setting changes no other."""
    firm, changed = scene().model, scene(contact={"impratio": 10.0}).model
    assert (firm.opt.impratio, changed.opt.impratio) == (100.0, 10.0)
    for model in (firm, changed):
        assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_DISCRETE
        assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
        assert model.geom("thumb_distal").solimp[:3].tolist() == [0.99, 0.99, 0.01]
    with pytest.raises(
        ConfigError, match="noslip_iterations=4 is not possible with the integrator"
    ):
        _ = scene(contact={"noslip_iterations": 4}).model


def test_an_objects_own_friction_counts_with_whatever_it_touches() -> None:
    """Of two frictions MuJoCo takes the larger one, unless a geom has priority."""
    slippery = {"kind": "sphere", "sizes": [0.01], "friction": 0.3}
    for given, wanted in ((slippery, 0.3), ({**slippery, "friction": None}, 1.0)):
        model = scene(object=given).model
        data = mujoco.MjData(model)
        data.joint("object").qpos[2] -= 1e-4
        mujoco.mj_forward(model, data)
        ball = model.geom("object").id
        own = [c.friction[0] for c in data.contact if ball in c.geom]
        assert own == pytest.approx([wanted] * len(own))
        assert own, "it lies on the table"
