"""The toy jump: its physics, and a whole search of it from the command line to its gallery."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from deaths import die_after

from understudy.command.cli import main
from understudy.running.training import Training
from understudy.setup.composition import load_experiment
from understudy.testing import check_environment, check_simulator
from understudy_diversity.peaks import figure
from understudy_reinforcement.job import Reinforcement
from understudy_report.pictures import png

QUICK = (
    "search=diversity/vault",
    "budget.samples=2048",
    "evaluation.episodes=4",
    "evaluation.final_episodes=4",
    "run.video_seconds=0.5",
    "outer_loop.trials=4",
    "outer_loop.explore=1",
    "outer_loop.exploit=1",
    "outer_loop.success=0.0",
    "checkpoint.minutes=0",
)


def job(*overrides: str) -> Reinforcement:
    overrides = ("experiment=diversity/vault", "num_worlds=4", *overrides)
    made = Training(load_experiment([*overrides])).prepare().job
    assert isinstance(made, Reinforcement)
    return made


def test_it_conforms() -> None:
    environment = job().environment
    check_environment(environment)
    check_simulator(environment.parts.simulator, 4)


def flown(push: float, tuck: float, **takeoff: float) -> tuple[float, float]:
    """Pitch and height at the bar with the same action throughout."""
    given = [f"initial_states.{name}={value}" for name, value in takeoff.items()]
    environment = job("initial_states.noise=0.0", *given).environment
    action = torch.tensor([[tuck, push]]).repeat(4, 1)
    environment.reset()
    for _ in range(16):
        environment.advance(action)
        if environment.table["passed"][0]:
            break
    return float(environment.table["pitch_at_bar"][0]), float(environment.table["height_at_bar"][0])


def test_a_ball_flies_as_the_formula_says() -> None:
    """Upright and unspun, stretched: the height at the bar is the centre's less half a body."""
    pitch, height = flown(0.0, -9.0, spin=0.0, climb=4.0)
    time = 0.35
    centre = 1.0 + 4.0 * time - 0.5 * 9.81 * time**2
    assert pitch == pytest.approx(0.0, abs=1e-6)
    assert height == pytest.approx(centre - 0.85 - 0.12, abs=0.1)


def test_spin_decides_the_strategy() -> None:
    """On the back, upright, head first, over: by the take-off alone; lying it passes higher."""
    back, dive = flown(0.0, -9.0, spin=-4.5), flown(0.0, -9.0, spin=4.5)
    upright, over = flown(0.0, -9.0, spin=0.0), flown(0.0, 9.0, spin=6.0)
    assert back[0] == pytest.approx(-dive[0], abs=1e-5)
    assert dive[0] == pytest.approx(math.pi / 2, abs=0.25)
    assert over[0] > dive[0] + 1.5
    assert min(back[1], dive[1]) > upright[1] + 0.5


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("search") / "s"
    assert main(["sweep", *QUICK, f"run.dir={folder}"]) == 0
    return folder


def asked(folder: Path) -> list[dict[str, object]]:
    rows = [json.loads(line) for line in (folder / "journal.jsonl").read_text().splitlines()]
    return [row["trial"] for row in rows if row["event"] == "asked"]


def test_the_gallery_needs_nothing_else(whole: Path) -> None:
    page = (whole / "gallery.html").read_text()
    summary = json.loads((whole / "summary.json").read_text())
    strategies = {row["strategy"] for row in summary} - {None}
    assert page.count('<article class="card exhibit"') == len(strategies) > 0
    assert page.count("data:video/mp4;base64,") == len(strategies)
    assert f"{len(strategies)} different strateg" in page
    loaded = re.findall(r'(?:src|href|poster)="([^"]{0,40})', page)
    assert loaded
    assert all(address.startswith("data:") for address in loaded)
    assert "default-src 'none'" in page


def test_a_finished_search_makes_its_gallery_anew(
    whole: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    films = {f: f.stat().st_mtime_ns for f in (whole / "gallery").glob("*.mp4")}
    (whole / "gallery.html").unlink()
    assert main(["sweep", *QUICK, f"run.dir={whole}"]) == 0
    assert f"page: {whole / 'gallery.html'}" in capsys.readouterr().out
    assert {f: f.stat().st_mtime_ns for f in (whole / "gallery").glob("*.mp4")} == films


def test_killed_and_started_again(whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "s"
    die_after(5, folder, *QUICK)
    assert main(["sweep", *QUICK, f"run.dir={folder}"]) == 0
    assert asked(folder) == asked(whole)


def test_novel_policies_of_the_search(whole: Path, tmp_path: Path) -> None:
    quick = [o for o in QUICK[1:6] if "trials" not in o]
    folder = tmp_path / "n"
    stage = ["search=diversity/vault_novel", f"outer_loop.search={whole}", "outer_loop.rounds=1"]
    stage += ["outer_loop.success=0.0", f"run.dir={folder}"]
    assert main(["sweep", *stage, *quick]) == 0
    for trial in asked(folder):
        config = json.loads((folder / str(trial["key"]) / "run.json").read_text())["config"]
        assert config["reward"]["terms"]["novelty"]["found"]
        assert config["start"]["run"].startswith(str(whole))
    page = (folder / "gallery.html").read_text()
    assert "of them new" in page
    own = len(asked(folder))
    repeated, failed = map(int, re.search(r"(\d+) repeated one, (\d+) failed", page).groups())  # type: ignore[union-attr]
    novel, trials = map(int, re.search(r"(\d+) of them new in (\d+) trials", page).groups())  # type: ignore[union-attr]
    assert trials == own == novel + repeated + failed, "not those of the search before"


def test_other_sweeps_have_no_gallery(tmp_path: Path) -> None:
    quick = ["budget.samples=1024", "evaluation.episodes=4", "evaluation.final_episodes=4"]
    more = ["outer_loop=grid", "outer_loop.variants={a: []}", "outer_loop.seeds=[0]"]
    sweep = ["experiment=diversity/vault", "executor=in_process", *quick, *more]
    assert main(["sweep", *sweep, f"run.dir={tmp_path}"]) == 0
    assert not (tmp_path / "gallery.html").exists()


def test_pictures() -> None:
    frame = np.zeros((2, 3, 3), np.uint8)
    assert png(frame)[:8] == b"\x89PNG\r\n\x1a\n"
    outline = np.array([[[0.0, 0, 0], [1, 0, 0]], [[0, 1, 0], [0, 1, 1]]])
    assert figure(outline, 30.0).count("<path") == 4
    assert figure(None, 30.0) == ""


def test_a_feature_that_no_trial_measures_is_refused_before_the_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    features = "outer_loop.features={pich: {low: -5.5, high: 5.5}}"
    assert main(["sweep", *QUICK, features, f"run.dir={tmp_path / 'search'}"]) == 2
    assert "needs the measure 'pich'" in (said := capsys.readouterr().err)
    assert "Did you mean 'pitch'?" in said
    assert not list(tmp_path.glob("search/trial*"))
