"""Which checkpoint ``checkpoint=best`` is, and what counts as a share."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from understudy.errors import ConfigError
from understudy_judging.commands import _best, _nearest, _share, _value


def run(*rows: dict[str, float]) -> Any:
    return SimpleNamespace(metrics=lambda: list(rows))


def judged(
    iteration: int, rate: float, figure: str = "evaluation/success_rate"
) -> dict[str, float]:
    return {"iteration": iteration, figure: rate}


def test_the_best_is_the_one_that_was_judged_best() -> None:
    rows = judged(3, 0.2), judged(10, 0.9), judged(19, 0.4)
    assert _best(run(*rows), [0, 5, 12, 20]) == 12
    assert _best(run(*rows), [0, 20]) == 20, "its last evaluation counts"
    assert _best(run(judged(5, 0.5), judged(20, 0.5)), [0, 5, 20]) == 20, "of equals the later"


def test_evaluations_that_were_given_up_count_by_what_they_can_be() -> None:
    rows = judged(5, 0.6, "evaluation/success_rate_at_most"), judged(20, 0.3)
    assert _best(run(*rows), [0, 5, 20]) == 5


def test_without_evaluations_returns_decide() -> None:
    rows = [judged(1, 5.0, "episode/return"), judged(2, 7.0, "episode/return"), judged(3, float("nan"), "episode/return")]  # fmt: skip
    assert _best(run(*rows), [0, 1, 2, 3]) == 2
    assert _best(run(), [0, 4]) == 4


@pytest.mark.parametrize(
    ("text", "share"),
    [("0.5", 0.5), (".25", 0.25), ("50%", 0.5), ("0%", 0.0), ("1.0", 1.0), ("12.5%", 0.125),
     ("90", None), ("1", None), ("1.5", None), ("200%", None), ("last", None), ("00000090.safetensors", None)],
)  # fmt: skip
def test_shares(text: str, share: float | None) -> None:
    assert _share(text) == share


@pytest.mark.parametrize(
    ("share", "nearest"), [(0.5, 24), (0.49, 0), (1.0, 24), (0.0, 0), (0.51, 24)]
)
def test_of_two_as_near_the_later_is_a_share(share: float, nearest: int) -> None:
    """An untrained one is no half of a training of which first and last are kept."""
    assert _nearest([0, 24], share) == nearest


def test_a_row_of_no_iteration_tells_of_no_checkpoint() -> None:
    rows = {"evaluation/success_rate": 1.0}, judged(5, 0.5), {"evaluation/success_rate": 1.0, "iteration": "x"}  # fmt: skip
    assert _best(run(*rows), [0, 5, 20]) == 5


@pytest.mark.parametrize(
    ("key", "text", "value"),
    [("episodes", "010", 10), ("episodes", "1e2", 100), ("episodes", "1_000", 1000), ("episodes", "8.0", 8),
     ("seconds", ".5", 0.5), ("seconds", "-0", 0), ("camera", "-90", -90), ("camera", "1e2", 100)],
)  # fmt: skip
def test_numbers_are_what_they_are_read_for(key: str, text: str, value: float) -> None:
    """By YAML's rules 010 episodes were eight, 1:30 seconds ninety, and 1e2 no number."""
    assert _value(key, text) == value
    assert type(_value(key, text)) is type(value)


@pytest.mark.parametrize(
    ("key", "text"),
    [("episodes", t) for t in ("0", "-1", "1.5", "nan", "inf", "0x10", "true", "", "1,5", "[3]")]
    + [("seconds", t) for t in ("1:30", "5s", "0b1", "yes", "", "~", "null")],
)  # fmt: skip
def test_what_is_no_number_is_refused(key: str, text: str) -> None:
    with pytest.raises(ConfigError, match=r"is not possible: it takes a (whole )?number"):
        _value(key, text)
