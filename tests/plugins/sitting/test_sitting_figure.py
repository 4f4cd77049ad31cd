"""The figure and the chair as models."""

from __future__ import annotations

from pathlib import Path

import mujoco
import pytest
import torch
import trimesh
from sitting_tasks import build, follow_clip

from understudy.errors import ConfigError
from understudy.inputs import Inputs
from understudy.setup.building import Built
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import installed
from understudy_characters.character import load_character
from understudy_characters.scene import CharacterScene
from understudy_humanoid.clips import generated_turn_left, generated_turn_right
from understudy_motion.mirror import mirrored
from understudy_sitting.chair import SEAT, Chair, ChairOptions, slabs
from understudy_sitting.figure import BODIES


def test_the_figure_has_21_degrees_of_freedom() -> None:
    model = load_character("sitting/humanoid", installed().registry).model
    assert (model.nv, model.nu) == (27, 21)
    assert sum(len(body.joints) for body in BODIES) == 21
    assert float(model.body_mass.sum()) == pytest.approx(45.0)


def test_left_and_right_mirror_each_other() -> None:
    character = load_character("sitting/humanoid", installed().registry)
    left = character.qpos(generated_turn_left(angle=3.1416, seconds=3.2))
    right = character.qpos(mirrored(generated_turn_right(angle=3.1416, seconds=3.2)))
    torch.testing.assert_close(left, right, atol=1e-4, rtol=0)
    legs = {b.name: b for b in BODIES}
    for name in ("hip", "knee", "ankle", "shoulder", "elbow"):
        one, other = legs[f"left_{name}"], legs[f"right_{name}"]
        assert one.offset[1] == -other.offset[1]
        for a, b in zip(one.joints, other.joints, strict=True):
            expected = a.range if abs(a.axis[1]) == 1.0 else (-a.range[1], -a.range[0])
            assert b.range == pytest.approx(expected)


def test_servos_that_follow_the_turn_turn_the_figure() -> None:
    """The ankles of this figure do not twist, so its hips must turn it; nothing balances it here."""
    start = ("initial_states.span=[0,0]", "termination=null")
    environment = build("experiment=sitting/turn_left", "num_worlds=2", *start).environment
    environment.reset()
    follow_clip(environment, 96)
    torso, reference = (
        environment.table["torso_angles"],
        environment.table["reference_torso_angles"],
    )
    assert float(reference[0, 1].rad2deg()) == pytest.approx(50.0, abs=4.0)
    assert float(torso[0, 1].rad2deg()) == pytest.approx(50.0, abs=12.0)
    assert float(environment.table["torso_position"][0, 2]) > 1.0


def test_a_chair_is_as_large_as_its_options_say() -> None:
    chair = ChairOptions(seat_height=0.5, width=0.6, depth=0.4, back=0.3, arms=0.2)
    boxes = {slab.name: slab for slab in slabs(chair)}
    assert len(boxes) == 8
    tops = {name: slab.centre[2] + slab.half[2] for name, slab in boxes.items()}
    assert tops[SEAT] == pytest.approx(0.5)
    assert tops["chair_back"] == pytest.approx(0.8)
    assert tops["chair_arm_left"] == pytest.approx(0.7)
    assert 2 * boxes[SEAT].half[0] == pytest.approx(0.4)
    assert 2 * boxes[SEAT].half[1] == pytest.approx(0.6)
    legs = [slab for name, slab in boxes.items() if "leg" in name]
    assert all(slab.centre[2] - slab.half[2] == pytest.approx(0.0) for slab in legs)
    assert {slab.name for slab in slabs(ChairOptions(back=None, legs=False))} == {SEAT}


def test_a_chair_adds_no_mass_and_touches_the_figure_alone(sit: Built) -> None:
    assert isinstance(sit.scene, CharacterScene)
    model = sit.scene.spec().compile()
    assert float(model.body_mass.sum()) == pytest.approx(45.0)
    meets = {
        name: bool(
            model.geom(SEAT).contype[0] & model.geom(name).conaffinity[0]
            or model.geom(name).contype[0] & model.geom(SEAT).conaffinity[0]
        )
        for name in ("root", "left_hip", "right_ankle", "floor", "chair_back")
    }
    assert meets == {
        "root": True, "left_hip": True, "right_ankle": True, "floor": False, "chair_back": False
    }  # fmt: skip


