"""Inverse dynamics and contacts, against what mechanics says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch
from damage import raised, walking

from understudy_characters.character import Character
from understudy_doctor.dynamics import effort
from understudy_doctor.examination import examine
from understudy_doctor.measurements import Measurements
from understudy_humanoid.character import build_spec
from understudy_humanoid.clips import generated_hop, generated_run
from understudy_motion.clip import Clip

GRAVITY = 9.81
Motion = Callable[[np.ndarray, np.ndarray], None]


def posed(humanoid: Character, seconds: float, move: Motion, rate: float = 60.0) -> Clip:
    """The zero pose, moved by `move`, which is given times (F,) and ``qpos`` (F, nq) to change."""
    times = np.arange(round(seconds * rate) + 1) / rate
    qpos = np.repeat(humanoid.model.qpos0[None], len(times), axis=0)
    move(times, qpos)
    return humanoid.clip(
        torch.from_numpy(qpos), torch.from_numpy(times), name="posed", licence="CC0"
    )


def pitched(angle: float) -> np.ndarray:
    return np.array([np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0])


def test_standing_needs_the_weight_and_little_torque(humanoid: Character) -> None:
    clip = posed(humanoid, 1.0, lambda t, q: None)
    measured = Measurements(clip, humanoid)
    np.testing.assert_allclose(measured.effort.lift, 1.0, atol=1e-9)
    mass = humanoid.model.body_subtreemass[humanoid.root]
    assert measured.effort.weight == pytest.approx(GRAVITY * mass, rel=1e-3)
    assert measured.ground == pytest.approx(0.0, abs=1e-6)
    feet = [measured.character.joint_names[row] for row in measured.feet]
    assert feet == ["right_ankle", "left_ankle"]
    assert measured.touching[:, measured.feet].all()
    assert not np.delete(measured.touching, measured.feet, axis=1).any()
    np.testing.assert_allclose(measured.support.unexplained, 0.0, atol=0.02)
    assert np.nanmax(measured.support.share) < 0.2
    assert examine(clip, humanoid).findings == ()


def test_flight_needs_nothing(humanoid: Character) -> None:
    """A pose thrown up, tumbling about its centre of mass: no force but gravity's, no contact."""

    def fly(t: np.ndarray, q: np.ndarray) -> None:
        q[:, 2] = 3.0 + 4.0 * t - 0.5 * GRAVITY * t**2

    asked = effort(humanoid, posed(humanoid, 0.8, fly))
    inner = slice(10, -10)  # the filter has no neighbours at the ends
    np.testing.assert_allclose(asked.lift[inner], 0.0, atol=0.02)
    at = int(humanoid.model.body_dofadr[humanoid.root])
    np.testing.assert_allclose(asked.forces[inner, at : at + 6], 0.0, atol=5.0)


def test_a_held_arm_needs_its_weight_times_its_lever(humanoid: Character) -> None:
    """Statics: an arm held out to the front, by the moments of its parts about the shoulder."""
    address = int(humanoid.model.joint("right_shoulder").qposadr[0])

    def hold(t: np.ndarray, q: np.ndarray) -> None:
        q[:, address : address + 4] = pitched(-np.pi / 2)

    measured = Measurements(posed(humanoid, 1.0, hold), humanoid)
    data = mujoco.MjData(humanoid.model)
    data.qpos[:] = measured.qpos[0].numpy()
    mujoco.mj_forward(humanoid.model, data)
    shoulder = humanoid.model.body("right_shoulder").id
    lever = data.subtree_com[shoulder][0] - data.xpos[shoulder][0]
    expected = humanoid.model.body_subtreemass[shoulder] * GRAVITY * lever
    row = humanoid.joint_names.index("right_shoulder")
    np.testing.assert_allclose(measured.support.torque[:, row], expected, rtol=1e-3)
    np.testing.assert_allclose(measured.support.share[:, row], expected / 100.0, rtol=1e-3)


