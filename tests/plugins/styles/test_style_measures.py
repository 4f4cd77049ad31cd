"""Energy, volume and accelerations against other ways to compute them; rewards by hand."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from torch import Tensor

from understudy.errors import ConfigError
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.task import Context
from understudy_characters.scene import CharacterScene
from understudy_styles import rewards
from understudy_styles.energy import KineticEnergy
from understudy_styles.regularity import Regularity
from understudy_styles.volume import HullVolume, hull_volume, triples
from understudy_tensors.rotations import from_heading, rotate

SCENE = CharacterScene(CharacterScene.Options("humanoid"))
CONTEXT = Context(0, torch.device("cpu"), 1, control_dt=1 / 30, substeps=20, scene=SCENE)


def moving(seed: int) -> mujoco.MjData:
    """The humanoid in some pose with some velocity."""
    data, rng = mujoco.MjData(SCENE.model), np.random.default_rng(seed)
    data.qvel[:] = rng.normal(size=SCENE.model.nv)
    mujoco.mj_integratePos(SCENE.model, data.qpos, rng.normal(size=SCENE.model.nv), 0.3)
    mujoco.mj_forward(SCENE.model, data)
    return data


def energy_of(data: mujoco.MjData) -> float:
    fields = {
        name: torch.from_numpy(getattr(data, name)).float().unsqueeze(0)
        for name in KineticEnergy.reads
    }
    return float(KineticEnergy(None, CONTEXT).compute(**fields)["kinetic_energy"])


def energy_by_hand(data: mujoco.MjData) -> float:
    """Σ ½ m v² + ½ ω I ω of MuJoCo's own body velocities, less that of the centre of mass."""
    model, total, momentum, mass = SCENE.model, 0.0, np.zeros(3), 0.0
    for body in SCENE.layout.link_bodies.tolist():
        found = np.zeros(6)
        kind = int(mujoco.mjtObj.mjOBJ_BODY)
        mujoco.mj_objectVelocity(model, data, kind, body, found, 0)  # at its centre of mass
        m = model.body_mass[body]
        axes = data.ximat[body].reshape(3, 3).T @ found[:3]
        total += 0.5 * m * found[3:] @ found[3:]
        total += 0.5 * axes @ (model.body_inertia[body] * axes)
        momentum, mass = momentum + m * found[3:], mass + m
    return total - 0.5 * float(momentum @ momentum) / mass


@pytest.mark.parametrize("seed", range(4))
def test_kinetic_energy(seed: int) -> None:
    data = moving(seed)
    assert energy_of(data) == pytest.approx(energy_by_hand(data), rel=1e-4)


def test_moving_on_costs_nothing_and_twice_as_fast_four_times_as_much() -> None:
    data = moving(7)
    before = energy_of(data)
    at = SCENE.layout.root_dof
    data.qvel[at : at + 3] += [3.0, -2.0, 1.0]
    mujoco.mj_forward(SCENE.model, data)
    assert energy_of(data) == pytest.approx(before, rel=1e-4)
    data.qvel[:] *= 2.0
    mujoco.mj_forward(SCENE.model, data)
    assert energy_of(data) == pytest.approx(4.0 * before, rel=1e-4)


@given(st.integers(4, 16), st.integers(0, 10_000), st.floats(0.2, 1.5))
@settings(max_examples=25, deadline=None)
def test_the_hulls_volume_is_that_of_scipy(count: int, seed: int, size: float) -> None:
    points = size * np.random.default_rng(seed).normal(size=(3, count, 3))
    found = hull_volume(torch.from_numpy(points).float(), triples(count))
    expected = torch.tensor([ConvexHull(p).volume for p in points])
    # A slip of 0.3 mm of the surface: its area times that, and a little for float32.
    slip = torch.tensor([ConvexHull(p).area for p in points]) * 5e-4 + 1e-6
    assert ((found - expected).abs() <= slip).all()


def test_faces_of_more_than_three_corners() -> None:
    """A cube: all of its faces have four, and each could be cut in two ways."""
    corners = torch.tensor([[x, y, z] for x in (0.0, 0.5) for y in (0.0, 0.5) for z in (0.0, 0.5)])
    inside = torch.full((1, 3), 0.25)
    points = torch.cat([corners, inside]).unsqueeze(0)
    assert hull_volume(points, triples(9)).item() == pytest.approx(0.125, rel=0.01)
    flat = points * torch.tensor([1.0, 1.0, 0.0])
    assert hull_volume(flat, triples(9)).item() == pytest.approx(0.0, abs=5e-4)


@given(st.integers(0, 10_000), st.floats(-3.0, 3.0))
@settings(max_examples=20, deadline=None)
def test_where_the_character_is_does_not_matter(seed: int, turn: float) -> None:
    generator = torch.Generator().manual_seed(seed)
    points = 0.4 * torch.randn(1, 12, 3, generator=generator)
    moved = rotate(from_heading(torch.tensor([turn])).unsqueeze(1), points)
    moved = moved + torch.tensor([20.0, -7.0, 0.5])
    before, after = (hull_volume(p, triples(12)) for p in (points, moved))
    torch.testing.assert_close(before, after, rtol=0.02, atol=2e-4)


