"""The visco-plastic model (Zhang et al. 2020, section 3.5.1): what it should do to a block of material.

All simulations have 64 particles and one tool, so that Warp compiles once.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
import torch
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from understudy.task import Context
from understudy_amorphous.scene import AmorphousScene, near_pairs
from understudy_amorphous.viscoplastic import Plasticity, ViscoPlastic
from understudy_pbd.scene import Box, ParticleModel, ParticleScene, Shape, Springs, Tool
from understudy_pbd.simulator import ParticleSimulator

CONTEXT = Context(seed=0, device=torch.device("cpu"), num_worlds=1, control_dt=1 / 30, substeps=2)
EVERYWHERE = torch.ones(1, dtype=torch.bool)
#: What presses from above, and a blade that cuts across x.
PLATE = Box((2.0, 2.0, 0.05), (0.0, 0.0, 0.05))
BLADE = Box((0.02, 2.0, 1.0), (0.0, 0.0, 1.0))


class Given(ParticleScene):
    def __init__(self, model: ParticleModel) -> None:
        self._model = model

    def model(self) -> ParticleModel:
        return self._model


class Bench:
    """A block, or two, of the plugin's own visco-plastic material, under a tool of the test's."""

    def __init__(self, shape: Shape = PLATE, blocks: int = 1, **changes: Any) -> None:
        block = (4, 4, 4 // blocks)
        self.scene = AmorphousScene(AmorphousScene.Options(blocks=blocks, block=block), CONTEXT)
        tool = Tool((shape,), friction=0.0)
        self.model = dataclasses.replace(self.scene.model(), tools=(tool,), **changes)
        context = dataclasses.replace(CONTEXT, _shared={})
        context.scene = Given(self.model)
        self.simulator = ParticleSimulator(ParticleSimulator.Options(), context)
        self.begin(self.model.positions)

    def begin(self, positions: np.ndarray) -> None:
        place = torch.as_tensor(positions, dtype=torch.float32).unsqueeze(0)
        self.simulator.set_state(
            EVERYWHERE,
            {
                "particle_position": place,
                "particle_velocity": torch.zeros_like(place),
                "tool_position": torch.tensor([[0.0, 0.0, 3.0]]),
                "tool_orientation": torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
            },
        )

    def move(self, to: float, periods: int) -> None:
        """Bring the tool to that height, m, evenly."""
        start = float(self.simulator.read("tool_position")[0, 2])
        for i in range(periods):
            z = start + (to - start) * (i + 1) / periods
            self.simulator.step(torch.tensor([[0.0, 0.0, z, 0.0, 0.0, 0.0]]))

    @property
    def position(self) -> np.ndarray:
        return self.simulator.read("particle_position")[0].numpy().copy()

    @property
    def height(self) -> float:
        """m, of the upper side of the layer that was on top."""
        top = self.model.positions[:, 2] > self.model.positions[:, 2].max() - 0.01
        return float(self.position[top, 2].mean()) + self.scene.radius

    def springs(self) -> dict[tuple[int, int], float]:
        """Lengths by (own, partner): each spring twice."""
        partners = self.simulator.read("spring_partners")[0].numpy()
        lengths = self.simulator.read("spring_lengths")[0].numpy()
        return {
            (i, int(j)): float(length)
            for i, (row, values) in enumerate(zip(partners, lengths, strict=True))
            for j, length in zip(row, values, strict=True)
            if j >= 0
        }

    @property
    def pieces(self) -> int:
        ends = np.array(list(self.springs()) or np.zeros((0, 2)), int).reshape(-1, 2)
        size = len(self.model.positions)
        graph = coo_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), (size, size))
        return int(connected_components(graph, directed=False)[0])


def assert_mutual(bench: Bench) -> None:
    """Both ends of every spring know it, with one length."""
    springs = bench.springs()
    for (i, j), length in springs.items():
        assert springs[j, i] == pytest.approx(length, abs=1e-6)


@pytest.mark.parametrize(("compression", "left"), [(0.05, (0.98, 1.02)), (0.4, (0.55, 0.72))])
def test_a_block_springs_back_from_five_percent_and_keeps_forty(
    compression: float, left: tuple[float, float]
) -> None:
    bench = Bench()
    bench.move(3.0, 40)  # it comes to rest
    before = bench.height
    bench.move(before, 10)
    bench.move(before * (1 - compression), 30)
    assert bench.height == pytest.approx(before * (1 - compression), rel=0.03), (
        "the plate pressed it"
    )
    bench.move(3.0, 20)
    bench.move(3.0, 60)
    assert left[0] <= bench.height / before <= left[1]
    assert_mutual(bench)


@pytest.mark.parametrize(("pull", "splits"), [(10.0, False), (80.0, True)])
def test_a_block_splits_when_it_is_pulled_hard(pull: float, splits: bool) -> None:
    """One half is held, the other pulled by as much as `pull` m/s² gives its mass."""
    held = Bench().model.positions[:, 0] < 0
    bench = Bench(mass=np.where(held, 0.0, 8.0), gravity=(pull, 0.0, 0.0), table=None)
    assert bench.pieces == 1
    bench.move(3.0, 30)
    assert (bench.pieces > 1) == splits
    stretched = bench.position[:, 0].max() - bench.model.positions[:, 0].max()
    assert (stretched > 1.0) == splits
    assert_mutual(bench)


def test_two_blocks_merge_where_one_is_pressed_onto_the_other() -> None:
    bench = Bench(blocks=2)
    assert bench.pieces == 2
    one = bench.scene.block
    apart = np.concatenate([one, one + np.array([0.0, 0.0, 0.8])])
    bench.begin(apart)
    bench.move(3.0, 1)
    assert bench.pieces == 2
    bench.move(3.0, 20)  # the upper one falls
    bench.move(0.6, 20)
    bench.move(3.0, 40)
    assert bench.pieces == 1
    assert_mutual(bench)


def test_a_blade_cuts_the_springs_that_it_is_between() -> None:
    bench = Bench(BLADE)
    bench.move(3.0, 20)
    side = bench.position[:, 0] > 0
    across = [(i, j) for i, j in bench.springs() if side[i] != side[j]]
    assert across
    bench.move(0.05, 40)  # its edge just above the table
    through = [
        (i, j) for i, j in bench.springs()
        if (bench.position[i, 0] > 0) != (bench.position[j, 0] > 0)
        and min(bench.position[i, 2], bench.position[j, 2]) > 0.1
    ]  # fmt: skip
    assert through == []
    assert_mutual(bench)


def test_springs_keep_or_take_their_length_by_the_ratio() -> None:
    """Algorithm 2 by hand: three pairs of particles, at 0.9, 0.8 and 1.2 of their springs' lengths."""
    plasticity = Plasticity(compress=0.85, stretch=1.15)
    bench = Bench()
    count = 64
    positions = np.zeros((count, 3))
    positions[:, 0] = np.arange(count)  # alone, but for three pairs
    positions[:, 2] = 50.0
    distances = {(0, 1): 0.18, (2, 3): 0.16, (4, 5): 0.24}
    for (i, j), d in distances.items():
        positions[j] = positions[i] + [d, 0.0, 0.0]
    springs = Springs(np.array(list(distances)), np.full(3, 0.2), slots=4, stiffness=1e-6)
    bench = Bench(positions=positions, springs=springs, rules=(ViscoPlastic(plasticity, 0.2),))
    bench.move(3.0, 1)
    found = bench.springs()
    assert found[0, 1] == pytest.approx(0.2)
    assert found[2, 3] == pytest.approx(0.16, abs=1e-3)
    assert found[4, 5] == pytest.approx(0.24, abs=1e-3)


def test_springs_that_find_no_slot_leave_none_behind() -> None:
    """A dense block whose particles may have three springs only: no end is left alone."""
    positions = AmorphousScene(AmorphousScene.Options(blocks=1, block=(4, 4, 4)), CONTEXT).block
    none = Springs(np.zeros((0, 2), int), np.zeros(0), slots=3, stiffness=0.5)
    bench = Bench(positions=positions, springs=none)
    bench.move(3.0, 10)
    assert 0 < len(bench.springs()) <= 3 * 64
    assert_mutual(bench)


def test_pairs_are_those_near_each_other() -> None:
    points = np.array([[0.0, 0, 0], [0.3, 0, 0], [0, 0.2, 0], [5.0, 0, 0]])
    pairs, lengths = near_pairs(points, 0.35)
    assert pairs.tolist() == [[0, 1], [0, 2]]
    assert lengths.tolist() == pytest.approx([0.3, 0.2])


@pytest.mark.parametrize(
    "options", [{"split": 1.4}, {"compress": 1.1}, {"stretch": 0.9}, {"stiffness": 0.0}]
)
def test_impossible_thresholds_are_refused(options: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="is not possible"):
        Plasticity(**options)
