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
    """It imports, its options have types, and a term's parameters say what they are."""
    options = component.options  # imports it
    for option in options.values():
        assert option.annotation is not inspect.Parameter.empty, (
            f"option '{option.name}' of {component.kind} '{component.name}' has no type"
        )
    assert (component.factory.__doc__ or "").strip(), (
        f"{component.kind} '{component.name}' has no docstring"
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
    """Any task resets and steps with finite numbers of the promised shapes, and repeats exactly."""
    n, size = environment.num_worlds, environment.action_size

    def roll() -> list[torch.Tensor]:
        generator = torch.Generator().manual_seed(0)
        environment.reset(seed=7)
        seen = []
        for _ in range(steps):
            action = 0.1 * torch.randn(n, size, generator=generator)
            step = environment.step(action.to(environment.device))
            for name, value in step.observations.items():
                shape = (n, *environment.observation_shapes[name])
                assert tuple(value.shape) == shape, f"observation '{name}' is {tuple(value.shape)}"
                assert torch.isfinite(value).all(), f"observation '{name}' is not finite"
            assert step.rewards.shape == (n,)
            assert torch.isfinite(step.rewards).all()
            assert not (step.terminated & step.truncated).any(), "an episode ended in two ways"
            seen.append(step.rewards.clone())
        return seen

    for first, second in zip(roll(), roll(), strict=True):
        assert torch.equal(first, second), "the same seed and actions gave other rewards"


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
            validate(experiment.raw, plugins.registry)
            built = build_environment(experiment)
            try:
                check_environment(built.environment)
            finally:
                built.environment.close()
