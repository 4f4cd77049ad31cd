"""The progress line: share of the budget, time left, and a line now and then."""

from __future__ import annotations

import io
import os
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from report_runs import make_run
from rich.console import Console

from understudy_report import progress
from understudy_report.by_term import ByTerm
from understudy_report.progress import Lines, LiveLine, ProgressLine, clock, ending, share


@pytest.mark.parametrize(
    ("budget", "expected"),
    [
        ({"samples": 1000, "minutes": None}, (0.25, 15.0)),  # at 50/s; the first 50 took 6 s
        ({"samples": 1000, "minutes": 1.0 / 3}, (0.5, 10.0)),  # the nearer end counts
        ({"samples": 1000, "minutes": 1.0}, (0.25, 15.0)),
        ({"samples": None, "minutes": None}, (0.0, None)),
        ({"samples": 100, "minutes": None}, (1.0, 0.0)),
    ],
)
def test_share(budget: dict[str, float | None], expected: tuple[float, float | None]) -> None:
    first = {"samples": 50, "seconds": 6.0}
    assert share(budget, {"samples": 250, "seconds": 10.0}, first) == pytest.approx(expected)


def test_no_time_is_told_from_the_iteration_that_compiled() -> None:
    row = {"samples": 32_768, "seconds": 26.0}  # not "at most 11:00:13 left" of 3.4 minutes
    assert share({"samples": 50_000_000, "minutes": None}, row, row)[1] is None
    assert share({"samples": 50_000_000, "minutes": 5.0}, row, row)[1] == pytest.approx(274.0)


@pytest.mark.parametrize(
    ("criterion", "usual", "left", "words"),
    [
        (
            0.9,
            1000,
            3891.0,
            "until 90 % succeed, usually in 0:15",
        ),  # at the newest speed; not "at most 1:04:51"
        (0.9, 1250, 3891.0, "until 90 % succeed"),  # too early to tell
        (0.9, 200, 30.0, "until 90 % succeed, at most 0:30 left"),  # it takes longer than usual
        (0.9, 1000, 12.0, "until 90 % succeed, at most 0:12 left"),  # the budget ends it before
        (0.9, None, None, "until 90 % succeed"),
        (None, 1250, 30.0, "at most 0:30 left"),
        (None, None, None, ""),
    ],
)
def test_when_it_ends(
    criterion: float | None, usual: int | None, left: float | None, words: str
) -> None:
    config = {"evaluation": {"criterion": criterion}, "budget": {"usual_samples": usual}}
    row = {"samples": 250, "seconds": 10.0, "samples_per_second": 50.0}
    assert ending(config, row, left) == words


@pytest.mark.parametrize("stream", ["full", "broken", "closed"])
def test_a_live_line_that_nobody_reads_ends_nothing(
    stream: str, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a broken pipe Rich ended the program, and sent standard output after it."""
    readable, written = os.pipe()
    os.close(readable)
    if stream == "closed":
        os.close(written)
        lost: Any = None
    else:
        lost = (
            os.fdopen(written, "w") if stream == "broken" else Path("/dev/full").open("w")  # noqa: SIM115
        )
        lost.reconfigure(line_buffering=True)
    monkeypatch.setattr(sys, "stderr", lost)
    line = LiveLine("training")
    line.console.print("hello")
    line.console._force_terminal = True
    line.start()
    assert line.show(0.5, "12 samples")
    line.stop()
    os.write(1, b"printed")
    assert capfd.readouterr().out == "printed"


@pytest.mark.parametrize("terminal", [True, False])
def test_a_live_line_is_for_terminals(terminal: bool) -> None:
    line, written = LiveLine("training"), io.StringIO()
    line.console = Console(file=written, force_terminal=terminal, width=120)
    line.start()
    assert line.show(0.5, "12 samples") == terminal
    line.stop()
    assert ("training" in written.getvalue()) == terminal
    assert ("12 samples" in written.getvalue()) == terminal


def test_the_time_left_goes_by(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is told once holds for minutes, in which nothing else may be told."""
    now, line, written = [100.0], LiveLine("sweep"), io.StringIO()
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: now[0]))
    line.console = Console(file=written, force_terminal=True, width=120)
    line.start()
    line.show(0.5, "1 of 2 done", left=136.0)
    for seconds, said in (
        (0, "about 2:16 left"),
        (100, "about 0:36 left"),
        (137, "longer than before"),
    ):
        now[0] = 100.0 + seconds
        assert line._bar is not None
        written.truncate(0)
        line._bar.refresh()
        assert said in written.getvalue()
    line.stop()