def test_the_points_can_be_chosen() -> None:
    data = moving(1)
    xipos = torch.from_numpy(data.xipos).float().unsqueeze(0)
    names = ("left_wrist", "right_wrist", "left_ankle", "right_ankle", "neck")
    made = HullVolume(HullVolume.Options(links=names), CONTEXT)
    rows = [mujoco.mj_name2id(SCENE.model, mujoco.mjtObj.mjOBJ_BODY, n) for n in names]
    expected = ConvexHull(data.xipos[rows]).volume
    assert made.compute(xipos)["hull_volume"].item() == pytest.approx(expected, abs=1e-3)
    with pytest.raises(ConfigError, match="no link 'left_rist'"):
        HullVolume(HullVolume.Options(links=("left_rist",)), CONTEXT)
    with pytest.raises(ConfigError, match="hull of 2 points"):
        HullVolume(HullVolume.Options(links=names[:2]), CONTEXT)


def test_energy_is_rewarded_between_20_and_100_joule() -> None:
    energy = torch.tensor([0.0, 20.0, 40.0, 100.0, 300.0])
    assert rewards.high_energy(energy).tolist() == pytest.approx([0.0, 0.0, 0.25, 1.0, 1.0])
    assert rewards.low_energy(energy).tolist() == pytest.approx([1.0, 1.0, 0.75, 0.0, 0.0])


def test_volume_is_rewarded_by_its_exponential() -> None:
    volume = torch.tensor([0.0, 0.12, 0.24])
    small, large = rewards.small_volume(volume), rewards.large_volume(volume)
    torch.testing.assert_close(small, torch.exp(torch.tensor([0.0, -1.0, -2.0])))
    torch.testing.assert_close(small + large, torch.ones(3))


def test_regularity_is_equation_3_7() -> None:
    regularity = Regularity(Regularity.Options(energy=100.0, link=50.0, joint=200.0), CONTEXT)
    energy, links, joints = torch.tensor([50.0]), torch.full((1, 3), 25.0), torch.full((1, 4), 50.0)
    expected = math.exp(-(0.5 + 3 * 0.5 + 4 * 0.25) / 8)
    assert regularity(energy, links, joints).item() == pytest.approx(expected)
    assert regularity(*(torch.zeros_like(t) for t in (energy, links, joints))).item() == 1.0


@pytest.fixture(scope="module")
def walking() -> dict[str, Tensor]:
    """Fields of a walk, from its reference's own targets, before and after one decision."""
    chosen = ["experiment=spacetime/walk", "+style=high_energy", "num_worlds=4"]
    environment = build_environment(load_experiment(chosen)).environment
    environment.reset(3)
    names = ("qvel", "link_linear_velocities", "root_heading", "xquat")
    before = {f"before_{n}": environment.table[n].clone() for n in names}
    begun = {
        "begun_links": environment.table["link_accelerations"].clone(),
        "begun_joints": environment.table["joint_accelerations"].clone(),
    }
    environment.advance(environment.table["reference_joint_targets"].clone())
    after = {n: environment.table[n].clone() for n in names}
    for name in ("link_accelerations", "joint_accelerations"):
        after[name] = environment.table[name].clone()
    environment.close()
    return {**before, **begun, **after}


def test_an_episode_begins_without_accelerations(walking: dict[str, Tensor]) -> None:
    assert walking["begun_links"].abs().max() < 1e-5
    assert walking["begun_joints"].abs().max() == 0.0


def test_accelerations_are_changes_of_velocity(walking: dict[str, Tensor]) -> None:
    layout = SCENE.layout
    change = (walking["qvel"] - walking["before_qvel"]) * 30.0
    row = layout.joint_names.index("left_hip")
    dofs = layout.ball_dofs[layout.ball_rows.tolist().index(row)]
    found = walking["joint_accelerations"]
    torch.testing.assert_close(found[:, row], change[:, dofs].norm(dim=1))
    knee = layout.joint_names.index("left_knee")
    dof = SCENE.model.joint("left_knee").dofadr[0]
    torch.testing.assert_close(found[:, knee], change[:, dof].abs())
    chest = layout.link_names.index("chest")
    world = [
        rotate(from_heading(walking[f"{when}root_heading"]),
               walking[f"{when}link_linear_velocities"][:, chest])
        for when in ("", "before_")
    ]  # fmt: skip
    expected = ((world[0] - world[1]) * 30.0).norm(dim=1)
    torch.testing.assert_close(
        walking["link_accelerations"][:, chest], expected, rtol=1e-4, atol=1e-4
    )


def test_an_exchanged_range_of_energies_is_refused() -> None:
    """It rewarded the opposite."""
    words = ["experiment=spacetime/walk", "+style=low_energy"]
    load_experiment([*words, "reward.terms.style.least=30"])
    with pytest.raises(
        ConfigError, match=r"reward\.terms\.style\.least=100 is not possible: it must be less than"
    ):
        load_experiment([*words, "reward.terms.style.least=100", "reward.terms.style.most=20"])
