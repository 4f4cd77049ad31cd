"""The walker's model: what follows from its scales."""

from __future__ import annotations

import itertools
import math
import random
from dataclasses import fields, replace

import mujoco
import numpy as np
import pytest

from understudy.errors import ConfigError
from understudy.options import make_options
from understudy_morphology.figure import (
    DENSITY,
    HELP,
    LENGTH_RANGE,
    RADIUS_RANGE,
    Scales,
    build_spec,
    links,
    standing_height,
)

NAMES = [item.name for item in fields(Scales)]
RANGES = {n: LENGTH_RANGE if n.endswith("length") else RADIUS_RANGE for n in NAMES}


def drawn(seed: int) -> Scales:
    """Scales anywhere in the box of table 6.1."""
    generator = np.random.default_rng(seed)
    return Scales(**{n: generator.uniform(*RANGES[n]) for n in NAMES})


def model_of(scales: Scales) -> mujoco.MjModel:
    return build_spec(scales).compile()


def stepped(
    model: mujoco.MjModel, seconds: float, control: np.ndarray | None = None
) -> mujoco.MjData:
    data = mujoco.MjData(model)
    if control is not None:
        data.ctrl[:] = control
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return data


def test_it_has_fifteen_motors_and_what_helps() -> None:
    model = model_of(Scales())
    assert (model.nq, model.nv, model.nu, model.nbody - 1) == (7 + 15, 6 + 15, 15 + len(HELP), 9)
    hinges = [hinge for link in links(Scales()) for hinge in link.hinges]
    assert [model.actuator(i).name for i in range(15)] == [hinge.name for hinge in hinges]
    np.testing.assert_allclose(model.actuator_gear[:15, 0], [hinge.torque for hinge in hinges])
    np.testing.assert_allclose(model.actuator_ctrlrange[:15], [[-1, 1]] * 15)
    assert not model.actuator_ctrllimited[15:].any()
    assert 45 < model.body_mass.sum() < 60


@pytest.mark.parametrize("seed", range(10))
def test_mass_is_volume_times_density(seed: int) -> None:
    scales = drawn(seed)
    model = model_of(scales)
    for link in links(scales):
        if len(link.shape) == 3:
            start, end, r = link.shape
            volume = math.pi * r**2 * math.dist(start, end) + 4 / 3 * math.pi * r**3
        else:
            volume = 8 * math.prod(link.shape[1])
        assert model.body(link.name).mass[0] == pytest.approx(DENSITY * volume, rel=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_each_scale_scales_its_link(name: str) -> None:
    link, _, what = name.partition("_")
    model = model_of(Scales())
    body = link if link in ("torso", "waist", "pelvis") else f"left_{link}"
    before = model.geom(body).size.copy()
    after = model_of(replace(Scales(), **{name: 1.4})).geom(body).size
    axes = {"length": 0, "radius": 1} if link == "foot" else {"length": 1, "radius": 0}
    expected = np.ones(3)
    expected[axes[what]] = 1.4
    if name == "foot_radius":
        expected[2] = 1.4
    np.testing.assert_allclose(after, before * expected, rtol=1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_left_and_right_are_mirror_images(seed: int) -> None:
    """Also where both legs have the same angles."""
    model = model_of(drawn(seed))
    data, generator = mujoco.MjData(model), np.random.default_rng(seed)
    for name in ("hip_y", "hip_z", "hip_x", "knee", "ankle_y", "ankle_x"):
        low, high = model.joint(f"left_{name}").range
        angle = generator.uniform(low, high)
        data.joint(f"left_{name}").qpos = data.joint(f"right_{name}").qpos = angle
    mujoco.mj_kinematics(model, data)
    for name in ("thigh", "knee", "foot"):
        left, right = data.body(f"left_{name}"), data.body(f"right_{name}")
        np.testing.assert_allclose(left.xpos * [1, -1, 1], right.xpos, atol=1e-12)
        np.testing.assert_allclose(left.xipos * [1, -1, 1], right.xipos, atol=1e-12)
        flip = np.diag([1.0, -1.0, 1.0])
        np.testing.assert_allclose(
            flip @ left.xmat.reshape(3, 3) @ flip, right.xmat.reshape(3, 3), atol=1e-12
        )
        assert model.body(f"left_{name}").mass == model.body(f"right_{name}").mass
    for name in ("hip_y", "knee", "ankle_x"):
        left, right = model.joint(f"left_{name}"), model.joint(f"right_{name}")
        np.testing.assert_array_equal(left.range, right.range)


@pytest.mark.parametrize("seed", range(10))
def test_it_stands_with_nothing_but_its_soles_on_the_floor(seed: int) -> None:
    scales = drawn(seed)
    model = model_of(scales)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.qpos[2] == standing_height(scales)
    assert all(abs(contact.dist) < 1e-9 for contact in data.contact)
    data.qpos[2] -= 1e-4
    mujoco.mj_forward(model, data)
    touching = [{model.geom(g).name for g in contact.geom} for contact in data.contact]
    assert sorted(map(sorted, touching)) == 4 * [["floor", "left_foot"]] + 4 * [
        ["floor", "right_foot"]
    ]
    np.testing.assert_allclose(data.contact.dist, -1e-4, atol=1e-9)


@pytest.mark.parametrize(
    ("lengths", "radii"), list(itertools.product((0.3, 1.0, 2.0), (0.5, 1.0, 1.5)))
)
def test_it_falls_and_lies_still_within_bounds(lengths: float, radii: float) -> None:
    """One second without torque, and one with every motor at its limit."""
    scales = Scales(**{n: lengths if n.endswith("length") else radii for n in NAMES})
    model = model_of(scales)
    for control in (None, np.r_[np.tile([1.0, -1.0, 1.0], 5), np.zeros(6)]):
        data = stepped(model, 1.0, control)
        assert np.isfinite(data.qpos).all()
        assert np.isfinite(data.qvel).all()
        assert not data.warning.number.any()
        assert np.abs(data.qpos[:3]).max() < 10


CORNERS = list(itertools.product((0, 1), repeat=len(NAMES)))
SOME = [CORNERS[0], CORNERS[-1], *random.Random(0).sample(CORNERS, 126)]


@pytest.mark.parametrize("corners", [SOME, pytest.param(CORNERS, marks=pytest.mark.slow)])
def test_every_corner_of_the_box_builds_and_steps(corners: list[tuple[int, ...]]) -> None:
    """For one control period, with torque and help."""
    for corner in corners:
        scales = Scales(**{n: RANGES[n][i] for n, i in zip(NAMES, corner, strict=True)})
        model = model_of(scales)
        data = stepped(model, 0.0165, np.r_[np.tile([0.5, -0.5, 0.5], 5), 100, np.full(5, 200)])
        assert np.isfinite(data.qvel).all()
        assert not data.warning.number.any()
        assert np.abs(data.qvel).max() < 200


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("thigh_length", 2.1, "scene.thigh_length=2.1 is not possible: it must be at most 2."),
        ("foot_radius", 0.4, "scene.foot_radius=0.4 is not possible: it must be at least 0.5."),
        ("foot_lenght", 1.0, "scene has no option 'foot_lenght'. Did you mean 'foot_length'?"),
    ],
)
def test_scales_outside_the_table_are_refused(name: str, value: float, sentence: str) -> None:
    with pytest.raises(ConfigError) as error:
        make_options(Scales, {name: value}, "scene")
    assert str(error.value).startswith(sentence)
