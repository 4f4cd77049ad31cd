"""Sweeps: trials as data, their journal, and going on after a stop at any moment."""

from __future__ import annotations

import json
import math
import os
import shutil
import signal
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import pytest
import torch
from commands import forked
from counted_task import LINE_TASK, Starts, install, line_plugins
from torch import Tensor

from understudy.command.cli import main
from understudy.errors import (
    ConfigError,
    FileError,
    PreemptedError,
    RunError,
    TrainingError,
    UnderstudyError,
)
from understudy.random import WorldStreams
from understudy.records import runs
from understudy.running.training import Training
from understudy.task import Context
from understudy_skills import bank
from understudy_sweeps import in_process
from understudy_sweeps import sweep as module
from understudy_sweeps.journal import Journal
from understudy_sweeps.loops import OuterLoop, Report, Trial, Work
from understudy_sweeps.trial import overrides_of

#: Three iterations of 8 samples, each raising the push by `learner.rate`; the objective, where worlds
#: are after 4 s, is 4 × push.
BASE = (
    *LINE_TASK,
    "budget.samples=24",
    "+measure.at={name: line/value}",
    "evaluation.objective=at",
    "evaluation.criterion=1",
    "evaluation.every_samples=0",
    "evaluation.gate=0",
    "outer_loop=grid",
    "executor=in_process",
)
TWO = "outer_loop.variants={slow: [], fast: ['learner.rate=2']}"


class Killed(BaseException):
    """As if the process ended here."""


class Scripted(OuterLoop):
    """Asks for `trials`, one after another's end; answers `stop` to the reports of those in `stopped`
    from so many samples on."""

    trials: Sequence[Trial] = ()
    stopped: Mapping[str, float] = {}
    told: list[Report] = []

    def __init__(self, options: None, seed: int) -> None:
        self._reports: dict[str, Report] = {}

    def ask(self, number: int) -> Trial | None:
        return self.trials[number] if number < len(self.trials) else None

    def recall(self, trial: Trial) -> bool:
        return True

    def tell(self, report: Report) -> Literal["stop"] | None:
        self.told.append(report)
        self._reports[report.key] = report
        return "stop" if report.cost >= self.stopped.get(report.key, math.inf) else None

    def summary(self) -> list[dict[str, Any]]:
        return [{"trial": r.key, "objective": r.objective} for r in self._reports.values()]


class FromBank(Starts):
    """Begins in the states of a bank."""

    @dataclass(frozen=True)
    class Options:
        file: str

    def __init__(self, options: Options, context: Context) -> None:
        self._x = bank.load(options.file)["x"]

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        index = (streams.uniform(1)[:, 0] * len(self._x)).long()
        return {"x": self._x[index]}


@pytest.fixture
def scripted(monkeypatch: pytest.MonkeyPatch) -> type[Scripted]:
    monkeypatch.setattr(Scripted, "told", [])
    return Scripted


@pytest.fixture(autouse=True)
def _plugins(monkeypatch: pytest.MonkeyPatch) -> None:
    install(
        monkeypatch,
        line_plugins(outer_loop={"my/script": Scripted}, initial_states={"bank": FromBank}),
    )


def sweep(folder: Path, *overrides: str) -> None:
    """Run the sweep; what the user could have caused is raised."""
    module.sweep([*BASE, *overrides, f"run.dir={folder}"])


def script(folder: Path, *overrides: str) -> None:
    base = [o for o in BASE if not o.startswith("outer_loop")]
    module.sweep([*base, "+outer_loop={name: my/script}", *overrides, f"run.dir={folder}"])


def rows(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "journal.jsonl").read_text().splitlines()]


def events(folder: Path) -> list[tuple[str, str, float | None]]:
    """Event, trial and objective of each row of the journal."""
    return [
        (r["event"], r["trial"]["key"], None)
        if r["event"] == "asked"
        else (r["event"], r["report"]["key"], r["report"]["objective"])
        for r in rows(folder)
    ]


def iterations(folder: Path, trial: str) -> list[int]:
    file = folder / trial.replace("/", "%2F") / "metrics.jsonl"
    return [json.loads(line)["iteration"] for line in file.read_text().splitlines()]


def whole(trial: str, *objectives: float) -> list[tuple[str, str, float | None]]:
    return [
        ("asked", trial, None),
        *(("reported", trial, value) for value in objectives),
        ("finished", trial, objectives[-1]),
    ]


WHOLE = [*whole("slow/seed0", 4, 8, 12), *whole("fast/seed0", 8, 16, 24)]


def test_the_journal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sweep(tmp_path / "sweep", TWO)
    assert events(tmp_path / "sweep") == WHOLE
    trial, report, last = (rows(tmp_path / "sweep")[i] for i in (0, 1, 4))
    assert (trial["trial"]["overrides"], trial["trial"]["seed"]) == ([], 0)
    run = str(tmp_path / "sweep/slow%2Fseed0")
    assert report["report"] == {
        "key": "slow/seed0", "status": "running", "objective": 4.0,
        "measures": {"at": 4.0, "return": 10.0}, "cost": 8, "run": run, "outcome": "",
    }  # fmt: skip
    assert last["report"] == {
        "key": "slow/seed0", "status": "ok", "objective": 12.0,
        "measures": {"at": 12.0, "return": 30.0}, "cost": 24.0, "run": run, "outcome": "budget",
    }  # fmt: skip
    assert json.loads((Path(run) / "evaluation.json").read_text())["objective"]["value"] == 12.0
    summary = json.loads((tmp_path / "sweep/summary.json").read_text())
    assert [(r["variant"], r["objective"], r["samples"]) for r in summary] == [
        ("slow", 12, 24),
        ("fast", 24, 24),
    ]
    assert capsys.readouterr().out.splitlines()[-1] == f"sweep: {tmp_path / 'sweep'}"


