"""A step depends on nothing but tensors that stay where they are.

What a CUDA graph does is done here by hand, on the CPU: the torch operations and the Warp launches of
one step are noted, and repeated on the very same tensors instead of running the step's code again.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

pytest.importorskip(
    "mujoco_warp", reason="MuJoCo Warp is not installed (pip install 'understudy[gpu]')"
)

from understudy.running.environment import Environment
from understudy.running.step import Step
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment

WORLDS = 8


class Noted(TorchDispatchMode):
    """Every torch operation, with its arguments and what it returned; and Warp's work."""

    def __init__(self) -> None:
        super().__init__()
        self.repeats: list[Callable[[], None]] = []

    def __torch_dispatch__(
        self,
        func: Any,
        types: Any,
        args: tuple[Any, ...] = (),
        kwargs: dict[str, Any] | None = None,
    ) -> Any:
        kwargs = kwargs or {}
        result = func(*args, **kwargs)
        if not func.is_view:
            self.repeats.append(lambda: overwrite(result, func(*args, **kwargs)))
        return result


def overwrite(old: Any, new: Any) -> None:
    """Let the tensors that an operation returned hold what it returns now."""
    for tensor, value in zip(tree_leaves(old), tree_leaves(new), strict=True):
        if isinstance(tensor, torch.Tensor) and tensor.data_ptr() != value.data_ptr():
            tensor.copy_(value)


def step(environment: Environment, action: torch.Tensor) -> Step:
    """A step as it is on a GPU, where worlds are begun whether or not any ended."""
    reached = environment.advance(action)
    reached.observations = environment.begin(reached.ended)
    return reached


@pytest.mark.slow
@pytest.mark.parametrize("initial_states", ["importance", "evolution"])
def test_a_step_that_is_replayed_is_the_step(
    initial_states: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    overrides = [
        "experiment=spacetime/walk", "simulator=mujoco_warp", "device=cpu", f"num_worlds={WORLDS}",
        f"initial_states=spacetime/{initial_states}", "episode.seconds=0.4",
    ]  # fmt: skip
    plain, replayed = (build_environment(load_experiment(overrides)).environment for _ in range(2))
    chance = torch.Generator().manual_seed(0)
    actions = 0.3 * torch.randn(60, WORLDS, plain.action_size, generator=chance)
    for environment in (plain, replayed):
        environment.reset()
        for action in actions[:3]:
            step(environment, action)

    noted, simulator = Noted(), replayed.parts.simulator
    carry_out = simulator._run  # pyright: ignore[reportAttributeAccessIssue]

    def note(key: Any, work: Callable[[], None]) -> None:
        noted.repeats.append(work)
        carry_out(key, work)

    given = actions[3].clone()
    replayed.refresh()
    monkeypatch.setattr(simulator, "_run", note)
    with noted:
        found = step(replayed, given)
    ended = 0
    for i, action in enumerate(actions[3:]):
        expected = step(plain, action)
        if i > 0:
            given.copy_(action)
            for repeat in noted.repeats:
                repeat()
        ended += int(expected.ended.sum())
        for name in ("rewards", "terminated", "truncated", "returns"):
            assert torch.equal(getattr(found, name), getattr(expected, name)), f"{name}, step {i}"
        for name, value in expected.observations.items():
            assert torch.equal(found.observations[name], value), f"{name}, step {i}"
    assert ended > 2 * WORLDS
