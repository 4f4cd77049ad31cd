"""A brush whose tip follows curves, and tongs that open and close; what is refused."""

from __future__ import annotations

import math
import warnings
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from torch import Tensor

from understudy.errors import UnderstudyError
from understudy.setup.building import Built, build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy_chopsticks.strokes import Curves, tip
from understudy_hand.tools import TIP
from understudy_tool_planner import arm

TASK = ["task=chopsticks/brush", "num_worlds=4", "initial_states.curves=8"]


@pytest.fixture(scope="module")
def built(plugins: Plugins) -> Any:
    built = build_environment(load_experiment(TASK, plugins))
    yield built
    built.environment.close()


def field(built: Built, name: str) -> Tensor:
    return built.environment.table[name]


def curves(built: Built) -> Curves:
    return built.context.once("strokes", lambda: pytest.fail("there are no curves"))


def test_curves_are_closed_level_and_as_large_as_is_asked(built: Built) -> None:
    points = curves(built).points
    assert points.shape[0] == 8
    torch.testing.assert_close(points[:, 0], points[:, -1], atol=1e-5, rtol=0)
    torch.testing.assert_close(points[..., 2], torch.full_like(points[..., 2], 0.02))
    away = (points - points.mean(1, keepdim=True)).norm(dim=-1).amax(1)
    torch.testing.assert_close(away, torch.full_like(away, 0.025))
    assert (points[0] - points[1]).norm(dim=-1).max() > 0.005, "each is another one"


def test_the_arm_takes_the_tip_along(built: Built) -> None:
    """By the arm's own kinematics, with a brush that does not move in the palm; from rest."""
    own, made = curves(built), built.environment.table
    built.environment.reset(seed=0)
    lower = made["planned_lower"][0].double()
    palm, turn = arm.forward(own.arms.double())
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, lower[3:].numpy())
    reach = lower[:3] + torch.from_numpy(matrix.reshape(3, 3) @ np.array(TIP))
    found = palm + (turn @ reach[:, None])[..., 0]
    torch.testing.assert_close(found, own.tips.double(), atol=2e-5, rtol=0)
    assert (own.arms[:, 1] - own.arms[:, 0]).abs().max() < 1e-3


def test_without_a_policy_the_tip_is_within_three_millimetres(built: Built) -> None:
    """The grip's fixed targets and the arm as planned: a second of it, tip and errors as MuJoCo has them."""
    built.environment.reset(seed=1)
    worst = torch.zeros(4)
    for _ in range(100):
        built.environment.advance(torch.zeros(4, 36))
        worst = torch.maximum(worst, field(built, "curve_distance"))
    assert worst.max() < 3e-3
    xpos, xquat = field(built, "xpos"), field(built, "xquat")
    body, palm = (built.scene.model.body(name).id for name in ("brush", "palm"))  # type: ignore[union-attr]
    matrix, turned = np.zeros(9), np.zeros(9)
    mujoco.mju_quat2Mat(matrix, xquat[0, body].double().numpy())
    mujoco.mju_quat2Mat(turned, xquat[0, palm].double().numpy())
    at = xpos[0, body].numpy() + matrix.reshape(3, 3) @ np.array(TIP)
    off = at - field(built, "planned_tip")[0].numpy()
    assert float(field(built, "tip_error")[0]) == pytest.approx(np.linalg.norm(off), abs=1e-6)
    np.testing.assert_allclose(
        field(built, "tip_offset")[0], turned.reshape(3, 3).T @ off, atol=1e-6
    )
    row = int(field(built, "stroke_row")[0])
    nearest = np.linalg.norm(curves(built).points[row].numpy() - at, axis=1).min()
    assert float(field(built, "curve_distance")[0]) == pytest.approx(nearest, abs=1e-6)
    assert (
        float(field(built, "planned_tip")[0, :2].sub(curves(built).tips[row, 0, :2]).norm()) > 1e-3
    )


def test_the_reward_of_the_tip() -> None:
    assert tip(torch.tensor([0.0, 0.005])).tolist() == pytest.approx([1.0, math.exp(-0.2)])


def test_evaluations_follow_curves_that_no_training_has(plugins: Plugins, built: Built) -> None:
    other = build_environment(load_experiment(TASK, plugins), evaluating=True)
    assert (curves(other).points - curves(built).points).abs().max() > 1e-3
    other.environment.close()


