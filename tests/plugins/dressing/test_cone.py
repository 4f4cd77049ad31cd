"""The cone of an upper arm: published ranges, shipped poses, and that a push ends at its border."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from understudy_dressing.body import SIDES, Side
from understudy_dressing.cone import RANGES, fitted, limits
from understudy_dressing.person import PersonScene
from understudy_dressing.waypoints import DRESSED, IN_SLEEVE

#: N m, of a hinge: a third of its largest.
PUSH = 4.0


def person(cone: bool = True) -> mujoco.MjModel:
    options = PersonScene.Options(cone=cone, damping=None, self_collision=True)
    return PersonScene(options).spec().compile()


def arm(data: mujoco.MjData, side: Side) -> np.ndarray:
    """(3,) where it points, seen from its shoulder, as if it were the left one."""
    turn = data.body(f"{side}_clavicle").xmat.reshape(3, 3)
    way = turn.T @ -data.body(f"{side}_upper_arm").xmat.reshape(3, 3)[:, 2]
    return way * (1.0, 1.0 if side == "left" else -1.0, 1.0)


def test_it_ends_within_8_degrees_of_each_published_range() -> None:
    cone = fitted()
    off = {
        name: np.degrees(cone.reaches(end) - np.arccos(end @ cone.axis)) for name, end in limits().items()
    }  # fmt: skip
    assert off.keys() == RANGES.keys()
    assert max(map(abs, off.values())) < 8.0
    assert np.sqrt(np.mean(np.square(list(off.values())))) < 5.0


def test_it_holds_what_an_arm_does_and_not_what_none_does() -> None:
    cone = fitted()
    for inside in ((0, 0, -1), (1, 0, 0), (0, 1, 0), (1, 1, 0), (0.6, -0.6, -0.5)):
        assert cone.excess(np.array(inside) / np.linalg.norm(inside)) < -0.1, inside
    for outside in ((-1, 0, 0), (-1, -1, 0), (-1, -1, 1), (-0.5, -0.3, 0.8)):
        assert cone.excess(np.array(outside) / np.linalg.norm(outside)) > 0.1, outside


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize(("hinge", "sign"), [("swing", 1.0), ("spread", 1.0)])
def test_a_push_ends_at_the_border(side: Side, hinge: str, sign: float) -> None:
    """Back, and across the body."""
    excess = {}
    for cone in (True, False):
        model = person(cone)
        data = mujoco.MjData(model)
        motor = model.actuator(f"{side}_shoulder_{hinge}").id
        data.ctrl[motor] = sign * PUSH / model.actuator_gear[motor, 0]
        most = -np.inf
        for _ in range(1000):
            mujoco.mj_step(model, data)
            most = max(most, float(fitted().excess(arm(data, side))))
        excess[cone] = most
    assert -0.01 < excess[True] < 0.03
    assert excess[False] > 0.2


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("bent", [*IN_SLEEVE, DRESSED])
def test_shipped_poses_are_inside(side: Side, bent: tuple[float, ...]) -> None:
    model = person()
    data = mujoco.MjData(model)
    names = [model.joint(i).name for i in range(22)]
    mine = [i for i, name in enumerate(names) if name.startswith(side)]
    twists = np.array([names[i].endswith("twist") for i in mine])
    data.qpos[mine] = np.where(twists & (side == "right"), -np.array(bent), bent)
    mujoco.mj_forward(model, data)
    tendon = model.tendon(f"{side}_cone").id
    most = model.tendon_range[tendon, 1]
    assert data.ten_length[tendon] < most
    assert data.ten_length[tendon] == pytest.approx(
        most + 0.30 * fitted().excess(arm(data, side)), abs=1e-6
    )


def test_without_it_the_person_is_as_it_was() -> None:
    assert person(cone=False).ntendon == 0
    assert person().nq == person(cone=False).nq
    assert np.array_equal(person().body_mass, person(cone=False).body_mass)
