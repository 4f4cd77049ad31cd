"""The space of a search: ranges, scales, whole numbers, and what is refused."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from understudy_bayes.fidelity import Fidelity
from understudy_bayes.space import Parameter, Space, check_paths
from understudy_sweeps.loops import Trial

RATE = Parameter(1e-5, 1e-1, "log")
EPOCHS = Parameter(1, 10, integer=True)
CLIP = Parameter(0.02, 0.2)
BATCH = Parameter(64, 512, "log", integer=True)


def test_a_log_scale_has_equal_ratios() -> None:
    assert [RATE.value(u) for u in (0, 0.25, 0.5, 1)] == [1e-5, 1e-4, 1e-3, 1e-1]
    assert RATE.unit(1e-3) == pytest.approx(0.5)


def test_whole_numbers_are_what_an_integer_option_takes() -> None:
    values = [EPOCHS.value(u) for u in (0, 0.49, 0.5, 0.51, 1)]
    assert values == [1, 5, 6, 6, 10]
    assert all(isinstance(value, int) for value in values)


@given(st.sampled_from([RATE, EPOCHS, CLIP]), st.floats(-0.5, 1.5))
def test_a_point_read_back_is_the_same_point(parameter: Parameter, u: float) -> None:
    """What a journal holds gives the loop the same place as before."""
    value = parameter.value(u)
    assert parameter.low <= value <= parameter.high
    assert parameter.value(parameter.unit(value)) == value
    assert float(repr(value)) == value


@given(st.sampled_from([RATE, CLIP]), st.floats(0, 1))
def test_rounding_moves_nothing_noticeable(parameter: Parameter, u: float) -> None:
    assert parameter.unit(parameter.value(u)) == pytest.approx(u, abs=1e-4)


def test_a_point_names_its_options() -> None:
    space = Space({"learner.clip": CLIP, "learner.epochs": EPOCHS})
    assert space.point([0.5, 1.0]) == {"learner.clip": 0.11, "learner.epochs": 10}
    assert space.unit({"learner.epochs": 1, "learner.clip": 0.2, "budget.samples": 9}) == [1, 0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((1.0, 1.0), "low=1 is not possible: it must be less than high=1"),
        ((2.0, 1.0), "low=2"),
        ((math.nan, 1.0), "low=nan"),
        ((0.0, 1.0, "log"), "low=0 is not possible: it must be greater than 0 on a log scale"),
        ((-1.0, 1.0, "log"), "log scale"),
        ((0.5, 4.0, "linear", True), "give whole numbers"),
    ],
)
def test_impossible_ranges_are_refused(arguments: tuple, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Parameter(*arguments)


@pytest.mark.parametrize("name", ["", "a b", "a=1", "a.b,c", "~a", "a..b", "a.b=x.c"])
def test_what_is_no_option_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="which is no option"):
        check_paths({name: CLIP})


def test_a_difficulty_lies_between_0_and_1() -> None:
    with pytest.raises(ValueError, match=r"high=2 is not possible.*\[0, 1\]"):
        Fidelity(high=2)
    with pytest.raises(ValueError, match="less than high"):
        Fidelity(low=1, high=0)


def test_iterations_as_fidelity() -> None:
    """N(z) = 500 + 6500 z iterations of 4096 samples (section 6.4.2), on the task as it is."""
    fidelity = Fidelity("budget.samples", 500 * 4096, 7000 * 4096, integer=True)
    point, difficulty = fidelity.place(0.5)
    assert (point, difficulty) == ({"budget.samples": 3750 * 4096}, None)
    assert fidelity.z(Trial("a", point=point)) == pytest.approx(0.5)
    assert fidelity.place(1.0)[0] == {"budget.samples": 7000 * 4096}


@given(st.floats(0, 1), st.floats(0, 0.4), st.floats(0.5, 1))
def test_a_fidelity_read_back_is_the_same(z: float, low: float, high: float) -> None:
    fidelity = Fidelity(low=low, high=high)
    _, difficulty = fidelity.place(z)
    again = fidelity.z(Trial("a", fidelity=difficulty))
    assert again == pytest.approx(z, abs=1e-4)
    assert 0 <= (difficulty or 0) <= 1


def test_between_two_whole_numbers_there_is_nothing() -> None:
    """What is trained is what the model is asked about; the ascent does not notice the steps."""
    space = Space({"a": Parameter(1, 3, integer=True), "b": Parameter(0, 2), "c": BATCH})
    x = torch.tensor([[0.6, 0.6, 0.3], [0.8, 0.2, 1.0]], dtype=torch.double, requires_grad=True)
    rounded = space.rounded(x)
    assert rounded[:, :2].tolist() == [[0.5, 0.6], [1.0, 0.2]]
    assert [space.point(row) for row in rounded.tolist()] == [
        space.point(row) for row in x.tolist()
    ]
    (gradient,) = torch.autograd.grad((rounded * 3).sum(), x)
    assert gradient.tolist() == [[3.0] * 3] * 2
    assert Space({"b": Parameter(0, 2)}).rounded(x) is x


def test_a_whole_fidelity_ends_at_whole_numbers() -> None:
    """The trial that counts was at 2000 of 2000.5, so no trial counted."""
    with pytest.raises(ValueError, match=r"integer=true is not possible with low=200\.5"):
        Fidelity("budget.samples", low=200.5, high=2000.5, integer=True)