def test_a_policy_sees_the_one_part_and_where_its_tip_is(built: Built) -> None:
    size = 36 * 2 + 13 + 3 + 5 + 1 + 6 * (72 + 15) + 3
    assert built.environment.observation_shapes["state"] == (size,)


def test_tongs_open_and_close_as_planned(plugins: Plugins) -> None:
    """Motions begin at the grip's least angle; the measured one is the plan's to a few hundredths of a rad."""
    words = [
        "task=chopsticks/open_close", "scene=hand/tongs", "grip.name=tongs", "num_worlds=2",
        "initial_states.amplitude=[0.04, 0.04]", "actuation.base=plan",
    ]  # fmt: skip
    built = build_environment(load_experiment(words, plugins))
    built.environment.reset(seed=0)
    least = built.environment.table["planned_angle"].clone()
    angles, planned = [], []
    for _ in range(50):
        built.environment.advance(torch.zeros(2, 36))
        angles.append(field(built, "angle").clone())
        planned.append(field(built, "planned_angle").clone())
        opening = field(built, "qpos")[:, -1]
        torch.testing.assert_close(angles[-1], 0.2 - opening, atol=1e-4, rtol=0)
    built.environment.close()
    assert least.tolist() == pytest.approx([0.02, 0.02])
    assert float(torch.stack(planned).max()) == pytest.approx(0.06, abs=1e-3)
    assert float((torch.stack(angles) - torch.stack(planned)).abs().max()) < 0.03
    assert float(torch.stack(angles).max()) > float(least[0]) + 0.01


def test_a_curve_is_traced_evenly_at_another_rate(plugins: Plugins) -> None:
    """Its frames are of 10 ms, and control periods of 5: the arm does not stand still in every other one."""
    words = [*TASK, "num_worlds=2", "initial_states.curves=2", "control.frequency=200"]
    built = build_environment(load_experiment(words, plugins))
    built.environment.reset(seed=0)
    arms, tips, speeds = [], [], []
    for _ in range(120):
        built.environment.advance(torch.zeros(2, 36))
        arms.append(field(built, "planned_pose")[:, :7].clone())
        tips.append(field(built, "planned_tip").clone())
        speeds.append(field(built, "planned_velocity")[:, :7].clone())
    built.environment.close()
    went = 200.0 * torch.stack(arms).diff(dim=0)
    torch.testing.assert_close(went, torch.stack(speeds)[:-1], atol=1e-3, rtol=0)
    steps = torch.stack(tips).diff(dim=0).norm(dim=-1)[-20:]
    assert float((steps[1:] / steps[:-1] - 1.0).abs().max()) < 0.1


@pytest.mark.parametrize(("seconds", "told"), [(2.0, False), (3.0, True)])
def test_a_brush_that_will_stand_still_is_told(
    seconds: float, told: bool, plugins: Plugins
) -> None:
    words = [*TASK, "num_worlds=1", "initial_states.longest=2", f"episode.seconds={seconds}"]
    built = build_environment(load_experiment(words, plugins))
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        built.environment.reset(seed=0)
        built.environment.reset(seed=0)
    assert len(found) == told, "once"
    assert not told or "Set initial_states.longest=3." in str(found[0].message)
    built.environment.close()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([*TASK, "scene=hand", "grip.name=standard"], "needs one grip of a brush"),
        ([*TASK, "grip.name=standard"], "holds two sticks, and the scene has a brush"),
        ([*TASK, "initial_states.size=0.1", "initial_states.height=0.3"], "initial_states.height=0.3 m above the table. Set it to less, the height otherwise"),
        ([*TASK, "initial_states.rate=0"], "rate=0.0 is not possible"),
        (["task=chopsticks/brush", "initial_states=chopsticks/open_and_close"], "needs a tool that opens"),
        (["task=chopsticks/relocate", "scene.tool=brush", "grip.name=brush"], "needs a tool of two parts"),
        (["task=chopsticks/relocate", "scene.tool=tongs", "grip.name=tongs"], "thinner than the gripper closes"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(words: list[str], said: str, plugins: Plugins) -> None:
    with pytest.raises(UnderstudyError) as error:
        build_environment(load_experiment(words, plugins))
    assert said in str(error.value)
    assert error.value.exit_status == 2
