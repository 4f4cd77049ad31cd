"""Two policies compared start by start."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest

from understudy_reinforcement.evaluation import Evaluation
from understudy_reinforcement.paired import Paired


def found(values: Sequence[float], of: str = "success", starts: int | None = None) -> Evaluation:
    """Of episodes with these outcomes, the first `starts` of which began differently."""
    keys = [str(k % (starts or len(values))).encode() for k in range(len(values))]
    return Evaluation(
        len(values),
        success_rate=0.5 if of == "success" else None,
        outcomes=list(zip(keys, values, strict=True)),
        compared=of,
    )


def pair(first: Evaluation, second: Evaluation) -> Paired:
    paired = Paired.of_evaluations(first, second)
    assert paired is not None
    return paired


@pytest.mark.parametrize(
    ("lost", "won", "chance", "falls"),
    [
        (0, 0, 1.0, False),
        (4, 0, 1 / 16, False),
        (5, 0, 1 / 32, True),
        (6, 1, 8 / 128, False),
        (14, 1, 16 / 2**15, True),  # 26 of 32 and 13 of 32
        (0, 9, 1.0, False),
    ],
)
def test_success_by_the_sign_test(lost: int, won: int, chance: float, falls: bool) -> None:
    """Worked by hand: of n starts that differ all or all but one are lost in 1 and n + 1 of 2^n ways."""
    both = 32 - lost - won
    first, second = [1.0] * lost + [0.0] * won, [0.0] * lost + [1.0] * won
    paired = pair(found(first + [1.0] * both), found(second + [1.0] * both))
    assert (paired.worse, paired.better, paired.starts) == (lost, won, 32)
    assert paired.chance == pytest.approx(chance)
    assert paired.falls == falls
    assert f"(lost {lost}, won {won})" in paired.sentence()
    assert ("a loss beyond chance" in paired.sentence()) == falls


def test_a_start_counts_once() -> None:
    """Ten episodes from two starts are two."""
    first, second = [1.0, 1.0] * 5, [1.0, 0.0] * 5
    paired = pair(found(first, starts=2), found(second, starts=2))
    assert (paired.starts, paired.worse, paired.first, paired.second) == (2, 1, 1.0, 0.5)
    assert paired.chance == 0.5
    assert paired.falls, "of so few any counts, since no test could tell"
    assert paired.sentence() == (
        "success from 50% of 2 starts instead of 100% (lost 1, won 0), a loss"
    )


@pytest.mark.parametrize(("by", "falls"), [(0.5, False), (0.005, False), (0.02, True)])
def test_an_objective_falls_by_more_than_its_noise_and_more_than_a_hundredth(
    by: float, falls: bool
) -> None:
    """Half less on average, in differences of -4 and 3 by turns, is chance; half a hundredth everywhere is small."""
    first = [1.0 + 0.1 * k for k in range(32)]
    if by == 0.5:
        second = [a + (-4.0, 3.0)[k % 2] for k, a in enumerate(first)]
    else:
        mean = sum(first) / 32
        second = [a - by * mean * (1 + 0.1 * (k % 3)) for k, a in enumerate(first)]
    paired = pair(found(first, "reached"), found(second, "reached"))
    assert paired.falls == falls
    assert paired.sentence().startswith(f"reached {paired.second:.4g} instead of")


def test_what_went_wrong_is_the_least() -> None:
    first = found([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, math.nan], "reached")
    paired = pair(first, found([1.0, math.nan, 3.0, 4.0, 5.0, 6.0, 7.0], "reached"))
    assert (paired.starts, paired.worse, paired.second) == (6, 1, pytest.approx(20 / 6))


def test_where_single_episodes_are_unknown_nothing_is_paired() -> None:
    assert Paired.of_evaluations(Evaluation(4), Evaluation(4)) is None


@pytest.mark.parametrize(
    ("successes", "starts", "can"),
    [(0, 32, False), (4, 32, False), (5, 32, True), (0, 2, False), (1, 2, True)],
)
def test_who_succeeds_nowhere_loses_nothing(successes: int, starts: int, can: bool) -> None:
    """Of 32 starts five must be lost before it shows."""
    values = [1.0] * successes + [0.0] * (starts - successes)
    paired = pair(found(values), found([0.0] * starts))
    assert paired.can_fall == can
    assert ("too few successes to show a loss" in paired.sentence()) != can
    assert not paired.falls or can
    assert pair(found([0.0] * starts, "reached"), found([0.0] * starts, "reached")).can_fall