def test_repeating_a_finished_sweep_runs_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sweep(tmp_path, TWO)
    monkeypatch.setattr(in_process, "run_trial", None)
    sweep(tmp_path, TWO)
    assert events(tmp_path) == WHOLE


#: Forks sweepers, one for each row of the journal, that die at once, handlers and all, when it is
#: written. From a process of its own: forking one that has threads would leave locks behind.
KILLER = """
import os, sys
import torch
torch.set_num_threads(1)
from understudy_sweeps import journal, trial
from understudy_sweeps import journal, sweep as module
from understudy.setup import composition, plugins
import counted_task
found = counted_task.line_plugins()
for place in (plugins, composition, module):
    place.installed = lambda: found
write = journal.Journal._write

def dying(self, event):
    write(self, event)
    if len(self.events) == after:
        os._exit(9)

journal.Journal._write = dying
folder, rows, *overrides = sys.argv[1:]
for after in range(1, int(rows) + 1):
    child = os.fork()
    if child == 0:
        try:
            module.sweep([*overrides, f"run.dir={folder}/{after}"])
        finally:
            os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9, after
"""


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folders of sweeps that were killed after 1, 2, … rows of the journal."""
    folder = tmp_path_factory.mktemp("killed")
    done = forked(KILLER, str(folder), str(len(WHOLE)), *BASE, TWO, cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.parametrize("after", range(1, len(WHOLE) + 1))
def test_killed_at_any_point(killed: Path, monkeypatch: pytest.MonkeyPatch, after: int) -> None:
    """Finished trials are not repeated, unfinished ones continued, and the results are the same."""
    folder = killed / str(after)
    assert events(folder) == WHOLE[:after]
    done = [key for event, key, _ in WHOLE[:after] if event == "finished"]
    run_trial, begun = in_process.run_trial, []

    def counted(trial: Trial, *rest: Any) -> Any:
        begun.append(trial.key)
        return run_trial(trial, *rest)

    monkeypatch.setattr(in_process, "run_trial", counted)
    sweep(folder, TWO)
    keys = ["slow/seed0", "fast/seed0"]
    assert begun == [key for key in keys if key not in done]
    assert events(folder) == WHOLE
    for key in keys:
        assert iterations(folder, key) == [1, 2, 3]


def test_a_row_cut_short_is_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sweep(tmp_path, TWO)
    file = tmp_path / "journal.jsonl"
    text = file.read_text()
    file.write_text(text[: -len(text.splitlines()[-1]) // 2])
    assert "damaged" not in capsys.readouterr().err
    sweep(tmp_path, TWO)
    assert f"A row is damaged in {file} and left out" in capsys.readouterr().err
    assert events(tmp_path) == WHOLE


def test_an_interrupted_trial_is_saved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What it learned until then is not learned again."""
    tell, before = Journal.tell, signal.getsignal(signal.SIGINT)

    def interrupted(self: Journal, report: Report) -> None:
        tell(self, report)
        if report.objective == 8.0:
            raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(Journal, "tell", interrupted)
        with pytest.raises(Killed):
            sweep(tmp_path)
    assert signal.getsignal(signal.SIGINT) is before, "none still waits for it"
    iterate, again = Training.iterate, []

    def counted(self: Training) -> dict[str, Any]:
        row = iterate(self)
        again.append(row["iteration"])
        return row

    monkeypatch.setattr(Training, "iterate", counted)
    sweep(tmp_path)
    assert again == [3]
    assert events(tmp_path) == whole("base/seed0", 4, 8, 12)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["outer_loop.variants={a: [seed=3]}"], "seed=3 is overruled, .* give outer_loop.seeds"),
        (["outer_loop.variants={a: seed=3}"], "seed=3 is overruled"),
        (["outer_loop.variants={a: [run.dir=x]}"], "run.dir=x is overruled, .* leave it out"),
        (["outer_loop.variants={a: [executor=ray]}"], "executor=ray is overruled"),
        (["outer_loop.variants={a: [++outer_loop=chain]}"], r"\+\+outer_loop=chain is overruled"),
        (["outer_loop.variants={a: [outer_loop.trials=3]}"], "outer_loop.trials=3 is overruled"),
        (["outer_loop.variants={a: [executor.workers=3]}"], "executor.workers=3 is overruled"),
        (["seed=3"], r"Write seeds=\[3\]"),
        (["outer_loop.seeds=[1,0,1]"], "seeds has 1 twice"),
        (["outer_loop.variants={a: [], a: [learner.rate=2]}"], "'a' stands twice"),
    ],
)
def test_nothing_that_is_asked_for_is_overruled_in_silence(
    tmp_path: Path, words: list[str], said: str
) -> None:
    """A variant with a seed of its own was trained with the sweep's, and one of a name that stands twice not at all."""
    with pytest.raises(ConfigError, match=said):
        sweep(tmp_path, *words)
    assert not list(tmp_path.rglob("run.json"))


