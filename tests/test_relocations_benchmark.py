"""Relocations in a row of different objects (``benchmarks/relocations.py --another``)."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
import torch

from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy_chopsticks.relocate import Relocations

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

import relocations


@pytest.mark.parametrize("most", [0, 2])
def test_another_object_is_put_on_the_table_and_planned_for(plugins: Plugins, most: int) -> None:
    words = [
        "task=chopsticks/relocate", "num_worlds=2", "initial_states.plans=2", "initial_states.refill=0", "initial_states.relocations=2",
        "scene.object={kind: any, sizes: [], rolling: 0.0005}", "memory.again.onward=true", f"memory.again.most={most}", "termination.terms.lost=null",
        "termination.terms.dropped=null", "termination.terms.contact_lost=null",
    ]  # fmt: skip
    made = build_environment(load_experiment(words, plugins), evaluating=True)
    environment, table = made.environment, made.environment.table
    initial = environment.parts.initial_states
    assert isinstance(initial, Relocations)
    assert initial.bank.forms is not None
    initial.bank.slipped = lambda place: (
        [0.0] * len(place)
    )  # without a policy sticks slip, and fall
    environment.reset(seed=2)
    first = table["object_shape"].clone()
    # the first to end its relocation
    lengths = torch.stack([(f[:, 17] == 1).nonzero()[0, 0] for f in initial.bank.frames[:2]])
    world = int(lengths[table["plan_row"].long()].argmin())
    simulator, everywhere = environment.parts.simulator, torch.ones(2, dtype=torch.bool)
    while not bool(table["leg_over"][world] > 0):  # without a policy nobody carries it
        state = {name: simulator.read(name).clone() for name in simulator.state_fields}
        state["qpos"][:, 50:57], state["qvel"][:, 48:] = table["planned_object"], 0.0
        kinds = initial.bank.kinds[table["followed"].long()]
        state |= initial.bank.forms.values(kinds, initial.bank.sizes[table["followed"].long()])
        simulator.set_state(everywhere, state)
        environment.advance(torch.zeros(2, 36))
    assert float(table["planned_leg"][world]) == 0.0
    before, hand = table["qpos"].clone(), table["qpos"][world, :50].clone()
    mass = table["body_mass/object"].clone()
    over = torch.arange(2) == world
    generator = torch.Generator().manual_seed(0)
    relocations._put_another(environment, initial.bank, over, generator)
    torch.testing.assert_close(table["qpos"][world, :50], hand)
    torch.testing.assert_close(table["qpos"][~over], before[~over])
    new = table["object_shape"]
    assert not torch.equal(new[world], first[world])
    torch.testing.assert_close(new[~over], first[~over])
    torch.testing.assert_close(table["qpos"][world, 52], new[world, 5])
    assert table["body_mass/object"][world] != mass[world]
    torch.testing.assert_close(table["body_mass/object"][~over], mass[~over])
    step = environment.advance(torch.zeros(2, 36))
    assert not bool(step.ended[world])
    assert float(table["planned_leg"][world]) == 1.0
    assert float(table["object_distance"][world]) < 2e-3, "the plan takes it where it lies"
    assert int(table["followed"][world]) == initial.bank.drawn + world
    assert float(table["plan_stopped"][world]) < 0, "nothing failed: the plan before was of another"
    assert table["replans"].tolist() == [0, 0]
    environment.close()


def test_another_object_waits_for_its_own_plan() -> None:
    words = ["initial_states.relocations=2", "scene.object={kind: any, sizes: [], rolling: 0.0005}"]
    with pytest.raises(SystemExit, match=r"--another needs memory\.again\.onward=true"):
        next(
            relocations.episodes(
                "chopsticks/relocate", words, 0, 1, 1, 8.0, untrained=True, another=True
            )
        )
