"""What the solver is for, in numbers: heaps, fluids, bodies, tools."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch
from granular import MASS, RADIUS, Yielding, disturbed, lattice, run, simulator, tied

from understudy_pbd.scene import (
    Box,
    Capsule,
    Fluid,
    Grid,
    Material,
    ParticleModel,
    Shape,
    Springs,
    Table,
    Tool,
    pan,
)

ALL = torch.ones(1, dtype=torch.bool)


def slope_of_heap(friction: float) -> float:
    """Degrees, of the cone that has the mean height and the mean radius of a column that fell."""
    column = disturbed(lattice((6, 6, 9), 2.05 * RADIUS, (-0.05, -0.05, RADIUS)), 0.1 * RADIUS)
    materials = (Material(friction=friction),)
    heap = simulator(
        ParticleModel(column, RADIUS, MASS, materials=materials, table=Table(friction))
    )
    x = run(heap, 90)[0].numpy()
    radii = np.linalg.norm(x[:, :2] - x[:, :2].mean(axis=0), axis=1)
    return float(np.degrees(np.arctan(2 * (x[:, 2] - RADIUS).mean() / radii.mean())))


def test_a_heap_is_steeper_with_more_friction() -> None:
    slopes = [slope_of_heap(friction) for friction in (0.0, 0.2, 0.4, 0.8)]
    assert slopes[0] < 2, "without friction a heap lies flat"
    assert all(b > a + 1 for a, b in itertools.pairwise(slopes)), slopes
    assert 15 < slopes[-1] < 45, slopes


def test_cohesion_holds_a_column_together() -> None:
    column = disturbed(lattice((4, 4, 8), 2 * RADIUS, (0, 0, RADIUS)), 0.03 * RADIUS)

    def width(cohesion: float) -> float:
        materials = (Material(friction=0.2, cohesion=cohesion),)
        x = run(simulator(ParticleModel(column, RADIUS, MASS, materials=materials)), 120)[0]
        return float((x[:, :2] - x[:, :2].mean(dim=0)).norm(dim=1).mean())

    widths = [width(cohesion) for cohesion in (0.0, 0.3, 0.6, 0.9)]
    assert all(b < a for a, b in itertools.pairwise(widths)), widths
    assert widths[-1] < 0.55 * widths[0], widths


def fluid(counts: tuple[int, int, int], spacing: float) -> tuple[ParticleModel, float]:
    """A block of water that fills a box with so many layers, and its rest density."""
    rest, side = 1000.0, counts[0] * spacing
    model = ParticleModel(
        lattice(counts, spacing, (0.5 * spacing,) * 3),
        0.5 * spacing,
        rest * spacing**3,
        materials=(Material(friction=0.0, fluid=Fluid(rest, 2 * spacing)),),
        table=Table(0.0, (0.0, 0.0), (side, side)),
    )
    return model, rest


def test_a_settled_fluid_has_its_rest_density() -> None:
    spacing, counts = 0.02, (7, 7, 8)
    model, rest = fluid(counts, spacing)
    h, mass = 2 * spacing, rest * spacing**3
    x = run(simulator(model), 120)[0].double().numpy()
    # poly6 (Müller et al. 2003), summed here
    r2 = ((x[:, None] - x[None]) ** 2).sum(axis=-1)
    rho = mass * (315 / (64 * np.pi * h**9) * np.clip(h * h - r2, 0, None) ** 3).sum(axis=1)
    side = counts[0] * spacing
    inside = (np.minimum(x[:, :2], side - x[:, :2]) > h).all(axis=1) & (x[:, 2] > h)
    inside &= x[:, 2] < np.quantile(x[:, 2], 0.98) - h
    assert inside.sum() >= 10
    assert abs(rho[inside].mean() / rest - 1) < 0.02
    # and it takes the room that its mass needs, walls and table notwithstanding
    top = np.sort(x[:, 2])[-(counts[0] ** 2) :].mean() + 0.5 * spacing
    assert abs(top / (counts[2] * spacing) - 1) < 0.04


def test_viscosity_slows_a_fluid() -> None:
    def spread(viscosity: float) -> float:
        materials = (Material(friction=0.0, fluid=Fluid(1000.0, 4 * RADIUS, viscosity)),)
        block = lattice((5, 5, 5), 2 * RADIUS, (0, 0, RADIUS))
        x = run(simulator(ParticleModel(block, RADIUS, 0.008, materials=materials)), 20)[0]
        return float((x[:, :2] - x[:, :2].mean(dim=0)).norm(dim=1).mean())

    assert spread(0.9) < 0.85 * spread(0.0)


@pytest.mark.parametrize("kind", ["grains", "body", "fluid"])
def test_momentum_is_kept(kind: str) -> None:
    positions = disturbed(lattice((5, 5, 5), 2.02 * RADIUS, (0, 0, 0)), 0.05 * RADIUS)
    rng = np.random.default_rng(1)
    mass: np.ndarray | float = rng.uniform(0.5, 2.0, 125) * MASS
    radius: np.ndarray | float = rng.uniform(0.8, 1.0, 125) * RADIUS
    material, springs = Material(friction=0.5, cohesion=0.3), Springs()
    if kind == "body":
        springs = tied(positions, 3.1 * RADIUS)
    if kind == "fluid":
        material, mass, radius = Material(fluid=Fluid(1000.0, 4 * RADIUS, 0.3)), 0.008, RADIUS
    model = ParticleModel(
        positions,
        radius,
        mass,
        materials=(material,),
        springs=springs,
        table=None,
        gravity=(0, 0, 0),
    )
    found = simulator(model)
    # towards the middle, so that everything meets
    v = -8 * torch.tensor(positions - positions.mean(axis=0)) + torch.tensor([0.3, -0.2, 0.1])
    v += torch.tensor(rng.normal(0, 0.2, v.shape))
    v = v.float()[None]
    found.set_state(
        ALL, {"particle_position": found.read("particle_position"), "particle_velocity": v}
    )
    weight = torch.tensor(np.broadcast_to(mass, 125).copy())[:, None]
    before, scale = (weight * v[0]).sum(dim=0), (weight * v[0].norm(dim=1, keepdim=True)).sum()
    run(found, 60)
    after = found.read("particle_velocity")[0]
    assert (after - v[0]).norm(dim=1).mean() > 0.1, "they never met"
    assert float(((weight * after).sum(dim=0) - before).norm() / scale) < 1e-4


@pytest.mark.parametrize("amount", [0.05, 0.4])
def test_an_elastic_body_springs_back(amount: float) -> None:
    block = lattice((5, 5, 5), 2 * RADIUS, (0, 0, 0.2))
    model = ParticleModel(
        block, RADIUS, MASS, springs=tied(block, 3 * RADIUS), table=None, gravity=(0, 0, 0)
    )
    assert abs(height_after_pressing(model, amount) / (8 * RADIUS) - 1) < 0.01


def height_after_pressing(model: ParticleModel, amount: float) -> float:
    found = simulator(model)
    x = found.read("particle_position").clone()
    middle = x[..., 2].mean()
    x[..., 2] = middle + (1 - amount) * (x[..., 2] - middle)
    found.set_state(ALL, {"particle_position": x, "particle_velocity": torch.zeros_like(x)})
    z = run(found, 60)[0, :, 2]
    return float(z.max() - z.min())


def test_a_rule_changes_springs_while_they_run() -> None:
    """Not the model of plugin `amorphous`, but what it needs: lengths that yield and ties that break."""
    block = lattice((5, 5, 5), 3 * RADIUS, (0, 0, 0.2))  # too far apart to touch: only springs act

    def model(
        reach: float = 4.5 * RADIUS, break_at: float = 9 * RADIUS, yield_at: float = 0.15
    ) -> ParticleModel:
        return ParticleModel(
            block,
            RADIUS,
            MASS,
            springs=tied(block, reach),
            table=None,
            gravity=(0, 0, 0),
            rules=(Yielding(break_at, yield_at),),
        )

    whole = 12 * RADIUS
    assert height_after_pressing(model(), 0.05) > 0.99 * whole
    assert height_after_pressing(model(), 0.4) < 0.8 * whole

    found = simulator(model(3.1 * RADIUS, break_at=4.5 * RADIUS, yield_at=10.0))
    upper = found.read("particle_position")[0, :, 2] > 0.27
    v = torch.zeros(1, len(block), 3)
    v[0, :, 2] = torch.where(upper, 9.0, -6.0)
    x = found.read("particle_position")
    found.set_state(ALL, {"particle_position": x, "particle_velocity": v})
    before = found.read("spring_partners") >= 0
    run(found, 30)
    partners = found.read("spring_partners")[0]
    broken = before[0] & (partners < 0)
    # the 25 between two layers, each on both sides, and nothing else
    assert int(broken.sum()) == int(found.snapshot()["rule_0_broken"].sum()) == 50
    owner, slot = torch.nonzero(partners >= 0, as_tuple=True)
    other = partners[owner, slot].long()
    assert (partners[other] == owner[:, None]).any(dim=1).all(), "tied on one side only"
    z = found.read("particle_position")[0, :, 2]
    assert z.max() - z.min() > 1.0
    assert ((z[owner] > z.mean()) == (z[other] > z.mean())).all(), "two halves are still tied"


SPHERE = (
    np.linalg.norm(lattice((33, 33, 33), 0.005, (-0.08,) * 3), axis=1).reshape(33, 33, 33) - 0.04
)


@pytest.mark.parametrize(
    ("shape", "speed"),
    [
        (Box((0.005, 0.12, 0.05)), 0.5),
        (Box((0.005, 0.12, 0.05)), 2.0),
        (Box((0.001, 0.12, 0.05)), 4.0),  # thinner than what it moves in a sub-step
        (Capsule(0.03, 0.08, orientation=(0.7071, 0.7071, 0.0, 0.0)), 1.0),
        (Grid(SPHERE, 0.005, (-0.08,) * 3), 1.0),
        (Grid(SPHERE, 0.005, (-0.08,) * 3), 4.0),
    ],
)
def test_nothing_is_in_the_tool_or_the_table(shape: Shape, speed: float) -> None:
    grains = disturbed(lattice((6, 6, 6), 2.05 * RADIUS, (-0.05, -0.05, RADIUS)), 0.1 * RADIUS)
    begin, end = -0.2, 0.25
    tool = Tool((shape,), (begin, 0.0, 0.05))
    found = simulator(ParticleModel(grains, RADIUS, MASS, tools=(tool,)))
    run(found, 20, begin, 0.0, 0.05, 0.0, 0.0, 0.0)
    before = float(found.read("particle_position")[0, :, 0].mean())
    deepest = 0.0
    for period in range(int((end - begin) / speed * 60)):
        at = begin + speed / 60 * (period + 1)
        x = run(found, 1, at, 0.0, 0.05, 0.0, 0.0, 0.2 * at)[0].double().numpy()
        place = found.read("tool_position")[0].double().numpy()
        w, _, _, z = found.read("tool_orientation")[0].double().tolist()
        angle = 2 * np.arctan2(z, w)
        c, s = np.cos(angle), np.sin(angle)
        local = (x - place) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        assert abs(place[0] - at) < 1e-5, "the tool is not where it was sent"
        assert abs(angle - 0.2 * at) < 1e-4
        deepest = max(deepest, float((RADIUS - distance(shape, local)).max()))
        assert (RADIUS - x[:, 2]).max() < 0.2 * RADIUS
    assert deepest < 0.2 * RADIUS
    assert float(found.read("particle_position")[0, :, 0].mean()) > before + 0.02, (
        "nothing was moved"
    )
    assert not found.failed().any()


def distance(shape: Shape, p: np.ndarray) -> np.ndarray:
    """Signed distances of points (P, 3) from a shape in its tool's frame, m."""
    if isinstance(shape, Box):
        q = np.abs(p) - np.array(shape.half_extents)
        return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)
    if isinstance(shape, Capsule):  # along y, as turned above
        q = p - np.stack(
            [0 * p[:, 0], np.clip(p[:, 1], -shape.half_length, shape.half_length), 0 * p[:, 0]], 1
        )
        return np.linalg.norm(q, axis=1) - shape.radius
    return np.linalg.norm(p, axis=1) - 0.04


