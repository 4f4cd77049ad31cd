"""The checks for writers of plugins fail where they should."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
import torch
from counted_task import Line, Push, Starts, Where, line, term
from torch import Tensor

from understudy.setup.plugins import Plugins, hookimpl, load
from understudy.setup.registry import Component, Registrar
from understudy.task import Encoder
from understudy.testing import (
    check_capturable,
    check_component,
    check_environment,
    check_plugin,
    check_simulator,
    fake,
)


def component(target: Any, kind: str = "encoder") -> Component:
    return Component(kind, "mine", target, "mine")


class Documented(Where):
    """Has all it needs."""

    @dataclass(frozen=True)
    class Options:
        size: int = 3  #: a number


class Undocumented(Encoder):
    shape = (1,)


def untyped(x, *, limit: float = 1.0):
    """Its field has no type."""


def untyped_option(x: Tensor, *, limit=1.0):
    """Its option has no type."""


def unsaid_option(x: Tensor, *, limit: float = 1.0) -> Tensor:
    """Nothing says what its option is."""
    return x


def marked_option(
    x: Tensor,
    *,
    limit: float = 1.0,  #: as :class:`Documented` has it
) -> Tensor:
    """What is said is for a page of documentation."""
    return x


def undocumented(x: Tensor) -> Tensor: ...


def test_check_component() -> None:
    check_component(component(Documented))
    check_component(component(fake.near_origin, "reward"))


@pytest.mark.parametrize(
    ("target", "message"),
    [
        (Undocumented, "encoder 'mine' has no docstring"),
        (undocumented, "has no docstring"),
        (untyped, "parameter 'x' of encoder 'mine' has no type"),
        (untyped_option, "'limit' of encoder 'mine' has no type"),
        (unsaid_option, "encoder 'mine': no sentence on 'limit'"),
        (marked_option, "encoder 'mine': no sentence on 'limit'"),
    ],
)
def test_check_component_refuses(target: Any, message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        check_component(component(target))


def test_check_component_imports() -> None:
    with pytest.raises(Exception, match="cannot be used"):
        check_component(component("no_such_module:Encoder"))


# ---------------------------------------------------------------------- environments


def test_check_environment() -> None:
    check_environment(line(terminations=[term(lambda x: x[:, 0].abs() > 0.3, "far")], seconds=3))


class Forgetful(Starts):
    """Where it begins depends on how often it was asked."""

    def sample(self, streams: Any, **fields: Tensor) -> dict[str, Tensor]:
        given = super().sample(streams)
        return {"x": given["x"] + len(self.taken)}


class Chance(Push):
    """Pushes at random, from the global generator."""

    def control(self, action: Tensor) -> Tensor:
        return action + torch.rand_like(action)


class Explosive(Push):
    """Pushes without measure."""

    def control(self, action: Tensor) -> Tensor:
        return 1e12 * action


class Growing(Where):
    """One number more than it says, after a while."""

    calls = 0

    def encode(self, x: Tensor) -> Tensor:
        self.calls += 1
        return x if self.calls < 5 else x.repeat(1, 2)


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"initial_states": Forgetful()}, "the same seed and actions gave other results"),
        ({"actuation": Chance()}, "the same seed and actions gave other results"),
        ({"actuation": Explosive()}, "numbers went wrong under small random actions"),
        ({"encoders": {"state": Growing()}}, r"observation 'state' is \(4, 2\)"),
        ({"rewards": [term(lambda x: x[:, 0] / 0, "odd")]}, "numbers went wrong"),
    ],
    ids=["initial states", "chance", "explosion", "shape", "reward"],
)
def test_check_environment_refuses(parts: Mapping[str, Any], message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        check_environment(line(**parts))


def test_check_capturable() -> None:
    far = term(lambda x: x[:, 0].abs() > 0.3, "far")
    rows = torch.tensor([0])

    def allowed(x: Tensor) -> Tensor:
        """What looks like it waits and does not."""
        x = torch.where(x > 0, x, 0.0).index_select(1, rows)[:, rows].clone()
        x[:, 0] = 2.0
        return torch.as_tensor(x.masked_fill(x > 1, 1.0)[..., 0])

    check_capturable(line(terminations=[far], rewards=[term(allowed, "allowed")], seconds=3))


@pytest.mark.parametrize(
    ("waits", "message"),
    [
        (lambda x: x[:, 0] if x.sum() > 0 else -x[:, 0], "a branch on a tensor"),
        (lambda x: x[:, 0] * x.sum().item(), r"\.item\(\)"),
        (lambda x: x[:, 0] * float(x.sum()), r"float\(\) of a tensor"),
        (lambda x: x[:, 0] * max(x[:, 0].tolist()), r"\.tolist\(\)"),
        (lambda x: torch.from_numpy(x[:, 0].numpy()), r"\.numpy\(\)"),
        (lambda x: x.cpu()[:, 0], r"\.cpu\(\)"),
        (lambda x: x[:, 0] + torch.tensor([1.0]), "a tensor made of numbers"),
        (lambda x: x[:, 0] + torch.as_tensor([1.0]), "a tensor made of numbers"),
        (lambda x: x[:, [0]][:, 0], "indexing with a list"),
        (lambda x: x[:, 0] + x[x > 5].sum(), "indexing with a mask"),
        (lambda x: x[:, 0] + torch.masked_select(x, x > 5).sum(), "masked_select"),
        (lambda x: x[:, 0] + len(torch.where(x > 5)[0]), "nonzero"),
        (lambda x: x[:, 0] + len(x.unique()), "unique"),
        (lambda x: x[:, 0] * torch.equal(x, x), "torch.equal"),
        (
            lambda x: x[:, 0] + torch.linalg.inv(torch.eye(2) + x.mean())[0, 0],
            "checks for errors",
        ),
    ],
)
def test_check_capturable_refuses(waits: Any, message: str) -> None:
    environment = line(rewards=[term(waits, "waits")])
    with pytest.raises(AssertionError, match=f"{message}.* in a step waits for the device"):
        check_capturable(environment)
    environment.step(torch.zeros(4, 1))  # nothing is left behind


def test_a_simulator_may_wait() -> None:
    class Waiting(Line):
        """On the CPU, where there is nothing to wait for."""

        def failed(self) -> Tensor:
            return torch.tensor([bool(x > 1e9) for x in self.x.flatten().tolist()])

    check_capturable(line(simulator=Waiting(None, SimpleNamespace(num_worlds=4, substeps=1))))


# ---------------------------------------------------------------------- simulators


def made(kind: type[Line]) -> Line:
    return kind(None, SimpleNamespace(num_worlds=4, substeps=2))


class Sticky(Line):
    """Keeps something that it does not tell of."""

    def step(self, control: Tensor, substeps: int | None = None) -> None:
        super().step(control + len(self.calls), substeps)


class RestoresAll(Line):
    """Restores every world, whichever are asked for."""

    def restore(self, snapshot: Mapping[str, Tensor], worlds: Tensor | None = None) -> None:
        super().restore(snapshot)


class Lumpy(Line):
    """Two sub-steps at once are not two, one after the other."""

    def step(self, control: Tensor, substeps: int | None = None) -> None:
        super().step(control, substeps)
        if substeps is None or substeps > 1:
            self.x += 0.5


class TakesAnything(Line):
    """Lets worlds differ in what it does not have."""

    def vary(self, names: Any) -> None:
        pass


class Wide(Line):
    """Says another shape than it has."""

    fields = {"x": (2,)}


def test_check_simulator() -> None:
    check_simulator(made(Line), 4)
    check_simulator(made(Line), 4, vary=("gain",))


@pytest.mark.parametrize("kind", [Sticky, RestoresAll, Lumpy, TakesAnything, Wide])
def test_check_simulator_refuses(kind: type[Line]) -> None:
    with pytest.raises(AssertionError):
        check_simulator(made(kind), 4)


# ---------------------------------------------------------------------- plugins

TASK = """# @package _global_
task: mine/task
scene: {name: fake}
simulator: {name: fake}
encoder: {state: {name: fake/point}}
actuation: {name: fake/force}
reward: {terms: {near: {name: mine/near}}}
initial_states: {name: fake/somewhere}
"""


def mine(tmp_path: Path, near: Any = fake.near_origin, task: str = TASK, **more: Any) -> Plugins:
    """The plugin ``mine``, with a task."""
    (tmp_path / "conf/task/mine").mkdir(parents=True)
    (tmp_path / "conf/task/mine/task.yaml").write_text(task)
    module = ModuleType("mine")
    module.__file__, module.__package__ = str(tmp_path / "__init__.py"), "mine"

    def register(register: Registrar) -> None:
        register.component("reward", "mine/near", near)
        register.task("mine/task", "a task")
        for kind, factory in more.items():
            register.component(kind, "mine/more", factory)

    module.understudy_register = hookimpl(register)  # type: ignore[attr-defined]
    return load(only=[], extra=[("fake", fake), ("mine", module)])


def test_check_plugin(tmp_path: Path) -> None:
    check_plugin("mine", mine(tmp_path))
    check_plugin("fake", mine(tmp_path / "again"))


def test_check_plugin_refuses_what_did_not_load(tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match="plugin 'yours' is not installed"):
        check_plugin("yours", mine(tmp_path))
    with pytest.raises(
        AssertionError,
        match=r"plugin 'mine' is PluginError: it registers 'mine/more' as a 'lerner'",
    ):
        check_plugin("mine", mine(tmp_path / "again", lerner=Documented))


def infinite(qpos: Tensor) -> Tensor:
    """Is infinite."""
    return qpos[:, 0] / 0.0


def odd_default(
    qpos: Tensor,
    *,
    #: of nothing
    scale: float = None,  # type: ignore[assignment]  # noqa: RUF013
) -> Tensor:
    """Has a default that is not of its type."""
    return qpos[:, 0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"near": infinite}, "numbers went wrong"),
        ({"near": undocumented}, "has no docstring"),
        ({"encoder": Undocumented}, "encoder 'mine/more' has no docstring"),
        ({"task": TASK.replace("mine/near", "mine/nearer")}, "There is no reward 'mine/nearer'"),
        ({"task": TASK.replace("fake/force", "fake/farce")}, "There is no actuation 'fake/farce'"),
        ({"near": odd_default}, "reward.terms.near.scale=null is not possible"),
    ],
)
def test_check_plugin_refuses(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(Exception, match=message):
        check_plugin("mine", mine(tmp_path, **changes))
