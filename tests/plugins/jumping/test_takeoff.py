"""Take-off states have the features that they are asked for, and stand on their foot."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
import yaml
from arena_worlds import arena_context

import understudy_jumping
from understudy.errors import ConfigError
from understudy_characters.scene import CharacterScene
from understudy_jumping.run_up import Arrival, match, takeoff_features
from understudy_jumping.takeoff import POSES, Pose, Takeoff, takeoff_states
from understudy_tensors import rotations

OPTIONS = Path(understudy_jumping.__file__).parent / "conf" / "initial_states" / "jumping"

#: Table 4.3: v_z, ω_x, ω_z, α.
TABLE = {
    "fosbury": (-2.40, -3.00, 1.00, -0.05),
    "western_roll": (-0.50, 1.00, -1.00, 2.09),
    "straddle": (-2.21, 1.00, 0.88, 1.65),
    "front_kick": (-0.52, 1.00, -0.26, 0.45),
    "side_dive": (-1.83, -2.78, -0.32, 1.18),
    "side_jump": (-1.99, -1.44, 0.44, 0.70),
}


@pytest.fixture(scope="module")
def scene() -> CharacterScene:
    scene = arena_context().scene
    assert isinstance(scene, CharacterScene)
    return scene


@pytest.mark.parametrize("name", TABLE)
def test_the_options_are_those_of_the_table(name: str) -> None:
    given = yaml.safe_load((OPTIONS / f"{name}.yaml").read_text())["takeoff"]
    takeoff = Takeoff(**given)
    assert (takeoff.v_z, takeoff.omega_x, takeoff.omega_z, takeoff.alpha) == TABLE[name]


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("name", TABLE)
def test_states_have_their_features(scene: CharacterScene, pose: str, name: str) -> None:
    v_z, omega_x, omega_z, alpha = TABLE[name]
    wanted = Takeoff(v_z=v_z, omega_x=omega_x, omega_z=omega_z, alpha=alpha)
    qpos, qvel = takeoff_states(scene.character, POSES[pose], [wanted])
    found = takeoff_features(torch.from_numpy(qpos[:, 3:7]), torch.from_numpy(qvel[:, :6]))[0]
    # the lean turns the heading by a little
    np.testing.assert_allclose(found, [v_z, omega_x, -3.0, omega_z], atol=0.15)
    assert float(rotations.heading(torch.from_numpy(qpos[0, 3:7]))) == pytest.approx(
        math.remainder(alpha - math.pi / 2, 2 * math.pi), abs=0.05
    )


def test_the_obstacle_is_on_the_left_or_in_front(scene: CharacterScene) -> None:
    """Section 4.6.1 rotates the suite; here the athlete is turned, and x points across the obstacle."""
    for alpha, ahead, left in ((0.0, 0.0, 1.0), (math.pi / 2, 1.0, 0.0)):
        turn = rotations.from_heading(torch.tensor(Takeoff(alpha=alpha).heading))
        across = rotations.inverse_rotate(turn, torch.tensor([1.0, 0.0, 0.0]))
        np.testing.assert_allclose(across, [ahead, left, 0.0], atol=1e-6)


@pytest.mark.parametrize("pose", POSES)
def test_the_foot_rests_flat_on_the_ground(scene: CharacterScene, pose: str) -> None:
    model, data = scene.model, mujoco.MjData(scene.model)
    (qpos,), (qvel,) = takeoff_states(scene.character, POSES[pose], [Takeoff()])
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_forward(model, data)
    velocity = np.zeros(6)
    foot = model.body("right_ankle").id
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, foot, velocity, 0)
    np.testing.assert_allclose(velocity, 0.0, atol=1e-9)
    np.testing.assert_allclose(data.xmat[foot].reshape(3, 3)[2], [0, 0, 1], atol=1e-9)
    clearance = scene.character.clearance(torch.from_numpy(qpos)[None])[0]
    names = list(scene.character.joint_names)
    assert float(clearance[names.index("right_ankle")]) == pytest.approx(0.0, abs=1e-9)
    others = {n: float(c) for n, c in zip(names, clearance, strict=True) if n != "right_ankle"}
    assert min(others.values()) > 0.05
    assert others["left_ankle"] > 0.1, "one-legged"


def test_the_rest_of_the_state_stays(scene: CharacterScene) -> None:
    """Section 4.8: features change the root and the standing leg's velocities alone."""
    (one, two), (slow, fast) = takeoff_states(
        scene.character, POSES["plant"], [Takeoff(), Takeoff(v_z=-0.5, omega_x=1.0, alpha=2.0)]
    )
    np.testing.assert_allclose(one[7:], two[7:], atol=1e-12)
    leg = [
        scene.model.joint(f"right_{name}").dofadr[0] + k
        for name, count in (("hip", 3), ("knee", 1), ("ankle", 3))
        for k in range(count)
    ]
    changed = np.flatnonzero(~np.isclose(slow, fast))
    assert set(changed) <= {*range(6), *leg}
    assert set(leg) <= set(changed)


def test_a_joint_that_is_missing_is_named(scene: CharacterScene) -> None:
    pose = Pose((0.0, 0.0, 0.0), {"tail": (0.1,)}, {})
    with pytest.raises(ConfigError, match="joint 'tail'"):
        takeoff_states(scene.character, pose, [Takeoff()])


def test_the_take_off_reward_is_that_of_the_paper(scene: CharacterScene) -> None:
    """Eqs. 4.12 and 4.13."""
    context = arena_context()
    velocity = torch.tensor([[4.0, 1.0, 0.0, 0.5, 0.2, -2.0]])  # v_z = -1; ω = (0.5, -2, -0.2)
    qpos = torch.zeros(1, scene.model.nq)
    qpos[:, 3] = 1.0
    qvel = torch.cat([velocity, torch.zeros(1, scene.model.nv - 6)], dim=1)
    time = torch.tensor([3.328])
    away = (abs(0.5 + 3.0) + abs(-2.0 + 3.0) + abs(-0.2 - 1.0)) / 3
    for v_z, expected in ((-2.4, away + 0.7 * 1.4**2), (None, away)):
        arrival = Arrival(Arrival.Options(v_z=v_z, rest=0.0), context)
        found = arrival.compute(time, qpos, qvel)
        np.testing.assert_allclose(found["runup_features"], [[-1.0, 0.5, -2.0, -0.2]], atol=1e-6)
        assert float(found["takeoff_match"]) == pytest.approx(math.exp(-expected))
        assert bool(found["arrived"])
        for ended, rest, of_it in ((False, 1.0, 0.0), (True, 1.0, 1.0), (True, 0.5, 0.5)):
            reward = match(torch.tensor([ended]), found["takeoff_match"], torch.tensor([rest]))
            paid = of_it * math.exp(-expected)
            assert float(reward) == pytest.approx(paid), "before the end there is none"
        assert float(found["takeoff_rest"]) == 1.0, "nothing of the rest is asked"
    early = Arrival(Arrival.Options(rest=0.0), context).compute(time - 0.1, qpos, qvel)
    assert not bool(early["arrived"])