def test_a_pan_carries_and_tosses() -> None:
    grains = lattice((4, 4, 2), 2.05 * RADIUS, (-0.03, -0.03, 0.12))
    found = simulator(
        ParticleModel(grains, RADIUS, MASS, tools=(Tool(pan(0.1, 0.04), (0, 0, 0.1)),))
    )
    run(found, 40, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0)
    for period in range(60):  # 30 cm along x
        run(found, 1, 0.005 * (period + 1), 0.0, 0.1, 0.0, 0.0, 0.0)
    x = run(found, 20, 0.3, 0.0, 0.1, 0.0, 0.0, 0.0)[0]
    assert ((x[:, :2] - torch.tensor([0.3, 0.0])).norm(dim=1) < 0.1).all()
    assert (x[:, 2] > 0.1 + 0.8 * RADIUS).all()
    for period in range(6):  # up at 1.2 m/s, and stop
        run(found, 1, 0.3, 0.0, 0.1 + 0.02 * (period + 1), 0.0, 0.0, 0.0)
    assert found.read("tool_velocity")[0, 2] == pytest.approx(1.2, rel=1e-3)
    x = run(found, 6, 0.3, 0.0, 0.22, 0.0, 0.0, 0.0)[0]
    assert (x[:, 2] > 0.22 + 3 * RADIUS).all(), "nothing left the pan"


def test_sleep_stops_what_hardly_moves() -> None:
    slope = Table(friction=0.3)
    model = ParticleModel(
        [[0.0, 0.0, RADIUS]], RADIUS, MASS, materials=(Material(0.3),), table=slope,
        gravity=(3.1, 0.0, -9.81),
    )  # fmt: skip
    creeping, sleeping = (float(run(simulator(model, sleep=s), 60)[0, 0, 0]) for s in (0.0, 0.1))
    assert creeping > 1e-3, "more than friction holds"
    assert sleeping == 0.0