def test_a_chair_may_be_a_mesh(tmp_path: Path) -> None:
    path = tmp_path / "chair.obj"
    seat = trimesh.creation.box((40, 40, 5))
    back = trimesh.creation.box((5, 40, 50))
    back.apply_translation((-40.0, 0, 30))
    trimesh.util.concatenate([seat, back]).export(path)
    spec = mujoco.MjSpec()  # pyright: ignore[reportAttributeAccessIssue]
    spec.worldbody.add_body(name="root").add_geom(size=[0.1, 0, 0])
    Chair(ChairOptions(mesh=str(path), mesh_scale=0.01), installed().registry, Inputs()).add(spec)
    assert spec.compile().nmesh == 2


@pytest.mark.parametrize(
    ("size", "scale", "said"),
    [
        (
            40.0,
            1.0,
            r"40 m long at chair\.mesh_scale=1.* Give chair\.mesh_scale=0\.01\. Of inches it is 0\.0254\.",
        ),
        (1000.0, 0.01, r"10 m long at chair\.mesh_scale=0\.01.* Give chair\.mesh_scale=0\.001\."),
        (1.0, 0.001, r"0\.001 m long .* Give chair\.mesh_scale=1\."),
        (7.0, 1.0, r"7 m long .* Give another chair\.mesh_scale\."),
    ],
)
def test_a_mesh_of_no_chairs_size_is_refused(
    tmp_path: Path, size: float, scale: float, said: str
) -> None:
    path = tmp_path / "chair.obj"
    trimesh.creation.box((size, size, size)).export(path)
    spec = mujoco.MjSpec()  # pyright: ignore[reportAttributeAccessIssue]
    chair = Chair(ChairOptions(mesh=str(path), mesh_scale=scale), installed().registry, Inputs())
    with pytest.raises(ConfigError, match=said):
        chair.add(spec)


@pytest.mark.parametrize("low", [-0.3, 0.0, 0.3])
def test_a_mesh_beside_the_floor_is_said(
    tmp_path: Path, low: float, recwarn: pytest.WarningsRecorder
) -> None:
    path = tmp_path / "chair.glb"
    box = trimesh.creation.box((0.4, 0.4, 0.6))
    box.apply_translation((0.0, 0.0, 0.3 + low))
    box.export(path)
    spec = mujoco.MjSpec()  # pyright: ignore[reportAttributeAccessIssue]
    spec.worldbody.add_body(name="root").add_geom(size=[0.1, 0, 0])
    Chair(ChairOptions(mesh=str(path)), installed().registry, Inputs()).add(spec)
    told = [str(w.message) for w in recwarn if "begins 0.30 m" in str(w.message)]
    assert len(told) == (1 if low else 0)
    assert all(("below the floor" if low < 0 else "above the floor") in t for t in told)


@pytest.mark.parametrize(
    ("heights", "aside", "said"),
    [
        ((0.45,), 0.0, ""),
        ((0.42, 0.47), 0.0, ""),
        ((0.55, 0.6), 0.0, "is 0.60 m high in its middle, as convex parts"),
        ((0.35,), 0.0, "Give chair.seat_height=0.35, or"),
        ((0.45,), 0.5, "has nothing above x = y = 0"),
    ],
)
def test_a_mesh_whose_seat_is_elsewhere_is_said(
    tmp_path: Path,
    heights: tuple[float, ...],
    aside: float,
    said: str,
    recwarn: pytest.WarningsRecorder,
) -> None:
    """The figure sat on the mesh and never on the seat, so that no trial succeeded. `heights` are those of the
    upper sides of parts, one on another."""
    path, low, boxes = tmp_path / "chair.ply", 0.0, []
    for high in heights:
        box = trimesh.creation.box((0.4, 0.4, high - low - 1e-3))
        box.apply_translation((aside, 0.0, 0.5 * (low + high + 1e-3)))
        boxes.append(box)
        low = high
    trimesh.util.concatenate(boxes).export(path)
    spec = mujoco.MjSpec()  # pyright: ignore[reportAttributeAccessIssue]
    spec.worldbody.add_body(name="root").add_geom(size=[0.1, 0, 0])
    Chair(ChairOptions(mesh=str(path)), installed().registry, Inputs()).add(spec)
    told = [str(w.message) for w in recwarn if "chair.seat_height=" in str(w.message)]
    assert len(told) == bool(said)
    assert all(said in t for t in told)


def test_an_impossible_chair_is_refused() -> None:
    with pytest.raises(ConfigError, match="seat_height"):
        load_experiment(["experiment=sitting/sit", "chair.seat_height=0"])


def test_by_one_word_the_figure_has_34_degrees_of_freedom() -> None:
    built = build("experiment=sitting/walk", "scene.character=humanoid", "num_worlds=2")
    assert built.environment.observation_shapes == {"state": (2 * 28 + 8 + 2,)}
    built.environment.reset()
    assert built.environment.step(torch.zeros(2, 28)).rewards.isfinite().all()
