"""The gallery of a search over grips: a card for each style, however far it is; forces as they act."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import forked

from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy_chopsticks import gallery
from understudy_chopsticks.found import grip_file
from understudy_chopsticks.search import GripSearch
from understudy_gripping.grip import Grip, load_grip, standard
from understudy_gripping.hold import hold, placed
from understudy_hand.scene import HandScene
from understudy_hand.table import ARM_POSE
from understudy_sweeps.journal import Journal
from understudy_sweeps.loops import Report

WORDS = ["search=chopsticks/grips", "seed=0"]
STYLES = ["outer_loop.styles=['11120','11200']", "outer_loop.together=2"]


def test_a_search_that_is_not_finished_has_a_card_for_each_style(
    tmp_path: Path, plugins: Plugins, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Grip] = []

    def close_ups(grip: Grip) -> list[np.ndarray]:
        drawn.append(grip)
        return [np.zeros((2, 3, 3), np.uint8)] * 3

    monkeypatch.setattr(gallery, "close_ups", close_ups)
    experiment = load_experiment([*WORDS, *STYLES], plugins)
    options = experiment.need("outer_loop").options
    assert isinstance(options, GripSearch.Options)
    search, journal = GripSearch(options), Journal(tmp_path / "journal.jsonl")
    trial = search.ask(0)
    assert trial is not None
    journal.ask(trial)
    journal.tell(Report(trial.key, "running", 0.1, {"score_s11120": 0.4}, 100.0))
    journal.tell(Report(trial.key, "ok", 0.1, {"score_s11120": 0.5}, 200.0))
    kept = tmp_path / "round0-0" / "inputs" / "0" / "s11120.json"
    kept.parent.mkdir(parents=True)
    shutil.copyfile(standard(), kept)
    path = gallery.Gallery().write(tmp_path, "grips", experiment, journal)
    assert path is not None
    assert path == tmp_path / "gallery.html"
    page = path.read_text()
    assert len(drawn) == 1
    assert page.count("data:image/png") == 3
    assert "2 of 2 styles were tried, 0 of them in all of their 10 evaluations" in page
    assert "1. 11120 standard<b>0.500</b>" in page
    assert "2. 11200 right hand rule<b>no grip held</b>" in page
    assert "0 of 1 candidates held the sticks" in page


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"hinges": ["<b>"], "poses": [[0.0]] * 5, "targets": [[0.0]] * 5}, "names other hinges"),
        ({"robot": "<script>"}, "of another hand: &lt;script&gt;"),
    ],
)
def test_a_card_says_why_it_has_no_pictures(
    changed: dict[str, Any], said: str, tmp_path: Path
) -> None:
    """One file that is no grip of the hand takes none of the other cards with it, and gets nothing into the page."""
    kept = tmp_path / "round0-0" / "inputs" / "0" / "s11120.json"
    kept.parent.mkdir(parents=True)
    kept.write_text(json.dumps(json.loads(standard().read_text()) | changed))
    row = {"style": "11120", "name": "standard", "rank": 1, "score": 0.5, "held": 1, "evaluations": 1,
           "evaluation": 1, "first": 0.5, "trial": "11120-0", "curve": []}  # fmt: skip
    assert said in gallery._card(row, tmp_path)


def test_the_grip_of_a_job_that_was_asked_once_more_is_the_later_ones(tmp_path: Path) -> None:
    for name in ("round0-0", "round0-0-again", "round1-0"):
        kept = tmp_path / name / "inputs" / "0"
        kept.mkdir(parents=True)
        (kept / "s11120.json").touch()
    found = grip_file(tmp_path, {"trial": "11120-0"})
    assert found is not None
    assert found.parts[-4] == "round0-0-again"


def test_it_says_nothing_of_other_sweeps_without_the_libraries_of_searches(tmp_path: Path) -> None:
    """It is asked about every sweep, which may well be made without them."""
    code = (
        "import sys; assert not {'botorch', 'gpytorch', 'understudy_chopsticks.gallery'} & {*sys.modules}\n"
        "sys.modules.update(botorch=None, gpytorch=None)\n"
        "from understudy.setup.plugins import installed\n"
        "installed().registry.find('sweep_page', 'chopsticks/gallery').factory()"
    )
    done = forked(code, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


def test_another_search_has_no_gallery_of_grips(tmp_path: Path, plugins: Plugins) -> None:
    experiment = load_experiment(["search=chopsticks/places_boca"], plugins)
    assert gallery.Gallery().write(tmp_path, "x", experiment, Journal(tmp_path / "j")) is None


def test_arrows_are_the_forces_that_bear_both_sticks() -> None:
    scene, grip = HandScene(HandScene.Options()), load_grip(standard())
    data = placed(scene, np.array(ARM_POSE), grip.poses[0], grip.upper[0], grip.lower)
    hold(scene, data, np.array([*ARM_POSE, *grip.targets[0]]), 1.0)
    arrows = gallery._forces(scene, data)
    assert len(arrows) >= 5
    total = sum((end - begin for begin, end in arrows), np.zeros(3)) / gallery._PER_NEWTON
    weight = 9.81 * sum(scene.model.body(name).mass[0] for name in scene.tool_bodies)
    np.testing.assert_allclose(total, [0, 0, weight], atol=0.1)
