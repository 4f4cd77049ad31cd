"""The person: its hinges, its size, where it feels."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from understudy_dressing.body import LINKS, limb, sensors, tool_bodies, tools
from understudy_dressing.person import PersonScene
from understudy_warp_torch.tools import TaperedCapsule


def posed(**angles: float) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = PersonScene(PersonScene.Options()).spec().compile()
    data = mujoco.MjData(model)
    for name, angle in angles.items():
        data.joint(name).qpos[0] = angle
    mujoco.mj_kinematics(model, data)
    return model, data


def place(data: mujoco.MjData, link: str, point: tuple[float, ...]) -> np.ndarray:
    body = data.body(link)
    return body.xpos + body.xmat.reshape(3, 3) @ np.asarray(point)


def test_it_is_the_papers() -> None:
    model, data = posed()
    assert model.nu == 22
    assert model.nv == 22 + 3, "and the gripper"
    assert sum(link.mass for link in LINKS) == pytest.approx(48.4, abs=0.1)  # and 0.1 of a pelvis
    assert len(sensors()) == 22
    for side, y in (("left", 0.21), ("right", -0.21)):
        tip, *_, neck = (place(data, *one) for one in limb(side))  # type: ignore[arg-type]
        assert tip == pytest.approx([0, y, -0.765])
        assert neck == pytest.approx([0, 0, 0])
        points = [place(data, *one) for one in limb(side)]  # type: ignore[arg-type]
        length = sum(np.linalg.norm(a - b) for a, b in zip(points[1:], points[:-1], strict=True))
        assert length == pytest.approx(0.975, abs=0.001)


@pytest.mark.parametrize("side", ["left", "right"])
def test_arms_are_mirror_images(side: str) -> None:
    """The same angles of both arms bring the hands to mirrored places."""
    names = (
        "clavicle_raise",
        "clavicle_swing",
        "shoulder_spread",
        "shoulder_swing",
        "elbow",
        "wrist_bend",
    )
    angles = dict(zip(names, (0.2, -0.15, 0.5, -1.1, 0.7, 0.3), strict=True))
    _, data = posed(**{f"{s}_{name}": a for s in ("left", "right") for name, a in angles.items()})
    tip, other = (place(data, *limb(s)[0]) for s in ("left", "right"))
    assert tip == pytest.approx(other * [1, -1, 1])
    _, data = posed(**{f"{side}_elbow": 1.5})
    assert place(data, *limb(side)[0])[0] > 0.3, "elbows flex forward"  # type: ignore[arg-type]
    _, data = posed(**{f"{side}_shoulder_swing": -np.pi / 2})
    assert place(data, *limb(side)[0])[0] == pytest.approx(0.765), "arms swing forward"  # type: ignore[arg-type]


def test_what_cloth_meets_is_where_the_links_are() -> None:
    bodies = dict(zip(tool_bodies(), tools(), strict=True))
    assert bodies["gripper"].shapes == ()
    for link in LINKS:
        for (ra, a, rb, b), shape in zip(
            link.shapes, bodies[link.name].shapes if link.shapes else (), strict=True
        ):
            assert isinstance(shape, TaperedCapsule)
            turn = np.zeros(9)
            mujoco.mju_quat2Mat(turn, np.asarray(shape.orientation))
            half = shape.half_length * turn.reshape(3, 3)[:, 2]
            assert np.asarray(shape.position) - half == pytest.approx(np.asarray(a), abs=1e-9)
            assert np.asarray(shape.position) + half == pytest.approx(np.asarray(b), abs=1e-9)
            assert shape.radii == (ra, rb)


def test_it_stays_finite_under_any_torques() -> None:
    model, data = posed()
    model.opt.timestep = 0.002
    rng = np.random.default_rng(0)
    for _ in range(1000):
        data.ctrl[:] = rng.choice([-1.0, 1.0], model.nu)
        mujoco.mj_step(model, data)
    assert np.abs(data.qvel).max() < 100
    assert not any(data.warning.number)


def test_hinges_can_be_left_out() -> None:
    scene = PersonScene(PersonScene.Options(still=("torso", "left")))
    assert scene.spec().compile().nu == 22 - 2 - 8 == len(scene.hinges)
    with pytest.raises(ValueError, match="still names 'tors0'"):
        PersonScene.Options(still=("tors0",))


def pressed(self_collision: bool) -> float:
    """m: how near the elbow, at a height where the torso's radius is 0.123 m, comes to the torso's axis within 1 s of pressing."""
    options = PersonScene.Options(damping=None, self_collision=self_collision)
    model = PersonScene(options).spec().compile()
    data = mujoco.MjData(model)
    spread = data.joint("right_shoulder_spread")
    near = np.inf
    for _ in range(round(1.0 / model.opt.timestep)):
        data.actuator("right_shoulder_spread").ctrl[0] = np.sign(INWARDS)
        mujoco.mj_step(model, data)
        torso = data.body("torso")
        elbow = torso.xmat.reshape(3, 3).T @ (data.body("right_forearm").xpos - torso.xpos)
        near = min(near, float(np.linalg.norm(elbow[:2])))
    assert INWARDS * float(spread.qpos[0]) > 0
    return near


#: rad: the spread of the right shoulder that brings its elbow towards the torso has this sign.
INWARDS = 1.0


def test_links_keep_apart() -> None:
    """The 2018 code's rigid self-collision: an arm that presses on the torso stays outside of it."""
    assert pressed(False) < 0.05
    assert 0.123 + 0.05 - 0.005 < pressed(True) < 0.123 + 0.05 + 0.03


def test_at_rest_no_links_touch() -> None:
    model = PersonScene(PersonScene.Options(self_collision=True)).spec().compile()
    data = mujoco.MjData(model)
    for side in ("left", "right"):
        data.joint(f"{side}_elbow").qpos[0] = 0.21
    mujoco.mj_forward(model, data)
    assert data.ncon == 0
    plain = PersonScene(PersonScene.Options()).spec().compile()
    assert model.body_mass == pytest.approx(plain.body_mass)
    assert model.body_inertia == pytest.approx(plain.body_inertia)
