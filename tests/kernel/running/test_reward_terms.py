"""What each of several reward terms gave is a column of a training's metrics."""

from __future__ import annotations

from pathlib import Path

import pytest
from worlds import PADDLE_TASK, SMALL, make_training

from understudy.errors import ConfigError
from understudy.setup.plugins import Plugins

TWO = ("reward.terms.low.weight=0.5", "+reward.terms.again={name: test/low, weight: 2.0}")


@pytest.mark.parametrize("combine", ["sum", "product"])
def test_each_term_has_its_column(plugins: Plugins, tmp_path: Path, combine: str) -> None:
    words = [*PADDLE_TASK, *SMALL, *TWO, f"reward.combine={combine}"]
    training = make_training(plugins, words, tmp_path / "run")
    (row,) = [training.iterate()]
    assert {n for n in row if n.startswith("reward")} == {"reward", "reward/low", "reward/again"}
    if combine == "sum":
        assert row["reward/low"] + row["reward/again"] == pytest.approx(row["reward"], rel=1e-5)
        assert row["reward/again"] == pytest.approx(4.0 * row["reward/low"], rel=1e-5)
    training.close()


def test_one_term_is_the_reward(plugins: Plugins, tmp_path: Path) -> None:
    training = make_training(plugins, [*PADDLE_TASK, *SMALL], tmp_path / "run")
    assert {n for n in training.iterate() if n.startswith("reward")} == {"reward"}
    training.close()


@pytest.mark.parametrize("combine", ["sum", "product"])
def test_rewards_of_no_weight_are_refused(plugins: Plugins, tmp_path: Path, combine: str) -> None:
    """A sum is 0 then and a product 1, whatever happens: nothing was learned, and nothing said so."""
    words = [*PADDLE_TASK, *SMALL, *TWO, f"reward.combine={combine}", "reward.terms.low.weight=0"]
    with pytest.raises(ConfigError, match=r"weight=0 \(reward\.terms\.low, reward\.terms\.again\)"):
        make_training(plugins, [*words, "reward.terms.again.weight=0"], tmp_path / "none")
    assert not (tmp_path / "none").exists()
    make_training(plugins, words, tmp_path / "one").close()
