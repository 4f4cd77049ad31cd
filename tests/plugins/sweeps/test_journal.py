"""The journal: on disk before anything follows from it, and whole whatever cuts it short."""

from __future__ import annotations

import errno
import json
import math
import os
import threading
from pathlib import Path
from typing import Any

import pytest
from executors import carry_out, make, work
from hypothesis import given, settings
from hypothesis import strategies as st

from understudy.errors import ConfigError, RunError
from understudy.records.runs import Run
from understudy_sweeps import trial as module
from understudy_sweeps.journal import Journal
from understudy_sweeps.loops import Report, Trial
from understudy_sweeps.trial import folder_of, overrides_of, run_trial, written

ASKED = Trial("a", ("x=1",), {"p": 0.1}, 0.5, {"trial": "z"}, "bank", "v", 3)
TOLD = Report("a", "running", 0.1 + 0.2, {"m": 1e-9}, 128.0, "runs/a")


def test_what_is_read_is_what_was_written(tmp_path: Path) -> None:
    journal = Journal.open(tmp_path / "journal.jsonl")
    journal.ask(ASKED)
    journal.tell(TOLD)
    again = Journal.open(journal.path)
    assert again.events == [ASKED, TOLD]
    assert (again.asked, again.finished) == ([ASKED], {})


def moved(path: Path, *events: Trial | Report) -> list[Trial | Report]:
    """What a journal of the `events` knows once its sweep's folder is ``there``; the file has the same."""
    journal = Journal(path, [*events])
    journal.move("there")
    kept = Journal.read(path).events if path.exists() else [*events]
    assert kept == journal.events
    return journal.events


def test_only_paths_of_runs_move(tmp_path: Path) -> None:
    """Where a folder is called as a group of options is, what names an option is no path."""
    told = Report("first", "ok", run="dressing/first")
    words = ("experiment=dressing/shirt", "search=dressing/first_of_all", "x=not/dressing/first")
    named = (*words, "start.run='dressing/first'", "y=['dressing/first/ends','dressing/first~2']")
    tried = Trial("first~2"), Trial("second", named, start={"run": "dressing/first"})
    *_, second = moved(tmp_path / "journal.jsonl", told, *tried)
    assert isinstance(second, Trial)
    assert second.overrides == (
        *words, "start.run='there/first'", "y=['there/first/ends','there/first~2']",
    )  # fmt: skip
    assert second.start == {"run": "there/first"}


def test_a_folder_within_another_moves_as_a_whole(tmp_path: Path) -> None:
    told = Report("a", "ok", run="/old/a"), Report("b", "ok", run="/old/a/b")
    *_, asked = moved(tmp_path / "journal.jsonl", *told, Trial("c", ("x=/old/a/b/ends",)))
    assert asked == Trial("c", ("x=there/b/ends",))


def test_reports_of_what_was_not_asked_for_are_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The row that asked for `b` was damaged, and that for `c` stands there twice: what a loop is told of, it knows."""
    path = tmp_path / "journal.jsonl"
    journal = Journal.open(path)
    for event in (
        Trial("a"),
        Report("a", "ok"),
        Trial("b"),
        Report("b", "running"),
        Report("b", "ok"),
        Trial("c"),
    ):
        (journal.ask if isinstance(event, Trial) else journal.tell)(event)  # type: ignore[operator]
    rows = path.read_text().splitlines()
    path.write_text("\n".join([*rows[:2], rows[2][:20] + rows[2][25:], *rows[3:], rows[5]]) + "\n")
    assert Journal.open(path).events == [Trial("a"), Report("a", "ok"), Trial("c")]
    assert "4 rows are damaged" in capsys.readouterr().err
    assert Journal.open(path).events == [Trial("a"), Report("a", "ok"), Trial("c")]


def test_what_follows_a_trials_last_report_is_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of two results, as of two journals one after the other, the second was taken without a word."""
    path = tmp_path / "journal.jsonl"
    journal = Journal.open(path)
    journal.ask(Trial("a"))
    late = Report("a", "ok", 2.0), Report("a", "running")
    for report in (Report("a", "ok", 1.0), *late):
        journal.tell(report)
    assert Journal.read(path).finished == {"a": Report("a", "ok", 1.0)}, "as of a card"
    assert Journal.open(path).events == [Trial("a"), Report("a", "ok", 1.0)]
    assert "2 rows are damaged" in capsys.readouterr().err


