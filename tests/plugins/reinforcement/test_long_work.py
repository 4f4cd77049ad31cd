"""Work without rows of its own tells how far it is, once it takes long: evaluations, and iterations of jobs that gather."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from worlds import SMALL, make_training

from understudy.setup.plugins import Plugins
from understudy.testing.fake import FAKE_TASK
from understudy_reinforcement import long_work
from understudy_reinforcement.long_work import LongWork
from understudy_skills.gathered import Gathered

Pace = Callable[[float], None]


@pytest.fixture
def pace(monkeypatch: pytest.MonkeyPatch) -> Pace:
    """Whenever somebody asks for the time, so many seconds have gone by."""
    now = [0.0]
    step = [0.0]

    def monotonic() -> float:
        now[0] += step[0]
        return now[0]

    def goes(seconds: float) -> None:
        step[0] = seconds

    monkeypatch.setattr(long_work, "time", SimpleNamespace(monotonic=monotonic))
    return goes


def test_what_is_told_of_an_hour(monkeypatch: pytest.MonkeyPatch) -> None:
    now, said = [0.0], list[tuple[float, str]]()
    monkeypatch.setattr(long_work, "time", SimpleNamespace(monotonic=lambda: now[0]))
    work = LongWork("Judging", say=lambda text: said.append((now[0], text)))
    for second in range(3600):
        now[0] = float(second)
        work.done(second / 3600)
    assert said[0] == (10.0, "Judging: 0 % done, about 60 min left.")
    assert 1800 < said[-1][0] < 3600
    assert len(said) < 30, "now and then, and less and less often"
    for at, text in said:  # each is right
        assert (
            f"about {(3600 - at) / 60:.0f} min left" in text or f"about {3600 - at:.0f} s" in text
        )


def test_of_quick_work_nothing_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    work = LongWork("Judging")
    for step in range(100):
        work.done(step / 100)
    assert capsys.readouterr().err == ""


def test_the_first_part_which_compiled_tells_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(long_work, "time", SimpleNamespace(monotonic=lambda: now[0]))
    work = LongWork("Judging")
    now[0] = 300.0
    assert work.left(0.01) == ""
    now[0] = 301.0
    assert work.left(0.02) == ", about 98 s left"


@pytest.mark.parametrize("episodes", [8, 20])
def test_a_long_evaluation_tells_how_far_it_is(
    plugins: Plugins, pace: Pace, capsys: pytest.CaptureFixture[str], episodes: int
) -> None:
    """Also in batches, of which the worlds are too few to have all episodes at once."""
    training = make_training(
        plugins,
        [
            *FAKE_TASK,
            *SMALL,
            "evaluation.episodes=8",
            f"evaluation.final_episodes={episodes}",
            "evaluation.seconds=4",
        ],
    )
    quick, _ = training.judge()
    assert "Judging" not in capsys.readouterr().err
    pace(4.0)
    slow, _ = training.judge()
    assert slow == quick
    told = re.findall(rf"Judging {episodes} episodes: (\d+) % done(.*)\.", capsys.readouterr().err)
    shares = [int(share) for share, _ in told]
    assert len(shares) > 1
    assert shares == sorted(shares)
    assert shares[-1] < 100
    assert all("left" in left for _, left in told[1:])


def test_states_that_are_gathered_tell_the_time_left(pace: Pace) -> None:
    gathered = Gathered(100)
    assert gathered.stage() == "0 of 100 states"
    pace(20.0)
    gathered.add({"qpos": torch.zeros(10, 1)})
    assert gathered.stage() == "10 of 100 states, about 3 min left"


@pytest.mark.parametrize(
    ("job", "told"),
    [
        ("harvest, ending: any, count: 40, decisions: 40", "40 decisions of 16 worlds"),
        ("settle, count: 40", "Settling 16 worlds"),
        ("judge", "Judging 8 episodes"),
    ],
)
def test_jobs_without_trainings(
    plugins: Plugins,
    tmp_path: Path,
    pace: Pace,
    capsys: pytest.CaptureFixture[str],
    job: str,
    told: str,
) -> None:
    few = [*FAKE_TASK, *SMALL, "evaluation.final_episodes=8", "budget.samples=100000"]
    few += ["evaluation.seconds=4"]
    make_training(plugins, few, tmp_path / "a").save()
    of = "" if job.startswith("settle") else f", run: {tmp_path / 'a'}"
    training = make_training(plugins, [*few, f"+job={{name: {job}{of}}}"], tmp_path / "b")
    pace(40.0)
    training.train()
    training.judge()
    assert re.search(rf"{told}: \d+ % done, about .* left\.", capsys.readouterr().err)
