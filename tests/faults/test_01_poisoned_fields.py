"""Fault 1, of every shipped experiment: one number of one world goes wrong, in each field that there is
and in all that the simulator keeps. It fails or goes on; the others' bits do not change.

What is tried is found in the configurations that the plugins bring, so that a new experiment is poisoned
without a line of its own. Every day a sample that a seed chooses; all of it: ``-m slow``.
"""

from __future__ import annotations

import random
import zlib
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import parts_and_tasks
import pytest
import torch
from stages import above, make_all_stages
from torch import Tensor
from worlds import flat, same_bits

from understudy.errors import ConfigError, UnderstudyError
from understudy.random import WorldStreams
from understudy.running.environment import Environment
from understudy.running.soundness import LARGEST
from understudy.running.table import FieldTable
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.config import Experiment
from understudy_reinforcement.collector import Collector

PLUGINS = parts_and_tasks.bundled()
#: Less the fragments (`_NAME`), which others build on.
EXPERIMENTS = [name for name in parts_and_tasks.options(PLUGINS, "experiment") if "/_" not in name]
FAMILIES = sorted({name.partition("/")[0] for name in EXPERIMENTS})
#: The second decision's numbers are wrong; the third is there to spread them.
N, BAD, STEPS = 4, 2, 3
OTHERS = torch.arange(N) != BAD
VALUES = {"nan": float("nan"), "inf": float("inf"), "1e12": 1e12}
#: Of what stands for the simulator's own memory.
KEPT = "kept by the simulator: "
#: So many experiments of each family, and poisons of each, every day.
SAMPLE = (2, 24)


@dataclass
class Outcome:
    """What came of poisons."""

    tried: int = 0
    failed: int = 0  #: worlds that ended as unsound
    escaped: tuple[str, ...] = ()


def experiment_of(name: str, runs: Path | None) -> Experiment:
    """`name` on the CPU, above the runs in `runs` if it needs some.

    Raises
    ------
    UnderstudyError
        if it cannot be composed alone, or has no environment.
    """
    given = above(name, runs) if runs else ()
    overrides = [f"experiment={name}", f"num_worlds={N}", "device=cpu", *given]
    found = load_experiment(overrides, PLUGINS)
    if found.one("simulator") is None:
        raise ConfigError("It has no environment of its own.")
    if found.need("simulator").component.name == "mujoco_warp":
        overrides.append("simulator=mujoco")
        found = load_experiment(overrides, PLUGINS)
    members = [m.name for m in found.many("simulators") if m.component.name == "mujoco_warp"]
    if members:  # of a composite; its cloth takes nearly all of the time
        overrides += [f"simulators.{name}={{name: mujoco}}" for name in members]
        overrides += ["scene.steps.cloth=1", "control.decision=1"]
        if any(hasattr(scene.options, "substeps") for scene in found.many("scenes")):
            overrides.append("scenes.cloth.substeps=2")  # while a garment is put on
        found = load_experiment(overrides, PLUGINS)
    begins = found.one("initial_states")
    if begins and getattr(begins.options, "plans", 0) > N:  # as many as worlds; each takes its time
        found = load_experiment([*overrides, f"initial_states.plans={N}"], PLUGINS)
    return found


class Idle:
    """A policy of fixed actions; it is its own distribution."""

    def __init__(self, environment: Environment) -> None:
        generator = torch.Generator().manual_seed(0)
        shape = (STEPS, N, environment.action_size)
        self._actions = 0.5 * torch.rand(shape, generator=generator)  # of choices the first
        self._t = -1

    def distribution(self, observations: dict[str, Tensor]) -> Idle:
        self._t += 1
        return self

    def sample(self, streams: WorldStreams) -> Tensor:
        return self._actions[self._t]

    def log_prob(self, action: Tensor) -> Tensor:
        return torch.zeros(N)

    def value(self, observations: dict[str, Tensor]) -> Tensor:
        return torch.stack([v.flatten(1).mean(1) for v in observations.values()]).mean(0)


