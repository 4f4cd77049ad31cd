"""Checks that hold for every part; each raises AssertionError with what is wrong."""

from __future__ import annotations

import inspect

import torch

from understudy.running.environment import Environment
from understudy.setup.building import build_environment
from understudy.setup.config import load_experiment, validate
from understudy.setup.plugins import Plugins, installed
from understudy.setup.registry import Component
from understudy.task import Simulator


def check_component(component: Component) -> None:
    """It imports, says what it is, and its options have types."""
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


def check_simulator(simulator: Simulator, num_worlds: int) -> None:
    """Shapes, restoring, and that the past of a world does not matter once its state is set."""
    for name, shape in simulator.fields.items():
        value = simulator.read(name)
        assert tuple(value.shape) == (num_worlds, *shape), f"field '{name}' is {tuple(value.shape)}"
    before = simulator.snapshot()
    control = torch.zeros(num_worlds, simulator.control_size)
    simulator.step(control)
    first = simulator.snapshot()
    simulator.restore(before)
    simulator.step(control)
    for name, value in simulator.snapshot().items():
        assert torch.equal(value, first[name]), f"'{name}' differs after restore and the same step"
    assert simulator.failed().shape == (num_worlds,)
    assert not simulator.failed().any(), "fails under zero control"


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
    """All that the plugin `name` registers: every component, and every task built and stepped."""
    plugins = plugins or installed()
    status = {p.name: p.status for p in plugins.loaded}
    assert status.get(name) == "ok", f"plugin '{name}' is {status.get(name, 'not installed')}"
    for component in plugins.registry.components.values():
        if component.plugin == name:
            check_component(component)
    for task in plugins.registry.tasks.values():
        if task.plugin == name:
            experiment = load_experiment(
                [f"task={task.option}", f"num_worlds={num_worlds}"], plugins
            )
            effective = experiment.effective()
            assert validate(effective, plugins.registry).effective() == effective, (
                f"task '{task.name}': the configuration with every default filled in is another one"
            )
            built = build_environment(experiment)
            try:
                check_environment(built.environment)
            finally:
                built.environment.close()