def test_a_journal_that_has_not_moved_is_not_written(tmp_path: Path) -> None:
    measures = {"f": math.nan}
    events = Report("a", "ok", math.nan, measures, run="there/a"), Report("b", "failed"), ASKED
    assert moved(tmp_path / "journal.jsonl", *events) == [*events]
    assert not (tmp_path / "journal.jsonl").exists()


def test_other_programs_can_read_it(tmp_path: Path) -> None:
    """What no episode measured is null there, since JSON has no NaN, and is NaN again where it is read."""
    journal = Journal.open(tmp_path / "journal.jsonl")
    journal.ask(Trial("a"))
    journal.tell(Report("a", "ok", 1.0, {"f": math.nan, "g": 2.0}))

    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is no JSON")

    *_, last = (json.loads(line, parse_constant=refuse) for line in journal.path.open())
    assert last["report"]["measures"] == {"f": None, "g": 2.0}
    found = Journal.read(journal.path).finished["a"].measures
    assert math.isnan(found["f"])
    assert found["g"] == 2.0


@pytest.mark.parametrize("run", ["/etc/passwd", "../../victim", "/old/..", "there/../victim", "a"])
def test_no_run_is_outside_its_sweep_whatever_a_journal_says(run: str, tmp_path: Path) -> None:
    for key, name in (("a", "a"), ("..", "%2E%2E"), ("/etc", "%2Fetc")):
        (told,) = moved(tmp_path / "journal.jsonl", Report(key, "ok", run=run))
        assert told == Report(key, "ok", run=f"there/{name}")


STRANGE = ["x" * 300, "\ud800", "", 3, ["a"], None]