def test_a_floor_that_is_known_is_not_estimated(humanoid: Character) -> None:
    """Held 5 cm up, as one who sits with feet in the air: a clip's floor would be there, one that physics played not."""

    def hold(t: np.ndarray, q: np.ndarray) -> None:
        q[:, 2] += 0.05

    clip = posed(humanoid, 1.0, hold)
    assert Measurements(clip, humanoid).ground > 0.04
    known = Measurements(clip, humanoid, level=0.0)
    assert known.ground == 0.0
    assert not known.touching.any()
    kinds = {f.kind for f in examine(clip, humanoid, level=0.0).findings}
    assert "ground_offset" in {f.kind for f in examine(clip, humanoid).findings}
    assert "ground_offset" not in kinds


def test_leaning_without_falling_is_unsupported(humanoid: Character) -> None:
    """Far over its toes, feet flat: the ground can only push up under the feet."""
    ankles = [int(humanoid.model.joint(f"{s}_ankle").qposadr[0]) for s in ("left", "right")]

    def lean(t: np.ndarray, q: np.ndarray) -> None:
        q[:, 3:7] = pitched(1.0)
        for address in ankles:
            q[:, address : address + 4] = pitched(-1.0)

    clip = posed(humanoid, 1.0, lean)
    clip = raised(clip, -Measurements(clip, humanoid).ground)
    found = [f for f in examine(clip, humanoid).findings if f.kind == "unsupported"]
    assert len(found) == 1
    assert (found[0].first, found[0].last) == (0, 60)
    assert "joints in contact cannot" in found[0].what


def test_falling_faster_than_gravity_is_unsupported(humanoid: Character) -> None:
    def throw(t: np.ndarray, q: np.ndarray) -> None:
        flight = np.clip(t - 0.5, 0.0, 0.6)
        q[:, 2] += 0.5 * 3.0 * GRAVITY * flight * (0.6 - flight)

    found = examine(posed(humanoid, 1.6, throw), humanoid).findings
    flying = [f for f in found if f.kind == "unsupported" and "gravity" in f.what]
    assert len(flying) == 1
    assert flying[0].value == pytest.approx(2.0, abs=0.3)
    assert (flying[0].start, flying[0].stop) == pytest.approx((0.5, 1.1), abs=0.16)


def test_a_hop_in_slow_motion_floats(humanoid: Character) -> None:
    hops = walking(generated_hop())
    assert examine(hops, humanoid).findings == ()
    slow = replace(hops, times=2.0 * hops.times)
    assert {f.kind for f in examine(slow, humanoid).findings} == {"float"}


def test_weak_ankles_are_asked_too_much(walk: Clip) -> None:
    model = build_spec().compile()
    for side in "xyz":
        for foot in ("left", "right"):
            model.actuator(f"{foot}_ankle_{side}").forcerange[:] *= 0.3
    weak = Character("weak", model)
    found = examine(walk, weak).findings
    assert {(f.kind, f.joints) for f in found} == {
        ("torque", ("left_ankle",)),
        ("torque", ("right_ankle",)),
    }
    assert examine(walk, weak).worst == "major"


def test_contacts_of_a_walk_and_a_run(walk: Clip, humanoid: Character) -> None:
    """A walk always stands on a foot, at times on two; a run never on two, at times on none."""
    for clip, least, most in ((walk, 1, 2), (generated_run(), 0, 1)):
        measured = Measurements(clip, humanoid)
        feet = measured.touching[:, measured.feet].sum(1)
        assert (feet.min(), feet.max()) == (least, most)
        share = measured.touching[:-1, measured.feet].mean(0)
        np.testing.assert_allclose(share, share[0], atol=0.04)


def test_measuring_leaves_the_model_as_it_was(walk: Clip) -> None:
    model = build_spec().compile()
    character = Character("humanoid", model)
    flags = int(model.opt.disableflags)
    examine(walk, character)
    assert int(model.opt.disableflags) == flags