@pytest.mark.parametrize("name", ["run.dir", "outer_loop.trials", "executor.workers", "seed"])
def test_nothing_that_is_searched_is_overruled_in_silence(tmp_path: Path, name: str) -> None:
    """Values were drawn and told of, and every trial was the same."""
    point = Trial("trial0", point={name: 1.0}, seed=3)
    with pytest.raises(ConfigError, match=f"{name} is overruled, since a sweep says that"):
        overrides_of(point, Work((), str(tmp_path)))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stop_signal_does_not_wait_for_a_judgement(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    """Which took eight minutes, in which Ctrl-C was to end "once this iteration is finished"."""
    judge, waited = Training.judge, []

    def long(self: Training, *arguments: Any) -> Any:
        os.kill(os.getpid(), number)
        waited.append(True)
        return judge(self, *arguments)

    with monkeypatch.context() as patch:
        patch.setattr(Training, "judge", long)
        with pytest.raises(PreemptedError, match=f"Stopped by {number.name}; finished trials"):
            sweep(tmp_path)
    assert not waited
    sweep(tmp_path)
    assert events(tmp_path) == whole("base/seed0", 4, 8, 12), "nothing is trained again"


@pytest.mark.parametrize(
    "more",
    [
        ("outer_loop.variants={slow: [], fast: ['learner.rate=2'], faster: ['learner.rate=3']}",),
        (TWO, "outer_loop.seeds=[0, 1]"),
        ("outer_loop.variants={faster: ['learner.rate=3']}",),
    ],
    ids=["a variant", "a seed", "other variants"],
)
def test_what_is_added_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, more: tuple) -> None:
    sweep(tmp_path, TWO)
    sweep(tmp_path, *more)
    found = events(tmp_path)
    assert found[: len(WHOLE)] == WHOLE
    added = [key for event, key, _ in found[len(WHOLE) :] if event == "asked"]
    assert added == (["slow/seed1", "fast/seed1"] if TWO in more else ["faster/seed0"])
    assert found[-1][2] == (24 if TWO in more else 36)


def test_the_folder_of_its_own_stays_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However many variants and seeds there are: the name is made of what is compared."""
    monkeypatch.chdir(tmp_path)
    for more in ((TWO,), (TWO, "outer_loop.seeds=[0,1]"), ("outer_loop.variants={more: []}",)):
        module.sweep([*BASE, *more])
    assert len(list((tmp_path / "runs").iterdir())) == 1
    module.sweep([*BASE, TWO, "episode.seconds=3"])
    assert len(list((tmp_path / "runs").iterdir())) == 2


def test_a_variant_that_became_another_is_refused(tmp_path: Path) -> None:
    sweep(tmp_path, TWO)
    with pytest.raises(ConfigError, match=r"variant of trial 'fast/seed0' had other overrides"):
        sweep(tmp_path, "outer_loop.variants={slow: [], fast: ['learner.rate=3']}")
    with pytest.raises(RunError, match=r"holds another sweep \(episode.seconds: .* → 3.0\)"):
        sweep(tmp_path, TWO, "episode.seconds=3")
    assert events(tmp_path) == WHOLE


@pytest.mark.parametrize(
    ("older", "goes_on"),
    [
        (lambda c: c["learner"].pop("rate"), True),  # an option that is new since
        (lambda c: c["learner"].update(rate=7.0), False),  # another default
        (lambda c: c["learner"].update(gone=1.0), False),  # an option that there is no more
        (lambda c: c["reward"]["terms"].clear(), False),  # a component that is new since
    ],
)
def test_a_sweep_of_an_older_version_goes_on_where_only_options_are_new(
    tmp_path: Path, older: Callable[[dict[str, Any]], Any], goes_on: bool
) -> None:
    sweep(tmp_path, TWO)
    mark = json.loads((tmp_path / "sweep.json").read_text())
    older(mark["compared"])
    (tmp_path / "sweep.json").write_text(json.dumps({**mark, "sweep": "00000000"}))
    with nullcontext() if goes_on else pytest.raises(RunError, match="holds another sweep"):
        sweep(tmp_path, TWO)
    if goes_on:  # the same command alone
        (tmp_path / "sweep.json").write_text(json.dumps({**mark, "sweep": "00000000"}))
        with pytest.raises(RunError, match="holds another sweep"):
            sweep(tmp_path, TWO, "learner.rate=0.5")
    assert events(tmp_path) == WHOLE


@pytest.mark.parametrize("there", ["page.html", "trials.csv", "film.mp4", "src/code.py"])
def test_a_sweep_begins_in_a_folder_of_its_own(tmp_path: Path, there: str) -> None:
    """What lies there would be overwritten; notes may lie beside it, and a card that came before the first training."""
    for name in (there, "notes.txt", "card.md"):
        (tmp_path / "s" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "s" / name).write_text("mine")
    before = {path: path.is_file() and path.read_text() for path in tmp_path.rglob("*")}
    with pytest.raises(
        RunError, match=rf"s is not new: it holds {there}, and no sweep\. Give run\."
    ):
        sweep(tmp_path / "s", TWO)
    assert {path: path.is_file() and path.read_text() for path in tmp_path.rglob("*")} == before
    shutil.rmtree(tmp_path / "s" / Path(there).parts[0], ignore_errors=True)
    (tmp_path / "s" / there).unlink(missing_ok=True)
    sweep(tmp_path / "s", TWO)
    assert (tmp_path / "s" / "card.md").read_text() == "mine"


@pytest.mark.parametrize("inner", ["", "inner", "checkpoints"])
def test_no_sweep_begins_in_a_run(tmp_path: Path, inner: str) -> None:
    """Its trials would all have failed, as runs inside a run."""
    (tmp_path / "run" / "checkpoints").mkdir(parents=True)
    (tmp_path / "run" / "run.json").write_text("{}")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(RunError, match=rf"is (inside )?the run {tmp_path / 'run'}\. Give run\.dir"):
        sweep(tmp_path / "run" / inner, TWO)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_sweep_in_the_root_of_the_disk_is_refused_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(runs, "check_within", lambda folder: pytest.fail("looks through it"))
    with pytest.raises(RunError, match=r"^/ is not new: it holds "):
        sweep(Path("/"), TWO)


@pytest.mark.parametrize("content", ["", "[]", "{}", "7"])
def test_a_damaged_mark_is_refused(tmp_path: Path, content: str) -> None:
    sweep(tmp_path, TWO)
    (tmp_path / "sweep.json").write_text(content)
    with pytest.raises(RunError, match=r"sweep\.json is damaged"):
        sweep(tmp_path, TWO)


def test_a_variant_whose_file_is_missing_is_no_finding(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The sweep ends, and goes on with it once the file is there."""

    def missing(self: Training) -> Training:
        if self.experiment.need("learner").options.rate == 2:
            raise FileError("There is no grip at nosuch.json.")
        return prepare(self)

    prepare = Training.prepare
    monkeypatch.setattr(Training, "prepare", missing)
    with pytest.raises(
        ConfigError, match=r"Variant 'fast' cannot begin: There is no grip at nosuch"
    ):
        sweep(tmp_path, TWO)
    monkeypatch.setattr(Training, "prepare", prepare)
    sweep(tmp_path, TWO)
    assert events(tmp_path) == WHOLE


