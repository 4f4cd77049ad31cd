"""Starts as a Gaussian fits a bank, and the term towards a bank's mean."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from worlds import assert_same_state

from understudy.errors import ConfigError
from understudy.random import WorldStreams
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.task import Context
from understudy_sequencing.gaussian import Gaussian
from understudy_sequencing.terms import NextStart
from understudy_skills import bank

N = 20_000


def context_with() -> Context:
    return build_environment(load_experiment(["experiment=miniature/sleeve"])).context


@pytest.fixture
def ends(tmp_path: Path) -> str:
    drawn = torch.Generator().manual_seed(0)
    states = torch.randn(64, 4, generator=drawn) @ torch.tensor(
        [[0.5, 0.4, 0.0, 0.0], [0.0, 0.2, 0.0, 0.1], [0.0, 0.0, 0.3, 0.0], [0.0, 0.0, 0.0, 0.1]]
    ) + torch.tensor([1.0, -2.0, 0.0, 3.0])
    kept = {
        "positions": states[:, None, :2],
        "velocities": states[:, None, 2:],
        "drag": torch.linspace(0.5, 2.0, 64),
    }
    bank.save(tmp_path / bank.NAME, kept, {})
    return str(tmp_path)


@pytest.mark.parametrize("widening", [1.0, 4.0])
def test_mean_and_covariance_are_the_banks(
    ends: str,
    widening: float,
) -> None:
    context = context_with()
    part = Gaussian(Gaussian.Options(ends, widening), context)
    assert part.varies == ("drag",)
    streams = WorldStreams(3, "test", N, torch.device("cpu"))
    found = part.sample(streams)
    drawn = torch.cat([found["positions"][:, 0], found["velocities"][:, 0]], dim=1)
    kept = bank.load(ends)
    states = torch.cat([kept["positions"][:, 0], kept["velocities"][:, 0]], dim=1)
    wanted = widening * torch.cov(states.T)
    torch.testing.assert_close(drawn.mean(0), states.mean(0), atol=0.04, rtol=0)
    torch.testing.assert_close(torch.cov(drawn.T), wanted, atol=0.02 * widening, rtol=0.05)
    assert found["drag"].unique().numel() == 64, "each of a state that was"
    again = part.sample(WorldStreams(3, "test", N, torch.device("cpu")))
    assert_same_state(found, again)


def test_another_scenes_bank_is_refused(tmp_path: Path) -> None:
    context = context_with()
    for states, sentence in (
        ({"positions": torch.zeros(4, 2, 2), "velocities": torch.zeros(4, 1, 2)}, "does not fit"),
        ({"positions": torch.zeros(4, 1, 2)}, "'velocities' is missing there"),
        ({"positions": torch.zeros(1, 1, 2), "velocities": torch.zeros(1, 1, 2)}, "no spread"),
        (
            {"positions": torch.zeros(10_001, 1, 2), "velocities": torch.zeros(10_001, 1, 2)},
            "at most 10000",
        ),
    ):
        bank.save(tmp_path / bank.NAME, states, {})
        with pytest.raises(ConfigError, match=sentence):
            Gaussian(Gaussian.Options(str(tmp_path)), context)


def test_towards_the_next_ones_mean(ends: str) -> None:
    context = context_with()
    term = NextStart(NextStart.Options(ends, "positions"), context)
    mean = bank.load(ends)["positions"].mean(0)
    found = term(torch.stack([mean, mean + torch.tensor([3.0, 4.0])]))
    torch.testing.assert_close(found, torch.tensor([0.0, -5.0]))
    with pytest.raises(ConfigError, match="has the shape"):
        term(torch.zeros(2, 3))
    with pytest.raises(ConfigError, match="has no 'qpos', but drag, positions, velocities"):
        NextStart(NextStart.Options(ends), context)
