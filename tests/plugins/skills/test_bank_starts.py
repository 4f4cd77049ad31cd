"""Episodes that begin in a bank; what does not fit is refused in one sentence."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor

from understudy.errors import ConfigError, FileError
from understudy.running.environment import Environment
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy.testing.fake import FAKE_TASK
from understudy_skills import bank

STATES = {
    "qpos": torch.tensor([[0.5], [1.5], [-1.0]]),
    "qvel": torch.tensor([[1.0], [2.0], [3.0]]),
    "hat": torch.tensor([5.0, 6.0, 7.0]),
}


def made(
    plugins: Plugins, states: dict[str, Tensor], path: Path, *more: str, evaluating: bool = False
) -> Environment:
    bank.save(path / "some", states, {})
    own = f"++initial_states={{name: bank, file: {path / 'some'}}}"
    overrides = [*FAKE_TASK[:-1], own, "num_worlds=64", *more]
    experiment = load_experiment(overrides, plugins)
    return build_environment(experiment, evaluating=evaluating).environment


def begun(environment: Environment) -> Tensor:
    """qpos, qvel and hat (N, 3) in which episodes begin."""
    environment.reset(seed=1)
    table = environment.table
    return torch.cat([table["qpos"], table["qvel"], table["hat"].unsqueeze(1)], dim=1)


@pytest.mark.parametrize("evaluating", [False, True])
def test_states_are_drawn_whole_and_one_of_five_by_evaluations_alone(
    plugins: Plugins, tmp_path: Path, *, evaluating: bool
) -> None:
    ten = {name: torch.cat([state] * 4)[:10] for name, state in STATES.items()}
    ten["qvel"] = torch.arange(10.0).unsqueeze(1)
    environment = made(plugins, ten, tmp_path, evaluating=evaluating)
    drawn = begun(environment)
    rows = {tuple(row) for row in drawn.tolist()}
    kept = {0, 5} if evaluating else {1, 2, 3, 4, 6, 7, 8, 9}
    assert rows == {
        (ten["qpos"][i].item(), ten["qvel"][i].item(), ten["hat"][i].item()) for i in kept
    }
    environment.step(torch.ones(64, 1))
    assert torch.equal(environment.table["hat"], drawn[:, 2]), "constant over the episode"


def test_a_single_state_is_for_both(plugins: Plugins, tmp_path: Path) -> None:
    one = {name: state[:1] for name, state in STATES.items()}
    for evaluating in (False, True):
        drawn = begun(made(plugins, one, tmp_path, evaluating=evaluating))
        assert torch.equal(drawn, torch.tensor([[0.5, 1.0, 5.0]]).expand(64, 3))


def test_banks_are_drawn_from_as_often_as_one_another(plugins: Plugins, tmp_path: Path) -> None:
    other = {name: value[:1] + 10.0 for name, value in STATES.items()}
    bank.save(tmp_path / "other", other, {})
    beside = f"initial_states.beside=['{tmp_path / 'other'}']"
    environment = made(plugins, STATES, tmp_path, beside, "num_worlds=2000")
    environment.reset(seed=1)
    drawn = environment.table["qpos"].squeeze(1)
    assert (drawn == 10.5).float().mean() == pytest.approx(0.5, abs=0.05)
    for value in (1.5, -1.0):  # the first is for evaluations
        assert (drawn == value).float().mean() == pytest.approx(1 / 4, abs=0.04)
    bank.save(tmp_path / "other", {**other, "hat": torch.zeros(1, 2)}, {})
    with pytest.raises(ConfigError, match="do not have the same fields"):
        made(plugins, STATES, tmp_path, beside)


def test_fields_may_be_left(plugins: Plugins, tmp_path: Path) -> None:
    environment = made(plugins, STATES, tmp_path, "initial_states.leave=[hat]")
    environment.reset()
    assert "hat" not in environment.table.shapes


def test_what_is_left_has_to_be_there(plugins: Plugins, tmp_path: Path) -> None:
    """A word mistyped would have left nothing, and nobody would know."""
    match = r"^initial_states\.leave names 'hats', which the bank .*some has not got\. Did you mean 'hat'\?$"
    with pytest.raises(ConfigError, match=match):
        made(plugins, STATES, tmp_path, "initial_states.leave=[hats]")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"qvel": None}, "'qvel' is missing there and"),
        ({"qpos": torch.zeros(3, 2)}, r"'qpos' is \(2,\) there and \(1,\) here"),
        ({"action": torch.zeros(3, 1)}, "provides the field 'action'"),
    ],
)
def test_what_does_not_fit_is_refused(
    plugins: Plugins, tmp_path: Path, change: dict[str, Tensor | None], sentence: str
) -> None:
    states = {k: v for k, v in {**STATES, **change}.items() if v is not None}
    with pytest.raises(ConfigError, match=sentence):
        made(plugins, states, tmp_path)


def test_a_missing_bank_is_named(plugins: Plugins, tmp_path: Path) -> None:
    own = f"++initial_states={{name: bank, file: {tmp_path / 'none'}}}"
    with pytest.raises(FileError, match="cannot be used"):
        build_environment(load_experiment([*FAKE_TASK[:-1], own], plugins))


@pytest.mark.parametrize("dtype", [torch.int64, torch.int32, torch.bool])
def test_states_of_another_kind_of_number_are_refused(
    plugins: Plugins, tmp_path: Path, dtype: torch.dtype
) -> None:
    """Positions that were cut to whole numbers, or to 0 and 1, were begun in without a word."""
    states = {**STATES, "qpos": STATES["qpos"].to(dtype)}
    with pytest.raises(ConfigError, match=f"'qpos' is {dtype} there and torch.float32 here"):
        made(plugins, states, tmp_path)
    made(plugins, {**STATES, "qpos": STATES["qpos"].double()}, tmp_path)
    made(plugins, {**STATES, "hat": STATES["hat"].to(dtype)}, tmp_path)