def test_a_trial_that_fails_is_a_finding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def hopeless(self: Training) -> dict[str, Any]:
        if self.experiment.root.seed == 1 and self.progress.iteration == 2:
            raise TrainingError("It is hopeless.")
        return iterate(self)

    iterate = Training.iterate
    monkeypatch.setattr(Training, "iterate", hopeless)
    sweep(tmp_path, TWO, "outer_loop.seeds=[0]")
    sweep(tmp_path, TWO, "outer_loop.seeds=[0,1]")
    found = {r["report"]["key"]: r["report"] for r in rows(tmp_path) if r["event"] == "finished"}
    assert found["slow/seed0"]["status"] == "ok"
    assert found["slow/seed1"]["status"] == "failed: It is hopeless."
    assert found["slow/seed1"]["objective"] is None
    assert found["slow/seed1"]["cost"] == 16
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert [(r["variant"], r["seeds"], r["failed"]) for r in summary] == [
        ("slow", 1, 1),
        ("fast", 1, 1),
    ]


def test_a_broken_variant_is_refused_before_anything_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    variants = "outer_loop.variants={sound: [], odd: ['learner.rate=fast']}"
    assert main(["sweep", *BASE, variants, f"run.dir={tmp_path / 'sweep'}"]) == 2
    assert (
        "Variant 'odd' cannot be run: learner.rate='fast' is not possible"
        in capsys.readouterr().err
    )
    assert not (tmp_path / "sweep").exists()