@pytest.mark.parametrize(
    "report",
    [
        *({"key": key} for key in STRANGE),
        *({"measures": m} for m in (None, ["f"], {"f": "x"}, {"f": 10**400})),
        {"status": None}, {"objective": "x"}, {"cost": True}, {"cost": math.nan}, {"cost": math.inf}, {"cost": -1.0}, {"run": 1}, {"else": 1},
    ],
)  # fmt: skip
def test_reports_of_other_types_are_left_out(report: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    good = {
        "key": "a",
        "status": "ok",
        "measures": {"f": math.nan, "g": 1e300},
        "objective": -math.inf,
    }
    rows = [{"event": "finished", "report": {**good, **found}} for found in (report, {})]
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    assert [event.key for event in Journal.read(path).events] == ["a"]


@pytest.mark.parametrize(
    "trial",
    [
        *({"key": key} for key in STRANGE),
        *({"overrides": o} for o in (None, [1], 3)),
        {"point": {"x": "1"}}, {"point": {"x": math.nan}}, {"fidelity": math.inf}, {"point": None}, {"fidelity": "1"}, {"seed": [1]}, {"start": 3}, {"variant": None},
    ],
)  # fmt: skip
def test_trials_of_other_types_are_left_out(trial: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    rows = [{"event": "asked", "trial": {"key": "a", "overrides": [], **t}} for t in (trial, {})]
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    assert [event.key for event in Journal.read(path).events] == ["a"]


@pytest.mark.parametrize(
    "row",
    [
        '{"event": "asked", "trial": {"key": "b", "overrides": [], "of_tomorrow": 1}}',
        '{"event": "asked", "trial": {"key": "b", "overrides": ["x=${oc.env:HOME}"]}}',
        '{"event": "finished", "report": {"key": "b", "status": "ok", "run": "r", "cost": "many"}}',
        '{"event": "stopped"}', "[1]", '{"event": "asked", "tri', "\udcff",
    ],
)  # fmt: skip
def test_a_row_that_is_left_out_is_kept_beside(
    row: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Another version's row may be all that there is of hours."""
    journal = Journal.open(tmp_path / "journal.jsonl")
    journal.ask(ASKED)
    whole, given = journal.path.read_bytes(), row.encode(errors="surrogateescape")
    beside = tmp_path / "journal.jsonl.left-out"
    for rows in ([given], [given, b'{"event": 3}']):
        journal.path.write_bytes(b"\n".join([*rows, whole]))
        assert Journal.open(journal.path).events == [ASKED]
        assert journal.path.read_bytes() == whole
        assert beside.read_bytes().splitlines() == rows, "each once, and what was kept stays"
        assert f"kept in {beside.name} beside it" in capsys.readouterr().err


def test_a_row_that_cannot_be_kept_is_not_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "journal.jsonl"
    path.write_text('{"event": "of tomorrow"}\n')

    def full(file: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(RunError, match=r"left-out could not be written: No space left"):
        Journal.open(path)
    assert path.read_text() == '{"event": "of tomorrow"}\n'


def test_a_folder_in_its_place_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="cannot be read"):
        Journal.read(tmp_path)


def test_it_is_on_the_disk_before_anything_follows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal = Journal.open(tmp_path / "journal.jsonl")
    synced: list[int] = []
    sync = os.fsync

    def noted(file: int) -> None:
        sync(file)
        synced.append(os.fstat(file).st_size)

    monkeypatch.setattr(os, "fsync", noted)
    journal.ask(ASKED)
    journal.tell(TOLD)
    assert len(synced) == 2
    assert synced[-1] == journal.path.stat().st_size


@settings(deadline=None)
@given(cut=st.integers(0, 700))
def test_cut_anywhere_it_goes_on(cut: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Whole rows stay, and what is written next does not run into the torn one."""
    path = tmp_path_factory.mktemp("cut") / "journal.jsonl"
    journal = Journal.open(path)
    journal.ask(ASKED)
    journal.tell(TOLD)
    data = path.read_bytes()
    path.write_bytes(data[:cut])
    again = Journal.open(path)
    assert again.events == journal.events[: data[:cut].count(b"\n")] or cut in (
        data.index(b"\n"),  # complete but for the line's end
        len(data) - 1,
    )
    again.tell(TOLD)
    assert Journal.read(path).events == again.events


def test_nothing_follows_from_what_could_not_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal = Journal.open(tmp_path / "journal.jsonl")

    def full(file: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(RunError, match=r"journal\.jsonl could not be written: No space left"):
        journal.ask(ASKED)
    assert journal.events == []


def test_a_key_is_asked_for_once(tmp_path: Path) -> None:
    journal = Journal.open(tmp_path / "journal.jsonl")
    journal.ask(ASKED)
    with pytest.raises(ConfigError, match="asks for trial 'a' twice"):
        journal.ask(Trial("a"))


# ---------------------------------------------------------------------- what a trial is

ANY_KEY = st.text(min_size=1, max_size=20).filter(lambda key: key.isprintable())


@given(key=ANY_KEY)
def test_a_trial_stays_in_the_folder(key: str) -> None:
    sweep = Path("/somewhere/sweep")
    found = Path(os.path.normpath(folder_of(key, sweep)))
    assert found.parent == sweep
    assert found.name not in ("..", ".", "")


@given(one=ANY_KEY, other=ANY_KEY)
def test_two_trials_have_two_folders(one: str, other: str) -> None:
    assert (folder_of(one, "s") == folder_of(other, "s")) == (one == other)


def test_a_trial_is_a_run_without_a_sweep(tmp_path: Path) -> None:
    """So that it can be resumed and rendered where the outer loop or the executor is not installed."""
    given = work(tmp_path, "outer_loop=grid", "executor=processes", "seed=7")
    found = overrides_of(ASKED, given)
    assert "outer_loop=null" in found
    assert "executor=null" in found
    assert [o for o in found if o.startswith("seed=")] == ["seed=3"]
    assert {"x=1", "p=0.1", "difficulty=0.5", "start={trial:'z'}"} < set(found)


@given(st.recursive(st.text(max_size=5), lambda inner: st.lists(inner, max_size=3), max_leaves=5))
def test_plain_data_survives_the_command_line(value: Any) -> None:
    from hydra.core.override_parser.overrides_parser import OverridesParser

    if "\n" in str(value) or not str(value).isprintable():
        return
    (override,) = OverridesParser.create().parse_overrides([f"x={written(value)}"])

    def plain(found: Any) -> Any:
        return (
            [plain(f) for f in found] if isinstance(found, list) else getattr(found, "text", found)
        )

    assert plain(override.value()) == value


def test_it_waits_for_whoever_still_saves(tmp_path: Path) -> None:
    """As a process does whose sweep was killed."""
    held = Run(tmp_path / "a", {})
    held.path.mkdir()
    held.lock()
    threading.Timer(0.5, held.unlock).start()
    (*_, last) = carry_out(make("in_process", work(tmp_path)), [Trial("a")])
    assert last.status == "ok"


def test_it_does_not_wait_for_ever(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And what another process holds is no finding of the trial: the sweep ends."""
    monkeypatch.setattr(module, "PATIENCE", 0.2)
    held = Run(tmp_path / "a", {})
    held.path.mkdir()
    held.lock()
    with pytest.raises(RunError, match="Another process is training in"):
        next(run_trial(Trial("a"), work(tmp_path)))
