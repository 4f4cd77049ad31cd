"""A walk in a skirt, whose task knows nothing of it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from understudy.errors import ConfigError
from understudy.running.environment import Environment
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.testing.capture import check_capturable
from understudy.testing.conformance import check_environment
from understudy_cloth.checking import check_mesh
from understudy_dressing.skirt import SkirtScene, around, cone
from understudy_tensors import rotations

WALK = ("num_worlds=2", "initial_states=characters/reference_states", "policy.feedback.hidden=[8]")
COARSE = ("scenes.skirt.edge=0.1", "simulators.skirt.every=20")


@pytest.fixture(scope="module")
def environment() -> Iterator[Environment]:
    built = build_environment(load_experiment(["experiment=dressing/skirt_walk", *WALK, *COARSE]))
    yield built.environment
    built.environment.close()


def at_the_root(environment: Environment, local: torch.Tensor) -> torch.Tensor:
    """(N, V, 3) m, world frame, of points (V, 3) in the root body's frame."""
    qpos = environment.table["qpos"]
    turn = qpos[:, None, 3:7].expand(-1, len(local), -1)
    return qpos[:, None, :3] + rotations.rotate(turn, local.expand(len(qpos), -1, -1))


def test_a_skirt_is_a_sound_cone_of_the_size_asked_for() -> None:
    options = SkirtScene.Options(waist=0.9, hem=1.8, length=0.4, edge=0.05)
    points, faces = cone(options)
    check_mesh(points, faces, "the skirt")
    rows = points.reshape(-1, around(options), 3)
    for row, perimeter in ((rows[0], 0.9), (rows[-1], 1.8)):
        sides = np.linalg.norm(np.roll(row, -1, axis=0) - row, axis=1)
        assert sides.sum() == pytest.approx(perimeter, rel=0.01)
    assert np.linalg.norm(rows[-1, 0] - rows[0, 0]) == pytest.approx(0.4)
    assert rows[0, 0, 2] > rows[-1, 0, 2], "it hangs down"
    a, b, c = (points[faces[:, corner]] for corner in range(3))
    outward = np.cross(b - a, c - a)[:, :2] * a[:, :2]
    assert (outward.sum(axis=1) > 0).all()


def test_it_begins_around_the_one_who_wears_it_and_moves_with_them(
    environment: Environment,
) -> None:
    environment.reset(seed=3)
    options = SkirtScene.Options(edge=0.1)
    local = torch.tensor(cone(options)[0], dtype=torch.float32)
    before = environment.table["cloth_position"].clone()
    torch.testing.assert_close(before, at_the_root(environment, local), atol=1e-4, rtol=0)
    # as fast as a rigid body that moves as the root does: a small step of the root by its velocity
    qpos, qvel = environment.table["qpos"].double(), environment.table["qvel"].double()
    built = build_environment(load_experiment(["experiment=spacetime/walk", *WALK]))
    model = built.context.scene.compiled(built.context)  # type: ignore[union-attr]
    built.environment.close()
    for world in range(2):
        moved = qpos[world].numpy().copy()
        mujoco.mj_integratePos(model, moved, qvel[world].numpy(), 1e-4)
        turn = torch.tensor(moved[3:7]).expand(len(local), -1)
        place = torch.tensor(moved[:3]) + rotations.rotate(turn, local.double())
        turn = qpos[world, 3:7].expand(len(local), -1)
        now = qpos[world, :3] + rotations.rotate(turn, local.double())
        expected = ((place - now) / 1e-4).float()
        torch.testing.assert_close(
            environment.table["cloth_velocity"][world], expected, atol=2e-2, rtol=0
        )


def test_it_hangs_from_the_waist_in_folds(environment: Environment) -> None:
    environment.reset(seed=3)
    options = SkirtScene.Options(edge=0.1)
    local = torch.tensor(cone(options)[0], dtype=torch.float32)
    for _ in range(4):
        step = environment.advance(torch.zeros(2, environment.action_size))
        assert not step.unsound.any()
        assert not step.ended.any()
    away = (environment.table["cloth_position"] - at_the_root(environment, local)).norm(dim=2)
    assert float(away[:, : around(options)].max()) < 2e-3, "the waistband is held"
    hem = away[:, -around(options) :]
    assert 0.03 < float(hem.max()) < 0.5, "the hem is not rigid, and does not fly away"


def test_the_one_who_wears_it_feels_nothing(environment: Environment) -> None:
    """The same walk without a skirt, of the same physics."""
    alone = build_environment(
        load_experiment(["experiment=spacetime/walk", *WALK, "resolution.substeps=null"])
    ).environment
    for one in (environment, alone):
        one.reset(seed=5)
    torch.testing.assert_close(alone.table["qpos"], environment.table["qpos"])
    for _ in range(3):
        for one in (environment, alone):
            one.advance(torch.zeros(2, one.action_size))
        torch.testing.assert_close(
            alone.table["qpos"], environment.table["qpos"], atol=1e-4, rtol=0
        )
    alone.close()


def test_it_keeps_to_the_rules_of_environments(environment: Environment) -> None:
    check_environment(environment, steps=6)
    check_capturable(environment)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["scenes.skirt.hem=4.0"], "hem=4.0"),
        (["scenes.skirt.edge=0.001"], "edge=0.001"),
        (["scenes.skirt.waist=0.3"], r"6.1 cm inside the body 'root'.*enlarge waist"),
        (["scenes.skirt.waist=0.7"], r"1.5 cm inside the body 'root'"),
        (["scenes.skirt.character=humanoidd"], "humanoid"),
        (["couplings.worn.target=person"], "no skirt"),
        (["couplings.worn.target=skrt"], "skirt"),
        (["scenes.skirt.character=amorphous/cook"], "'neck'"),
    ],
)
def test_what_cannot_be_worn_is_refused(words: list[str], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        build_environment(
            load_experiment(["experiment=dressing/skirt_walk", *WALK, *words])
        ).environment.close()


def test_shapes_that_cloth_does_not_meet_are_named() -> None:
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="hips")
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_ELLIPSOID, size=[0.1, 0.2, 0.1])
    from understudy_dressing.skirt import _surfaces

    with pytest.raises(ConfigError, match="'hips'"):
        _surfaces(spec.compile(), "ball")


def test_the_skirt_of_another_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "stick.xml"
    file.write_text(
        """<mujoco><worldbody><body name="hips" pos="0 0 1"><freejoint/><geom size="0.1"/>
        <body name="leg"><joint/><geom type="capsule" fromto="0 0 0 0 0 -1" size="0.05"/></body></body>
        </worldbody></mujoco>"""
    )
    words = ["experiment=dressing/skirt_walk", *WALK, f"scenes.skirt.character={file}"]
    with pytest.raises(ConfigError, match="'person' has no body 'hips'"):
        build_environment(load_experiment(words))