def test_gpus_that_no_variant_uses_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each trial was given one of eight, and trained on the CPU."""
    words = ("executor=processes", "executor.gpus=8", f"run.dir={tmp_path / 'sweep'}")
    assert main(["sweep", *BASE, TWO, *words]) == 2
    assert "executor.gpus=8 gives each trial a GPU, which none uses" in capsys.readouterr().err
    assert not (tmp_path / "sweep").exists()


def test_a_gpu_that_a_variant_alone_asks_for_is_looked_for_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The others were trained, and that one failed after them."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    variants = "outer_loop.variants={here: [], there: [device=cuda]}"
    assert main(["sweep", *BASE, variants, f"run.dir={tmp_path / 'sweep'}"]) == 2
    assert "device=cuda, but torch sees no CUDA GPU here." in capsys.readouterr().err
    assert not (tmp_path / "sweep").exists()


def test_variants_that_differ_in_nothing_are_told_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """They were compared, with a difference of 0, without a word."""
    variants = "outer_loop.variants={slow: [], same: ['learner.rate=1'], fast: ['learner.rate=2']}"
    words = [*BASE, "learner.rate=1", variants, f"run.dir={tmp_path / 'sweep'}"]
    assert main(["sweep", *words]) == 0
    told = [line for line in capsys.readouterr().err.splitlines() if "are one" in line]
    assert told == ["Variants 'slow' and 'same' are one: their configurations differ in nothing."]


def test_a_broken_first_trial_is_refused(tmp_path: Path, scripted: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr(scripted, "trials", [Trial("a", point={"learner.rat": 1.0})])
    with pytest.raises(ConfigError, match=r"Trial 'a' cannot be run: .*rat.*Did you mean 'rate'"):
        script(tmp_path / "sweep")
    assert not (tmp_path / "sweep").exists()


def test_a_defect_stops_the_sweep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(self: Training) -> dict[str, Any]:
        raise ZeroDivisionError

    monkeypatch.setattr(Training, "iterate", broken)
    with pytest.raises(ZeroDivisionError):
        sweep(tmp_path)


# ---------------------------------------------------------------------- what a trial is


def test_stopping_a_trial_early(tmp_path: Path, scripted: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr(scripted, "trials", [Trial("a"), Trial("b")])
    monkeypatch.setattr(scripted, "stopped", {"a": 8})
    script(tmp_path)
    assert events(tmp_path) == [*whole("a", 4), *whole("b", 4, 8, 12)]
    assert [(r.status, r.objective) for r in scripted.told[:2]] == [("running", 4), ("ok", 4)]
    assert (iterations(tmp_path, "a"), iterations(tmp_path, "b")) == ([1], [1, 2, 3])
    assert rows(tmp_path)[2]["report"]["cost"] == 8


def test_a_search_computes_on_one_thread(
    tmp_path: Path, scripted: Any, monkeypatch: Any, two_threads: None
) -> None:
    """And what it hears of trials, which have theirs, comes on as many as before."""
    threads: dict[str, int] = {}

    def ask(self: Scripted, number: int) -> Trial | None:
        threads["ask"] = torch.get_num_threads()
        return None if number else Trial("a")

    def tell(self: Scripted, report: Report) -> None:
        threads["tell"] = torch.get_num_threads()

    monkeypatch.setattr(scripted, "ask", ask)
    monkeypatch.setattr(scripted, "tell", tell)
    script(tmp_path)
    assert threads == {"ask": 1, "tell": 2}


def test_an_early_stop_is_remembered(tmp_path: Path, scripted: Any, monkeypatch: Any) -> None:
    """Killed when the loop had said stop and the trial did not know yet."""
    monkeypatch.setattr(scripted, "trials", [Trial("a"), Trial("b")])
    monkeypatch.setattr(scripted, "stopped", {"a": 8})

    def killed(*arguments: Any) -> None:
        raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(module, "note_stop", killed)
        with pytest.raises(Killed):
            script(tmp_path, "checkpoint.minutes=0")
    assert events(tmp_path) == whole("a", 4)[:-1]
    script(tmp_path, "checkpoint.minutes=0")
    assert events(tmp_path) == [*whole("a", 4), *whole("b", 4, 8, 12)]
    assert iterations(tmp_path, "a") == [1]
    assert rows(tmp_path)[2]["report"]["outcome"] == "stopped"


def test_a_trial_that_began_anew_ends_where_the_loop_said(
    tmp_path: Path, scripted: Any, monkeypatch: Any
) -> None:
    """Killed with no checkpoint but that of its beginning: its reports are made again, and the second was the last."""
    monkeypatch.setattr(scripted, "trials", [Trial("a")])
    monkeypatch.setattr(scripted, "stopped", {"a": 16})

    def killed(*arguments: Any) -> None:
        raise Killed

    save = Training.save

    def at_the_beginning(self: Training) -> Any:
        return save(self) if self.progress.iteration == 0 else None

    with monkeypatch.context() as patch:
        patch.setattr(module, "note_stop", killed)
        patch.setattr(Training, "save", at_the_beginning)
        with pytest.raises(Killed):
            script(tmp_path)
    script(tmp_path)
    assert events(tmp_path) == whole("a", 4, 8)
    assert rows(tmp_path)[-1]["report"]["outcome"] == "stopped"


def test_a_report_that_was_lost_is_made_again(
    tmp_path: Path, scripted: Any, monkeypatch: Any
) -> None:
    """Killed when the trial had saved itself and its report was not in the journal."""
    monkeypatch.setattr(scripted, "trials", [Trial("a")])
    tell = Journal.tell

    def killed(self: Journal, report: Report) -> None:
        if report.objective == 8:
            raise Killed
        tell(self, report)

    with monkeypatch.context() as patch:
        patch.setattr(Journal, "tell", killed)
        with pytest.raises(Killed):
            script(tmp_path, "checkpoint.minutes=0")
    assert events(tmp_path) == whole("a", 4)[:-1]
    script(tmp_path, "checkpoint.minutes=0")
    assert events(tmp_path) == whole("a", 4, 8, 12)
    assert [r.objective for r in scripted.told] == [4, 4, 8, 12, 12], "once before, then all once"


def test_point_and_fidelity(tmp_path: Path, scripted: Any, monkeypatch: Any) -> None:
    trial = Trial("a", point={"learner.rate": 0.5, "policy.push": 1.0}, fidelity=0.25)
    monkeypatch.setattr(scripted, "trials", [trial])
    monkeypatch.setattr(Starts, "reads", ("difficulty",))
    script(tmp_path)
    assert events(tmp_path) == whole("a", 6, 8, 10)
    assert json.loads((tmp_path / "a/run.json").read_text())["config"]["difficulty"] == 0.25
    recalled = Journal.open(tmp_path / "journal.jsonl").asked
    assert recalled == [trial]


@pytest.mark.parametrize(
    ("ends", "said"),
    [
        ((0, 24), r"budget\.samples from 0 to 24, and budget\.samples=0 .* greater than 0"),
        ((24, 1e30), r"from 24 to 1e\+30, and budget\.samples=1\d+ .* at most"),
    ],
)
def test_a_range_beyond_a_limit_is_refused_before_the_first_trial(
    tmp_path: Path, scripted: Any, monkeypatch: Any, ends: tuple[float, float], said: str
) -> None:
    trial = Trial("a", point={"budget.samples": 24, "learner.rate": 1.0})
    ranges = {"learner.rate": (0.5, 2.0), "budget.samples": ends}
    monkeypatch.setattr(scripted, "trials", [trial])
    monkeypatch.setattr(scripted, "ranges", ranges)
    with pytest.raises(ConfigError, match=said):
        script(tmp_path / "sweep")
    assert not (tmp_path / "sweep").exists()
    monkeypatch.setattr(scripted, "ranges", ranges | {"budget.samples": (8, 24)})
    script(tmp_path / "sweep")
    assert events(tmp_path / "sweep") == whole("a", 4, 8, 12)


def test_an_end_that_others_make_impossible_is_no_limit(
    tmp_path: Path, scripted: Any, monkeypatch: Any
) -> None:
    """More physics steps in a decision than there can be take two options, of which the search has both."""
    monkeypatch.setattr(scripted, "trials", [Trial("a", point={"control.substeps": 4})])
    both = {"control.substeps": (4, 10_000), "control.decision": (1, 10_000)}
    monkeypatch.setattr(scripted, "ranges", both)
    with pytest.raises(ConfigError, match="more than 100000 steps"):
        sweep(tmp_path / "one", "control.substeps=10000", "control.decision=11")
    script(tmp_path / "both")
    assert [event for event, *_ in events(tmp_path / "both")][-1] == "finished"


def test_a_fidelity_that_nothing_reads(tmp_path: Path, scripted: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr(scripted, "trials", [Trial("a", fidelity=0.25)])
    with pytest.raises(ConfigError, match="Nothing in this task reads `difficulty`"):
        script(tmp_path)
    assert [event for event, *_ in events(tmp_path)] == ["asked"]
    assert not scripted.told


def test_beginning_from_an_earlier_trial(tmp_path: Path, scripted: Any, monkeypatch: Any) -> None:
    second = Trial("b", start={"trial": "a", "parts": ["actor"]})
    monkeypatch.setattr(scripted, "trials", [Trial("a"), second])
    script(tmp_path)
    assert events(tmp_path) == [*whole("a", 4, 8, 12), *whole("b", 16, 20, 24)]
    assert rows(tmp_path)[5]["trial"]["start"] == {"trial": "a", "parts": ["actor"]}
    sources = json.loads((tmp_path / "b/run.json").read_text())["sources"]
    assert sources["start"] == {
        "run": str(tmp_path / "a"),
        "parts": ["actor"],
        "samples": 24,
        "sources": {},
        "behind": [],
    }


def test_beginning_from_a_trial_that_is_not_there(
    tmp_path: Path, scripted: Any, monkeypatch: Any
) -> None:
    monkeypatch.setattr(scripted, "trials", [Trial("b", start={"trial": "a"})])
    with pytest.raises(RunError, match=r"'b' begins from 'a', which is not finished"):
        script(tmp_path)


def test_a_sweep_whose_folder_was_moved_goes_on(tmp_path: Path) -> None:
    """A chain's second stage was stopped before it began; its first one's run is elsewhere by then."""
    base = [o for o in BASE if not o.startswith("outer_loop")]
    stages = "outer_loop.stages={first: [], second: [\"start.run='{first}'\"]}"

    def chain(folder: Path, *overrides: str) -> None:
        module.sweep([*base, "outer_loop=chain", stages, *overrides, f"run.dir={folder}"])

    chain(tmp_path / "whole")
    chain(tmp_path / "here")
    journal = tmp_path / "here/journal.jsonl"
    kept = journal.read_text().splitlines(keepends=True)[:-4]
    assert json.loads(kept[-1])["trial"]["key"] == "second"
    journal.write_text("".join(kept))  # asked for, with the path of the folder where it was
    shutil.rmtree(tmp_path / "here/second")
    shutil.move(tmp_path / "here", tmp_path / "there")
    for _ in range(2):
        chain(tmp_path / "there")
        assert events(tmp_path / "there") == events(tmp_path / "whole")
        assert str(tmp_path / "here") not in (tmp_path / "there/journal.jsonl").read_text()
    assert iterations(tmp_path / "there", "second") == iterations(tmp_path / "whole", "second")
    assert not (tmp_path / "here").exists()


def test_a_stage_of_a_strangers_journal_begins_within_the_folder(tmp_path: Path) -> None:
    """Though it says that the stage before it ran elsewhere, in the user's own runs."""
    base = [o for o in BASE if not o.startswith("outer_loop")]
    stages = "outer_loop.stages={first: [], second: [\"start.run='{first}'\"]}"

    def chain(folder: Path) -> None:
        module.sweep([*base, "outer_loop=chain", stages, f"run.dir={folder}"])

    chain(tmp_path / "theirs")
    shutil.copytree(tmp_path / "theirs" / "first", tmp_path / "mine")
    shutil.rmtree(tmp_path / "theirs" / "second")
    journal = tmp_path / "theirs" / "journal.jsonl"
    kept = [line for line in journal.read_text().splitlines() if '"second"' not in line]
    journal.write_text("\n".join(kept).replace("theirs/first", "mine") + "\n")
    assert str(tmp_path / "mine") in journal.read_text()
    chain(tmp_path / "theirs")
    begun = json.loads((tmp_path / "theirs" / "second" / "run.json").read_text())
    assert begun["config"]["start"]["run"] == str(tmp_path / "theirs" / "first")
    assert str(tmp_path / "mine") not in journal.read_text()


