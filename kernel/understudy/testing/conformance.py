"""Checks that hold for every part; each raises AssertionError with what is wrong."""

from __future__ import annotations

import dataclasses
import inspect
import typing
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import options_of
from understudy.running.environment import Environment
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins, installed
from understudy.setup.registry import Component
from understudy.setup.validation import validate
from understudy.task import Simulator
from understudy.testing.capture import check_capturable
from understudy.testing.sentences import sentences


def check_component(component: Component) -> None:
    """It imports, says what it is, and its options have types and a sentence each."""
    factory = component.factory  # imports it
    assert (factory.__doc__ or "").strip(), f"{component.kind} '{component.name}' has no docstring"
    if not inspect.isclass(factory):
        for name, parameter in inspect.signature(factory).parameters.items():
            assert parameter.annotation is not inspect.Parameter.empty, (
                f"parameter '{name}' of {component.kind} '{component.name}' has no type"
            )
    for option in component.options.values():
        assert option.annotation is not inspect.Parameter.empty, (
            f"option '{option.name}' of {component.kind} '{component.name}' has no type"
        )
    missing = ", ".join(f"'{name}'" for name in unsaid(factory))
    assert not missing, (
        f"{component.kind} '{component.name}': no sentence on {missing}. Write '#: ' and what it is, with "
        "unit, range and where the default is from, above it or behind it, without marks such as :class:."
    )


def unsaid(factory: Any) -> Iterator[str]:
    """The options without a sentence that can be printed as it is, those within options too."""
    said = sentences(factory)
    for name, option in options_of(factory).items():
        if not said.get(name) or ":`" in said[name]:  # as of :class:`Name`
            yield name
        for item in (option.annotation, *typing.get_args(option.annotation)):
            if dataclasses.is_dataclass(item):
                yield from (f"{name}.{inner}" for inner in unsaid(item))


def check_simulator(simulator: Simulator, num_worlds: int, vary: Sequence[str] = ()) -> None:
    """What every simulator keeps: shapes, exact restoring of all worlds and of some, sub-steps, and
    that the past of a world does not matter once its state is set.

    `simulator` is fresh and has two worlds or more; `vary` are the parameters to let differ.
    """
    with_typo = f"{next(iter(simulator.parameters), 'mass')}x"
    try:
        simulator.vary([with_typo])
    except ConfigError:
        pass
    else:
        raise AssertionError(f"'{with_typo}' is no parameter, and vary() takes it")
    simulator.vary(tuple(vary))
    for name in vary:
        assert simulator.fields.get(name) == simulator.parameters[name], f"'{name}' is no field"
    assert set(simulator.state_fields) <= set(simulator.fields), "a state field cannot be read"

    def fields() -> dict[str, Tensor]:
        return {name: simulator.read(name).clone() for name in simulator.fields}

    for name, value in fields().items():
        shape = (num_worlds, *simulator.fields[name])
        assert tuple(value.shape) == shape, f"field '{name}' is {tuple(value.shape)}, not {shape}"
    device = simulator.read(simulator.state_fields[0]).device
    control = torch.zeros(num_worlds, simulator.control_size, device=device)
    even = torch.arange(num_worlds, device=device) % 2 == 0

    before, shown = simulator.snapshot(), fields()
    simulator.step(control)
    first = simulator.snapshot()
    assert simulator.failed().shape == (num_worlds,)
    assert not simulator.failed().any(), "fails under zero control"
    simulator.restore(before)
    _same(shown, fields(), "after restore", "the field")
    simulator.step(control)
    _same(first, simulator.snapshot(), "after restore and the same step", "the state's")

    simulator.step(control + 0.1)  # to another state, also where nothing moves without control
    later, shown_later = simulator.snapshot(), fields()
    simulator.restore(before, even)
    _same_rows(before, later, even, simulator.snapshot(), "the state's")
    _same_rows(shown, shown_later, even, fields(), "the field")

    begin = {name: shown[name] for name in (*simulator.state_fields, *vary)}
    simulator.set_state(even, begin)
    once = {**fields(), **simulator.snapshot()}
    simulator.restore(first)
    simulator.step(control + 0.1, 1)
    simulator.set_state(even, begin)
    for name, value in {**fields(), **simulator.snapshot()}.items():
        assert torch.equal(value[even], once[name][even]), f"'{name}' depends on the past"

    simulator.restore(before)
    simulator.step(control, 2)
    together = simulator.snapshot()
    simulator.restore(before)
    simulator.step(control, 1)
    simulator.step(control, 1)
    _same(
        together,
        simulator.snapshot(),
        "after two sub-steps, taken together and singly",
        "the state's",
    )


def _same(
    expected: Mapping[str, Tensor], found: Mapping[str, Tensor], when: str, what: str
) -> None:
    assert expected.keys() == found.keys()
    for name, value in found.items():
        assert torch.equal(value, expected[name]), f"{what} '{name}' differs {when}"


def _same_rows(
    inside: Mapping[str, Tensor],
    outside: Mapping[str, Tensor],
    worlds: Tensor,
    found: Mapping[str, Tensor],
    what: str,
) -> None:
    """`found` are the rows of `inside` in the chosen worlds, and of `outside` in the others."""
    for name, value in found.items():
        assert torch.equal(value[worlds], inside[name][worlds]), (
            f"{what} '{name}' is not restored in the chosen worlds"
        )
        assert torch.equal(value[~worlds], outside[name][~worlds]), (
            f"{what} '{name}' changes in worlds that were not to be restored"
        )


def check_environment(environment: Environment, steps: int = 20) -> None:
    """Any task resets and steps without numbers that go wrong, and repeats exactly."""
    n, size = environment.num_worlds, environment.action_size

    def roll() -> list[torch.Tensor]:
        generator = torch.Generator().manual_seed(0)
        environment.reset(seed=7)
        seen = []
        for _ in range(steps):
            action = 0.1 * torch.randn(n, size, generator=generator)
            step = environment.advance(action.to(environment.device))
            assert not step.unsound.any(), "numbers went wrong under small random actions"
            reached = {name: value.clone() for name, value in step.observations.items()}
            for name, value in reached.items():
                shape = (n, *environment.observation_shapes[name])
                assert tuple(value.shape) == shape, f"observation '{name}' is {tuple(value.shape)}"
            assert step.rewards.shape == (n,)
            seen.extend([step.rewards.clone(), *reached.values()])
            environment.begin(step.ended)
        return seen

    for first, second in zip(roll(), roll(), strict=True):
        assert torch.equal(first, second), "the same seed and actions gave other results"


def check_plugin(name: str, plugins: Plugins | None = None, num_worlds: int = 4) -> None:
    """All that the plugin `name` registers: every component, and every task built and stepped,
    in steps that a GPU could capture."""
    plugins = plugins or installed()
    status = {p.name: p.status for p in plugins.loaded}
    assert status.get(name) == "ok", f"plugin '{name}' is {status.get(name, 'not installed')}"
    for component in plugins.registry.components.values():
        if component.plugin == name:
            check_component(component)
    for task in plugins.registry.tasks.values():
        if task.plugin == name:
            experiment = load_experiment([f"task={task.name}", f"num_worlds={num_worlds}"], plugins)
            effective = experiment.effective()
            assert validate(effective, plugins.registry).effective() == effective, (
                f"task '{task.name}': the configuration with every default filled in is another one"
            )
            built = build_environment(experiment)
            try:
                check_environment(built.environment)
                check_capturable(built.environment)
            finally:
                built.environment.close()
