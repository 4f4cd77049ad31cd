"""Memories of any field, against what they should have kept, step by step."""

from __future__ import annotations

import math

import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from understudy.task import Context, Memory
from understudy_terms.memories import (
    Extremes,
    History,
    Latch,
    RedrawnTarget,
    Roughness,
    RunningMean,
    Timer,
)

DT = 0.1


def context(worlds: int) -> Context:
    return Context(0, torch.device("cpu"), worlds, control_dt=DT, substeps=1)


def carried(memory: Memory, steps: list[dict[str, Tensor]]) -> list[dict[str, Tensor]]:
    """What it keeps after the beginning and after each step."""
    kept = dict(memory.begin(**steps[0]))
    found = [kept]
    for fields in steps[1:]:
        kept = dict(memory.advance(kept, **fields))
        found.append(kept)
    return found


def step_of(values: list[float]) -> Tensor:
    return torch.tensor(values)


conditions = st.lists(st.booleans(), min_size=2, max_size=20)


@settings(max_examples=50, deadline=None)
@given(conditions)
def test_timer_counts_since_the_condition_last_broke(held: list[bool]) -> None:
    steps = [{"condition": torch.tensor([h])} for h in held]
    found = carried(Timer(None, context(1)), steps)
    since = 0
    for h, kept in zip(held[1:], found[1:], strict=True):
        since = since + 1 if h else 0
        assert abs(float(kept["timer"]) - since * DT) < 1e-5


@settings(max_examples=50, deadline=None)
@given(conditions)
def test_latch_keeps_the_first(held: list[bool]) -> None:
    latch = Latch(Latch.Options(shape=(2,)), context(1))
    steps = [
        {"value": torch.full((1, 2), float(i + 1)), "condition": torch.tensor([float(h)])}
        for i, h in enumerate(held)
    ]
    last = carried(latch, steps)[-1]
    first = held.index(True) + 1 if True in held else 0
    assert last["latched"].tolist() == [[first, first]]
    assert last["held"].tolist() == [float(True in held)]


def test_running_mean_is_the_mean_of_the_episode() -> None:
    values = torch.randn(9, 3, 2)
    mean = RunningMean(RunningMean.Options(shape=(2,)), context(3))
    steps = [
        {"value": v, "episode_step": torch.full((3,), i, dtype=torch.int64)}
        for i, v in enumerate(values)
    ]
    found = carried(mean, steps)
    assert not found[0]["mean"].any()
    for i in range(1, 9):
        torch.testing.assert_close(found[i]["mean"], values[1 : i + 1].mean(0))


def test_history_has_the_newest_first() -> None:
    history = History(History.Options(length=3), context(1))
    found = carried(history, [{"value": step_of([float(i)])} for i in range(5)])
    assert [f["history"].tolist()[0] for f in found] == [
        [0, 0, 0], [1, 0, 0], [2, 1, 0], [3, 2, 1], [4, 3, 2],
    ]  # fmt: skip


def test_targets_stay_in_their_box_and_are_redrawn_after_a_while() -> None:
    options = RedrawnTarget.Options(low=(-1.0, 2.0), high=(1.0, 3.0), every=0.3)
    target = RedrawnTarget(options, context(2))
    steps = [{"uniforms": torch.rand(2, 2)} for _ in range(8)]
    found = [f["target"] for f in carried(target, steps)]
    for value, fields in zip(found[::3], steps[::3], strict=True):
        expected = torch.tensor([-1.0, 2.0]) + fields["uniforms"] * torch.tensor([2.0, 1.0])
        torch.testing.assert_close(value, expected)
    for i in (1, 2, 4, 5, 7):
        assert torch.equal(found[i], found[i - 1])


def test_targets_are_redrawn_where_they_are_reached() -> None:
    options = RedrawnTarget.Options(low=(0.0,), high=(1.0,), within=0.1)
    target = RedrawnTarget(options, context(2))
    kept = target.begin(uniforms=torch.tensor([[0.5], [0.5]]), position=torch.zeros(2, 1))
    drawn = {"uniforms": torch.tensor([[0.9], [0.9]]), "position": torch.tensor([[0.55], [0.7]])}
    kept = target.advance(kept, **drawn)
    torch.testing.assert_close(kept["target"], torch.tensor([[0.9], [0.5]]))
    assert kept["target_age"].tolist()[0] == 0
    assert kept["target_age"].tolist()[1] > 0


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-10, 10, width=32), min_size=1, max_size=20))
def test_extremes_are_those_of_the_episode_so_far(values: list[float]) -> None:
    found = carried(Extremes(None, context(1)), [{"value": torch.tensor([v])} for v in values])
    for k, kept in enumerate(found):
        assert float(kept["least"]) == min(values[: k + 1])
        assert float(kept["most"]) == max(values[: k + 1])


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 4), st.floats(-5, 5, width=32), st.integers(2, 9))
def test_roughness_is_the_mean_size_of_the_derivative(order: int, size: float, length: int) -> None:
    """Of a course s t^k / k! along (0.6, 0.8, 0), beside a point at rest, the k-th derivative is s and 0, and lower ones
    that the course has as well do not count."""
    memory = Roughness(Roughness.Options(shape=(2, 3), order=order), context(1))
    times = DT * torch.arange(length, dtype=torch.float64)
    way = size * times**order / math.factorial(order) + 3.0 * times ** (order - 1)
    along = torch.tensor([[0.6, 0.8, 0.0], [0.0, 0.0, 0.0]], dtype=torch.float64)
    steps = [
        {"value": (w * along)[None], "episode_step": torch.tensor([i])} for i, w in enumerate(way)
    ]
    for i, kept in enumerate(carried(memory, steps)):
        expected = abs(size) / 2 if i >= order else 0.0
        assert abs(float(kept["roughness"]) - expected) < 1e-6 * DT**-order


def test_roughness_is_of_a_whole_episode() -> None:
    memory = Roughness(Roughness.Options(shape=(1,), order=1), context(2))
    values = torch.tensor([[0.0, 0.0], [0.1, 0.0], [0.1, 0.3], [0.4, 0.3]])
    steps = [
        {"value": v[:, None], "episode_step": torch.full((2,), i)} for i, v in enumerate(values)
    ]
    torch.testing.assert_close(carried(memory, steps)[-1]["roughness"], torch.tensor([4 / 3, 1.0]))
