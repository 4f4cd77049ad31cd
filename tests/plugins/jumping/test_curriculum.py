"""The bar rises by the rewards that come together (section 4.6.1, table 4.1)."""

from __future__ import annotations

import pytest
import torch

from understudy.errors import ConfigError
from understudy.random import WorldStreams
from understudy.task import Context, Rollout
from understudy_jumping.curriculum import Accumulated


def context(num_worlds: int = 4, **more: object) -> Context:
    return Context(
        seed=0, device=torch.device("cpu"), num_worlds=num_worlds, control_dt=1 / 60, substeps=5,
        **more,  # type: ignore[arg-type]
    )  # fmt: skip


def rollout(ended: torch.Tensor, returns: torch.Tensor) -> Rollout:
    """One of `ended` (T, N) and `returns` (T, N), all else empty."""
    nothing = torch.zeros_like(returns)
    return Rollout(
        observations={}, last_observations={}, actions=nothing, log_probs=nothing,
        rewards=nothing, terminated=ended, truncated=torch.zeros_like(ended),
        failed=torch.zeros_like(ended), final_values=nothing, episode_returns=returns, fields={},
    )  # fmt: skip


def of(value: float, steps: int = 2, worlds: int = 4) -> Rollout:
    """All episodes end with this return in the last of `steps`."""
    ended = torch.zeros(steps, worlds, dtype=torch.bool)
    ended[-1] = True
    return rollout(ended, torch.full((steps, worlds), value))


def test_it_rises_when_the_sum_is_beyond_the_threshold() -> None:
    """R_T = 30 with a mean return of 0.7: in the 43rd iteration of 4096 samples, by 1 cm of 150."""
    curriculum = Accumulated(Accumulated.Options(batch=8), context())
    for iteration in range(1, 44):
        assert curriculum.update(of(0.7))["difficulty"] == pytest.approx(
            0.0 if iteration < 43 else 1 / 150
        )
    streams = WorldStreams(0, "a test", 4, "cpu")
    torch.testing.assert_close(curriculum.begin(streams)["difficulty"], torch.full((4,), 1 / 150))
    assert curriculum.state_dict()["sums"] == [0.0], "the sum begins anew"


def test_it_begins_with_the_tasks_difficulty_at_most() -> None:
    options = Accumulated.Options(start=0.5)
    assert Accumulated(options, context(difficulty=0.5)).state_dict()["difficulty"] == [0.5]
    with pytest.raises(ConfigError, match=r"curriculum\.start=0\.5 is beyond difficulty=0\.4"):
        Accumulated(options, context(difficulty=0.4))
    assert Accumulated(options, context(difficulty=0.4, evaluating=True)).state_dict()[
        "difficulty"
    ] == [0.4]


def test_a_larger_iteration_counts_as_several() -> None:
    curriculum = Accumulated(Accumulated.Options(threshold=3.0, batch=2), context())
    assert curriculum.update(of(0.7))["difficulty"] == 0.0  # 8 samples are 4 iterations: 2.8
    assert curriculum.update(of(0.7))["difficulty"] == pytest.approx(1 / 150)


def test_the_mean_is_of_ended_episodes() -> None:
    ended = torch.tensor([[True, False], [True, True]])
    returns = torch.tensor([[1.0, 0.5], [0.0, 0.5]])
    curriculum = Accumulated(Accumulated.Options(batch=4), context(2))
    curriculum.update(rollout(ended, returns))
    assert curriculum.state_dict()["sums"] == [pytest.approx(0.5)]
    curriculum.update(rollout(torch.zeros_like(ended), returns))
    assert curriculum.state_dict()["sums"] == [pytest.approx(0.5)], "no episode, no reward"


def test_groups_have_bars_of_their_own() -> None:
    """World i is of group i mod 2; only the first group's are rewarded."""
    options = Accumulated.Options(threshold=1.0, batch=8, groups=2, step=0.1)
    curriculum = Accumulated(options, context())
    returns = torch.tensor([[0.9, 0.0, 0.9, 0.0]] * 2)
    ended = torch.tensor([[False] * 4, [True] * 4])
    found = [curriculum.update(rollout(ended, returns)) for _ in range(4)][-1]
    assert found["difficulty_0"] == pytest.approx(0.2)
    assert found["difficulty_1"] == 0.0
    assert found["difficulty"] == pytest.approx(0.1)
    begun = curriculum.begin(WorldStreams(0, "a test", 4, "cpu"))["difficulty"]
    torch.testing.assert_close(begun, torch.tensor([0.2, 0.0, 0.2, 0.0]))


def test_it_ends_at_the_tasks_difficulty_and_stands_there_in_evaluations() -> None:
    options = Accumulated.Options(threshold=0.1, batch=8, step=0.3)
    curriculum = Accumulated(options, context(difficulty=0.5))
    found = [curriculum.update(of(0.9)) for _ in range(5)][-1]
    assert found["difficulty"] == 0.5
    judged = Accumulated(options, context(difficulty=0.5, evaluating=True))
    assert judged.begin(WorldStreams(0, "a test", 4, "cpu"))["difficulty"].tolist() == [0.5] * 4


def test_decisions_get_shorter_as_the_bar_rises() -> None:
    knots = ((0.0, 6), (0.25, 3), (0.5, 2))
    options = Accumulated.Options(threshold=0.1, batch=8, step=0.25, decision=knots)
    curriculum = Accumulated(options, context())
    assert curriculum.decision() == 6
    found = curriculum.update(of(0.9))
    assert curriculum.decision() == 3
    assert found["mark/difficulty 0.25"] == 1.0
    curriculum.update(of(0.9))
    assert curriculum.decision() == 2


def test_it_goes_on_where_it_was() -> None:
    options = Accumulated.Options(threshold=2.0, batch=8, groups=2)
    first = Accumulated(options, context())
    for _ in range(4):
        first.update(of(0.7))
    second = Accumulated(options, context())
    second.load_state_dict(first.state_dict())
    for _ in range(3):
        assert first.update(of(0.6)) == second.update(of(0.6))
    streams = WorldStreams(0, "a test", 4, "cpu")
    torch.testing.assert_close(first.begin(streams), second.begin(streams))


def test_bars_of_another_number_of_groups_are_refused() -> None:
    many = Accumulated(Accumulated.Options(groups=2), context())
    for here, there in ((1, 2), (2, 1)):
        state = Accumulated(Accumulated.Options(groups=there), context()).state_dict()
        with pytest.raises(ValueError, match=f"{here} groups here and {there} there"):
            Accumulated(Accumulated.Options(groups=here), context()).load_state_dict(state)
    many.load_state_dict({"difficulty": [2.0, 0.5], "sums": [0.0, 0.0]})
    assert many.state_dict()["difficulty"] == [1.0, 0.5], "beyond this task's there is nothing"