def test_lines_of_a_training_within_a_sweep(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now, said = [0.0], list[str]()
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: now[0]))
    run, lines = make_run(tmp_path / "led"), Lines(said.append)
    run.info["config"]["budget"] = {"samples": 1000, "minutes": None}
    for iteration in range(1, 11):
        now[0] += 10.0
        lines.iteration(run, by_term(iteration, 0.5, 8.0), "stage 2")
    assert len(said) == 2, "none of a short training, and one now and then of a long one"
    assert said[0].startswith("led: iteration 4 · 200 samples")
    assert "stage 2" in said[0]
    assert "at most 0:16 left" in said[0]


def test_clock() -> None:
    assert [clock(s) for s in (0, 61, 3723)] == ["0:00", "1:01", "1:02:03"]


def test_a_line_now_and_then(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = make_run(tmp_path)
    run.info["config"]["budget"] = {"samples": 1000, "minutes": None}
    line = ProgressLine()
    line.started(run)
    row = {"iteration": 3, "samples": 250, "seconds": 10.0, "samples_per_second": 25.0}
    line.iteration(
        run, {"iteration": 1, "samples": 50, "seconds": 2.0, "samples_per_second": 25.0}, ""
    )
    line._printed = 0.0  # some time later
    line.iteration(run, {**row, "episode/return": 2.0, "episode/episode_seconds": 1.5}, "stage 2")
    line.iteration(run, row, "stage 3")  # too soon
    line.finished(run, "budget")
    shown = capsys.readouterr().err
    assert "iteration 3 · 250 samples · 25/s · return 2.0 · episode 1.50 s · stage 2" in shown
    assert "at most 0:30 left" in shown
    assert "stage 3" not in shown


def test_where_the_curves_are_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "my [bold] runs"
    ProgressLine().started(make_run(folder))
    assert f"Curves: tensorboard --logdir '{folder}" in capsys.readouterr().err


#: Of metrics, as a job of reinforcement writes them, with twelve terms.
TERMS = [f"imitation_{i}" for i in range(12)]


def by_term(iteration: int, value: float, episodes: float, **ended: float) -> dict[str, float]:
    base = {"iteration": iteration, "samples": 50 * iteration, "seconds": 1.0 * iteration}
    shares = {f"episode/ended_by/{name}": share for name, share in ended.items()}
    rewards = {f"reward/{name}": value * i for i, name in enumerate(TERMS)}
    rows = {"reward": value, **rewards, "episode/episodes": episodes, "episode/truncated": 0.25}
    return {**base, "samples_per_second": 50.0, **rows, **shares}


def test_what_is_said_by_term() -> None:
    """The newest ten rows count; endings by how many episodes ended in each."""
    terms = ByTerm()
    terms.add(by_term(1, 1000.0, 50.0, fall=1.0, bound=1.0))
    for i in range(2, 11):
        terms.add(by_term(i, 1.0, 0.0, fall=0.0, bound=0.0))
    terms.add(by_term(11, 2.0, 1.0, fall=0.0, bound=1.0))
    terms.add(by_term(12, 2.0, 3.0, fall=1.0, bound=0.0))
    head, *lines = terms.summary(80)
    assert head == "Means of the last 10 iterations:"
    assert max(map(len, lines)) <= 80
    found = " ".join(" ".join(lines).replace("·", " ").split())
    rewards, endings = found.split(" 4 episodes ended by: ")
    expected = " ".join(f"{name} {1.2 * i:.3g}" for i, name in enumerate(TERMS))
    assert rewards == f"reward 1.2: {expected}"
    assert endings == "fall 75 % bound 25 % truncated 25 %"
    assert 3 <= len(lines) <= 6, "twelve terms in a few lines"


def test_of_one_term_and_of_none() -> None:
    one, none = ByTerm(), ByTerm()
    one.add({"iteration": 1, "reward": 0.5, "episode/episodes": 0.0})
    none.add({"iteration": 1, "loss": 0.5})
    assert one.summary(80) == ["The last iteration:", "  reward 0.5"]
    assert none.summary(80) == ByTerm().summary(80) == []


@pytest.mark.parametrize("terminal", [True, False])
def test_terms_below_the_bar_and_at_the_end(terminal: bool, tmp_path: Path) -> None:
    run, line, written = make_run(tmp_path), ProgressLine(), io.StringIO()
    run.info["config"]["budget"] = {"samples": 1000, "minutes": None}
    line._line.console = Console(file=written, force_terminal=terminal, width=100, highlight=False)
    line.started(run)
    line.iteration(run, by_term(1, 0.5, 8.0, fall=0.5), "")
    if terminal:
        assert line._line._bar is not None
        line._line._bar.refresh()
    while_training = written.getvalue()
    assert ("8 episodes ended by: fall 50 % · truncated 25 %" in while_training) == terminal
    line.finished(run, "budget")
    at_the_end = written.getvalue()[len(while_training) :]
    assert "The last iteration:\n  reward 0.5: imitation_0 0 · imitation_1 0.5 · " in at_the_end
    assert "  8 episodes ended by: fall 50 % · truncated 25 %\n" in at_the_end