def test_a_stage_that_was_under_way_when_the_folder_moved_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    base = [o for o in BASE if not o.startswith("outer_loop")]
    stages = "outer_loop.stages={first: [], second: [\"start.run='{first}'\"]}"

    def chain(folder: Path) -> None:
        module.sweep([*base, "outer_loop=chain", stages, f"run.dir={folder}"])

    chain(tmp_path / "whole")
    save = Training.save

    def killed(training: Training) -> Path:
        path = save(training)
        if training.run is not None and training.run.path.name == "second":
            raise Killed
        return path

    with monkeypatch.context() as patch:
        patch.setattr(Training, "save", killed)
        with pytest.raises(Killed):
            chain(tmp_path / "here")
    assert (tmp_path / "here/second/run.json").is_file()
    shutil.move(tmp_path / "here", tmp_path / "there")
    chain(tmp_path / "there")
    assert events(tmp_path / "there") == events(tmp_path / "whole")
    assert iterations(tmp_path / "there", "second") == iterations(tmp_path / "whole", "second")
    assert not (tmp_path / "here").exists()


def test_a_policy_that_is_gone_is_learned_again(
    tmp_path: Path, scripted: Any, monkeypatch: Any
) -> None:
    """The journal alone was kept: `c` needs `b`, which needs `a`; `a` was stopped after 16 samples."""
    first = [Trial("a"), Trial("b", start={"trial": "a"})]
    monkeypatch.setattr(scripted, "stopped", {"a": 16})
    monkeypatch.setattr(scripted, "trials", first)
    script(tmp_path)
    before = events(tmp_path)
    assert before == [*whole("a", 4, 8)[:3], ("finished", "a", 8), *whole("b", 12, 16, 20)]
    for name in "ab":
        shutil.rmtree(tmp_path / name)
    third = Trial("c", start={"trial": "b", "parts": ["actor"]})
    monkeypatch.setattr(scripted, "trials", [*first, third])
    script(tmp_path)
    assert events(tmp_path) == [*before, *whole("c", 24, 28, 32)]
    assert iterations(tmp_path, "a") == [1, 2]
    assert iterations(tmp_path, "b") == [1, 2, 3]
    assert (
        len([r for r in scripted.told if r.key == "a" and r.final]) == 2
    )  # each sweep is told once


