"""The person: its hinges, its size, where it feels."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from understudy_dressing.person import (
    LINKS,
    PersonScene,
    limb,
    sensors,
    tool_bodies,
    tools,
)
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