class Poisonable:
    """An environment, one of whose numbers can be made wrong from its first decision's end to the
    second's."""

    def __init__(self, environment: Environment) -> None:
        self.environment = environment
        environment.reset(seed=1)
        parts = environment.parts
        self._fields = [*parts.initial_states.rollout_fields]
        self._fields += parts.curriculum.rollout_fields if parts.curriculum else ()
        self.fields()  # what is read for the first time is kept from then on
        self._start = environment.state_dict()
        read = {"__getitem__": lambda table, name: self._read(table, name)}
        environment.table.__class__ = type("Poisoned", (FieldTable,), read)
        self._advance, environment.advance = environment.advance, self._watch  # type: ignore[method-assign]
        self._poison: tuple[str, float] | None = None
        self._decisions = 0
        self.clean = self.roll(None)

    def fields(self) -> list[str]:
        """Every field, and everything that the simulator keeps, whose numbers can go wrong."""
        environment = self.environment
        numbers = [n for n in environment.table.shapes if self._wrongable(environment.table[n])]
        kept = environment.parts.simulator.snapshot()
        return [*numbers, *(KEPT + n for n, v in kept.items() if self._wrongable(v))]

    @staticmethod
    def _wrongable(value: Tensor) -> bool:
        return value.is_floating_point() and value.numel() > 0

    def _spoilt(self, name: str, value: Tensor, poison: float) -> Tensor:
        value = value.clone()
        row = value[BAD].view(-1)
        row[zlib.crc32(name.encode()) % len(row)] = poison
        return value

    def _read(self, table: FieldTable, name: str) -> Tensor:
        value = FieldTable.__getitem__(table, name)
        if self._decisions == 1 and self._poison and self._poison[0] == name:
            return self._spoilt(name, value, self._poison[1])
        return value

    def _watch(self, action: Tensor) -> Any:
        simulator = self.environment.parts.simulator
        if self._decisions == 1 and self._poison and self._poison[0].startswith(KEPT):
            (name, poison), kept = self._poison, simulator.snapshot()
            name = name.removeprefix(KEPT)
            simulator.restore({**kept, name: self._spoilt(name, kept[name], poison)}, ~OTHERS)
        step = self._advance(action)
        self._decisions += 1
        self.unsound |= step.unsound
        return step

    def roll(self, poison: tuple[str, float] | None) -> dict[str, Tensor]:
        """All that a learner is handed and all that decides the future, each (N, …) or (…, N, …)."""
        environment = self.environment
        environment.load_state_dict(self._start)
        self._poison, self._decisions = poison, 0
        self.unsound = torch.zeros(N, dtype=torch.bool)
        collector = Collector(environment, Idle(environment), 0, self._fields)  # type: ignore[arg-type]
        found = flat(vars(collector.collect(STEPS)), "rollout")
        self._poison = None
        future = {k: v for k, v in environment.state_dict().items() if k != "statistics"}
        found |= flat(future, "state")
        return {k: v for k, v in found.items() if isinstance(v, Tensor)}

    def poison(self, field: str, value: str) -> str:
        """What escaped, "" if nothing did."""
        try:
            hurt = self.roll((field, VALUES[value]))
        except Exception as error:  # of any kind: it ends the training
            return f"{type(error).__name__}: {str(error)[:100]}"
        for name, tensor in hurt.items():
            before = self.clean[name]
            if name.startswith("rollout"):
                if tensor.is_floating_point() and not (tensor.abs() < LARGEST).all():
                    return f"{name} is not finite"
                worlds = 0 if "/last_observations/" in name else 1
            elif "quarantined" in name or tensor.dim() == 0 or len(tensor) != N:
                continue
            else:
                worlds = 0
            rows = OTHERS.nonzero().squeeze(1)
            if not same_bits(before.index_select(worlds, rows), tensor.index_select(worlds, rows)):
                return f"{name} of another world differs"
        if self.unsound[OTHERS].any():
            return "another world failed"
        return ""


def poisoned(
    name: str, runs: Path | None = None, count: int | None = None, values: Collection[str] = VALUES
) -> Outcome:
    """All poisons of an experiment, or `count` of them; of `values` alone.

    Raises
    ------
    UnderstudyError
        if it cannot be built alone, or has no environment.
    """
    built = build_environment(experiment_of(name, runs)).environment
    try:
        world = Poisonable(built)
        cases = [(field, value) for field in world.fields() for value in values]
        if count is not None:
            cases = random.Random(name).sample(cases, min(count, len(cases)))
        escaped, failed = [], 0
        for field, value in cases:
            found = world.poison(field, value)
            failed += bool(world.unsound[BAD])
            if found:
                escaped.append(f"{field} = {value}: {found}")
        return Outcome(len(cases), failed, tuple(escaped))
    finally:
        built.close()


@pytest.mark.parametrize("family", FAMILIES)
def test_some_poisons_stay_in_their_world(family: str) -> None:
    """Of some experiments of each family, some of all poisons."""
    names = [name for name in EXPERIMENTS if name.startswith(f"{family}/")]
    experiments, count = SAMPLE
    done = 0
    for name in random.Random(family).sample(names, len(names)):
        try:
            found = poisoned(name, count=count)
        except UnderstudyError:
            continue
        print(f"{name}: {found.tried} poisons, {found.failed} worlds failed")
        assert found.tried == count
        assert not found.escaped
        done += 1
        if done == experiments:
            return
    if not done:
        pytest.skip("none of them has an environment of its own")


@pytest.fixture(scope="module")
def stages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_all_stages(tmp_path_factory.mktemp("all_stages"))


@pytest.mark.slow
@pytest.mark.parametrize("name", EXPERIMENTS)
def test_poisons_stay_in_their_world(name: str, stages: Path) -> None:
    try:
        found = poisoned(name, stages)
    except UnderstudyError as error:
        pytest.skip(str(error))
    print(f"{name}: {found.tried} poisons, {found.failed} worlds failed")
    assert found.tried >= 3 * 10
    assert not found.escaped