@pytest.mark.parametrize(
    "of", ["objective", "success_rate", "samples", "seconds", "return", "at", "metrics/reward"]
)
def test_what_published_numbers_are_of_is_known(of: str) -> None:
    module._check_paper({"caption": "", "of": of, "values": {"slow": 1.0}}, {"at"})


def test_published_numbers_of_nothing_are_refused(tmp_path: Path) -> None:
    """They stood in the table beside a column without values."""
    paper = "+outer_loop.paper={caption: Table 1, of: att, values: {slow: 1}}"
    match = r"^outer_loop\.paper\.of=att is no figure of these trials\. Did you mean 'at'\?$"
    with pytest.raises(ConfigError, match=match):
        sweep(tmp_path / "sweep", TWO, paper.removeprefix("+"))
    assert not (tmp_path / "sweep").exists()


def test_a_sweep_that_gave_nothing_does_not_end_well(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What a script looks at is the status: 0 for a chain of which a stage failed would let it go on without it."""
    base = [o for o in BASE if not o.startswith("outer_loop")]
    chain = [*base, "outer_loop=chain", f"run.dir={tmp_path / 'chain'}"]
    stages = "outer_loop.stages={first: [], second: ['start.run=nowhere'], third: [\"start.run='{second}'\"]}"
    assert module.sweep([*chain, stages]) == 1
    said = capsys.readouterr().err
    assert "second: failed: nowhere is no run folder" in said
    assert said.endswith("Not done: second, third. The same command tries again.\n")
    grid = [
        "outer_loop.variants={bad: ['start.run=nowhere'], good: []}",
        f"run.dir={tmp_path / 'grid'}",
    ]
    assert module.sweep([*BASE, *grid]) == 0, "a variant that failed is a finding"
    grid = ["outer_loop.variants={bad: ['start.run=nowhere']}", f"run.dir={tmp_path / 'none'}"]
    assert module.sweep([*BASE, *grid]) == 1


def test_a_stage_whose_run_is_gone_is_trained_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`third` builds on `second`, and that on `first`; what these gave stays as it was."""
    base = [o for o in BASE if not o.startswith("outer_loop")]
    two = "first: [], second: [\"start.run='{first}'\"]"

    def chain(stages: str) -> None:
        words = ["outer_loop=chain", f"outer_loop.stages={{{stages}}}", f"run.dir={tmp_path}"]
        module.sweep([*base, *words])

    chain(two)
    before, names = events(tmp_path), ("first", "second")
    weights = [runs.newest_state(str(tmp_path / name))["policy"]["push"] for name in names]
    for name in names:
        shutil.rmtree(tmp_path / name)
    capsys.readouterr()
    chain(f"{two}, third: [\"start.run='{{second}}'\"]")
    assert "failed" not in capsys.readouterr().out
    assert events(tmp_path)[: len(before)] == before
    assert {key for _, key, _ in events(tmp_path)[len(before) :]} == {"third"}
    assert [runs.newest_state(str(tmp_path / name))["policy"]["push"] for name in names] == weights


def test_a_policy_that_is_gone_and_cannot_be_learned_again(
    tmp_path: Path, scripted: Any, monkeypatch: Any
) -> None:
    bank.save(tmp_path / "bank", {"x": torch.full((3, 1), 100.0)}, {})
    first = Trial("a", initial_states=str(tmp_path / "bank"))
    monkeypatch.setattr(scripted, "trials", [first])
    script(tmp_path / "sweep")
    shutil.rmtree(tmp_path / "sweep/a")
    for file in tmp_path.glob("bank.*"):
        file.unlink()
    monkeypatch.setattr(scripted, "trials", [first, Trial("b", start={"trial": "a"})])
    with pytest.raises(
        RunError, match="'a', on which another builds, is gone, and it could not be trained again"
    ):
        script(tmp_path / "sweep")
    assert [event for event, key, _ in events(tmp_path / "sweep") if key == "a"][-1] == "finished"


def test_beginning_in_a_bank(tmp_path: Path, scripted: Any, monkeypatch: Any) -> None:
    bank.save(tmp_path / "bank", {"x": torch.full((3, 1), 100.0)}, {})
    trial = Trial("a", initial_states=str(tmp_path / "bank"))
    monkeypatch.setattr(scripted, "trials", [trial])
    script(tmp_path / "sweep")
    assert events(tmp_path / "sweep") == whole("a", 104, 108, 112)


def test_a_bank_that_is_damaged_fails_its_trial_alone(
    tmp_path: Path, scripted: Any, monkeypatch: Any
) -> None:
    trials = [Trial("a", initial_states=str(tmp_path / "none")), Trial("b")]
    monkeypatch.setattr(scripted, "trials", trials)
    script(tmp_path / "sweep")
    assert [r.status.partition(":")[0] for r in scripted.told if r.final] == ["failed", "ok"]


def test_a_key_asked_for_twice(tmp_path: Path, scripted: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr(scripted, "trials", [Trial("a"), Trial("a")])
    with pytest.raises(UnderstudyError, match=r"asks for trial 'a' twice"):
        script(tmp_path)


def test_keys_of_trials_stay_in_the_folder(tmp_path: Path, scripted: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr(scripted, "trials", [Trial("../../out"), Trial("..")])
    script(tmp_path / "deep/sweep")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["deep"]
    assert sorted(p.name for p in (tmp_path / "deep").iterdir()) == ["sweep"]
    assert {"..%2F..%2Fout", "%2E%2E"} < {p.name for p in (tmp_path / "deep/sweep").iterdir()}


def test_two_sweeps_in_one_folder_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def again(*arguments: Any) -> Any:
        raise AssertionError("the second one runs")

    ask = Journal.ask

    def nested(self: Journal, trial: Trial) -> None:
        with pytest.raises(RunError, match="Another process is training in"):
            sweep(tmp_path)
        ask(self, trial)

    monkeypatch.setattr(Journal, "ask", nested)
    sweep(tmp_path)
    assert events(tmp_path) == whole("base/seed0", 4, 8, 12)


def test_no_sweep_without_an_outer_loop(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    base = [o for o in BASE if not o.startswith("outer_loop")]
    assert main(["sweep", *base, f"run.dir={tmp_path / 'sweep'}"]) == 2
    said = capsys.readouterr().err
    assert all(key in said for key in ("variants=", "ablation=", "search=", "outer_loop="))
    assert not (tmp_path / "sweep").exists()


def test_journals_of_strangers_are_data(tmp_path: Path) -> None:
    good: Mapping[str, Any] = {"event": "asked", "trial": {"key": "a", "overrides": ["seed=0"]}}
    lines = [json.dumps(good), "[]", "3", '{"event": "asked"}', '{"event": "asked", "trial": {"kez": 1}}', "\0"]  # fmt: skip
    (tmp_path / "journal.jsonl").write_text("\n".join(lines))
    assert Journal.open(tmp_path / "journal.jsonl").events == [Trial("a", ("seed=0",))]


def test_an_experiment_that_does_not_go_with_the_sweeps_own_is_named() -> None:
    with pytest.raises(ConfigError, match="search=cmfbo/toy chooses an experiment of its own"):
        module.sweep(["search=cmfbo/toy", "experiment=spacetime/walk"])
