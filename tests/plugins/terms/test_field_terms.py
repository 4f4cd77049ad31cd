from __future__ import annotations

import math
from typing import Any

import pytest
import torch

from understudy.errors import ConfigError
from understudy.running.environment import Environment
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.task import Context
from understudy_terms.terms import OutOfBounds, beyond, reached, small, steady, value, value_where

VECTOR = torch.tensor([[1.0, 2.0], [3.0, 0.5]])
NUMBER = torch.tensor([1.0, 3.0])


def test_value_is_the_field_or_one_of_its_numbers() -> None:
    assert value(NUMBER).tolist() == [1.0, 3.0]
    assert value(VECTOR, index=1).tolist() == [2.0, 0.5]
    assert value(NUMBER > 2).tolist() == [0.0, 1.0]


def test_a_value_where_another_field_is_zero_is_none() -> None:
    where = torch.tensor([0.0, 1.0])
    found = value_where(NUMBER, where)
    assert found[0].isnan()
    assert found[1] == 3.0
    assert value_where(VECTOR, where > 0, index=1).nan_to_num(-1.0).tolist() == [-1.0, 0.5]


def test_steady_is_one_where_nothing_changes_and_falls_with_the_mean_square() -> None:
    before = torch.tensor([[1.0, 2.0], [2.0, 0.5]])
    found = steady(VECTOR, before, scale=3.0)
    assert found.tolist() == pytest.approx([1.0, math.exp(-3.0 * 0.5)])
    assert steady(NUMBER, NUMBER - 0.5, scale=4.0).tolist() == pytest.approx([math.exp(-1.0)] * 2)


def test_steady_takes_a_field_however_it_lies_in_memory() -> None:
    field = torch.arange(12.0).view(3, 2, 2).permute(1, 0, 2)
    assert steady(field, field, scale=3.0).tolist() == [1.0, 1.0]


def test_small_is_one_at_zero_and_falls_with_the_size() -> None:
    assert small(torch.tensor([0.0, -2.0]), scale=0.5).tolist() == pytest.approx([1, math.exp(-1)])
    found = small(torch.tensor([[3.0, 4.0], [0.0, 1.0]]), scale=0.1)
    assert found.tolist() == pytest.approx([math.exp(-0.5), math.exp(-0.1)])


def test_thresholds() -> None:
    assert reached(NUMBER, within=1.0).tolist() == [True, False]
    assert reached(VECTOR, within=2.0).tolist() == [True, False]
    assert reached(VECTOR, within=1.0, index=1).tolist() == [False, True]
    assert beyond(NUMBER, limit=3.0).tolist() == [False, True]
    assert beyond(VECTOR, limit=2.0).tolist() == [True, True]
    assert beyond(VECTOR, limit=2.0, index=0).tolist() == [False, True]


def observing(*words: str) -> Environment:
    experiment = ["experiment=miniature/go", "device=cpu", "num_worlds=3", *words]
    return build_environment(
        load_experiment([*experiment, "policy.observation=[extra]"])
    ).environment


@pytest.mark.parametrize(("field", "shape"), [("position", [2]), ("episode_time", [])])
def test_any_field_is_observed_as_it_is(field: str, shape: list[int]) -> None:
    given = f"encoder.extra={{name: value, reads: {{value: {field}}}, shape: {shape}}}"
    environment = observing(given)
    environment.reset(seed=0)
    found = environment.advance(torch.ones(3, environment.action_size)).observations["extra"]
    assert found.tolist() == environment.table[field].reshape(3, -1).tolist()
    environment.close()


def test_a_vector_observed_without_its_shape_is_refused() -> None:
    environment = observing("encoder.extra={name: value, reads: {value: position}}")
    with pytest.raises(ConfigError, match=r"extra.*\(3, 2\).*\(3, 1\)"):
        environment.reset(seed=0)
    environment.close()


def test_bounds_change_with_time_and_stay_beyond_their_points() -> None:
    options = OutOfBounds.Options(least=((1.0, 0.0), (3.0, 2.0)), most=((0.0, 5.0),))
    term = OutOfBounds(
        options,
        Context(seed=0, device=torch.device("cpu"), num_worlds=1, control_dt=0.1, substeps=1),
    )

    def out(value: float, time: float) -> bool:
        return bool(term(torch.tensor([value]), torch.tensor([time])))

    for time, least in ((0.0, 0.0), (1.0, 0.0), (2.0, 1.0), (2.5, 1.5), (3.0, 2.0), (9.0, 2.0)):
        assert out(least - 0.01, time)
        assert not out(least + 0.01, time)
        assert out(5.01, time)
    several = term(torch.tensor([0.5, 0.5, 9.0]), torch.tensor([0.0, 2.0, 0.0]))
    assert several.tolist() == [False, True, True]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({}, "neither least nor most"),
        ({"least": ((1.0, 0.0), (1.0, 2.0))}, "later"),
        ({"most": ((math.nan, 0.0),)}, "not finite"),
    ],
)
def test_bounds_that_make_no_sense_are_refused(options: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        OutOfBounds.Options(**options)
