"""Beside the policy that plays: the run's checkpoints on a slider, and its curves."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from understudy.command.cli import main
from understudy.records import checkpoint
from understudy_play.player import Player
from understudy_skills.skill import open_skill

pytest.importorskip("viser", reason="viser is not installed (the extra 'view')")

from understudy_play.following import Following, curves
from understudy_play.page import Page
from understudy_viewer.page import free_port


def keep(run: Path, iteration: int, scale: float) -> None:
    """A checkpoint whose weights are those of the first, times `scale`."""
    state, meta = checkpoint.load(run / "checkpoints" / "00000001")
    policy = {k: v * scale if v.is_floating_point() else v for k, v in state["policy"].items()}
    progress = {**state["progress"], "samples": 1000 * iteration}
    checkpoint.save(
        run / "checkpoints" / f"{iteration:08d}", {"policy": policy, "progress": progress}, meta
    )


def learn(run: Path, rows: int) -> None:
    text = [
        {"iteration": i, "samples": 100 * i, "reward": 0.1 * i, "reward/seat": 0.2, "reward/still": i,
         "episode/ended_by/fall": 1.0 / (i + 1)} for i in range(rows)
    ]  # fmt: skip
    (run / "metrics.jsonl").write_text("\n".join(map(json.dumps, text)) + "\n")


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = tmp_path_factory.mktemp("sit") / "run"
    assert main(["play", "sitting/sit", "--unpack", str(run)]) == 0
    return run


@pytest.fixture
def run(unpacked: Path, tmp_path: Path) -> Path:
    return shutil.copytree(unpacked, tmp_path / "run")


@pytest.fixture
def page(run: Path) -> Iterator[Page]:
    keep(run, 2, 0.5)
    learn(run, 3)
    player = Player(open_skill(str(run)))
    page = Page(
        player, "127.0.0.1", free_port("127.0.0.1", 0), Following(player, str(run), growing=True)
    )
    yield page
    page.close()


def weights(page: Page) -> torch.Tensor:
    return torch.cat([p.detach().flatten() for p in page._player.policy.actor_parameters()])  # type: ignore[attr-defined]


def test_each_checkpoint_can_be_played(page: Page) -> None:
    following = page._following
    assert following is not None
    newest = weights(page).clone()
    assert (following._slider.value, following._slider.max) == (1, 1)
    following.choose(0)
    page.advance()
    torch.testing.assert_close(0.5 * weights(page), newest)
    assert "after iteration 1:" in following._told.content
    following.choose(1)
    page.advance()
    torch.testing.assert_close(weights(page), newest)
    assert "iteration 2, the newest: 2,000 samples" in following._told.content


def test_a_training_that_goes_on_is_followed(page: Page, run: Path) -> None:
    following = page._following
    assert following is not None
    keep(run, 3, 2.0)
    learn(run, 5)
    following._due = 0.0
    page.advance()
    assert (following._slider.value, following._slider.max) == (2, 2)
    assert "iteration 3, the newest" in following._told.content
    names, handle = following._charts["reward"]
    assert names == ("reward", "reward/seat", "reward/still")
    np.testing.assert_allclose(handle.data[1], [0.0, 0.1, 0.2, 0.3, 0.4])
    assert handle.scales["x"]["time"] is False, "samples are no dates"
    following.choose(0)
    page.advance()
    keep(run, 4, 3.0)
    following._due = 0.0
    page.advance()
    assert following._slider.value == 0, "what the visitor chose stays"


def test_a_checkpoint_that_is_damaged_or_gone_leaves_what_plays(page: Page, run: Path) -> None:
    following, before = page._following, weights(page).clone()
    assert following is not None
    keep(run, 3, 2.0)
    file = run / "checkpoints" / "00000003.safetensors"
    file.write_bytes(file.read_bytes()[:-8])
    following._due = 0.0
    page.advance()
    torch.testing.assert_close(weights(page), before)
    assert "00000003" in following._told.content
    for left in (run / "checkpoints").iterdir():
        left.unlink()
    following._due = 0.0
    page.advance()
    torch.testing.assert_close(weights(page), before)


def test_what_a_damaged_checkpoint_says_is_no_part_of_the_page(page: Page, run: Path) -> None:
    following, file = page._following, run / "checkpoints" / "00000003.json"
    assert following is not None
    keep(run, 3, 2.0)
    content = checkpoint.read_sealed(file) | {"format": "<img src=x onerror=alert(1)>"}
    file.write_bytes(checkpoint._sealed(content))
    following._due = 0.0
    page.advance()
    assert "00000003" in following._told.content
    assert "&lt;img src=x" in following._told.content
    assert "<img" not in following._told.content


def test_curves_have_what_rows_have() -> None:
    rows = [{"samples": 1, "reward": 1.0}, {"samples": 2, "reward/a": 3.0}, {"reward": 4.0}, {}]
    names, (x, *ys) = curves(rows, ("reward",))
    assert names == ("reward", "reward/a")
    np.testing.assert_array_equal(x, [1, 2])
    np.testing.assert_array_equal(ys, [[1, np.nan], [np.nan, 3]])
    many = [{"samples": i, "reward": "damaged" if i == 7 else i} for i in range(5000)]
    _, (x, _) = curves(many, ("reward",))
    assert (len(x), x[0], x[-1]) == (400, 0, 4999)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("spacetime/walk", "--follow"), "--follow takes the folder of a run"),
        (("spacetime/walk", "--follow", "--video", "x.mp4"), "Leave out --video"),
    ],
)
def test_what_cannot_be_followed(
    words: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["play", *words]) == 2
    assert said in capsys.readouterr().err
