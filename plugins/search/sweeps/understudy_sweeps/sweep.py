"""Outer loops over whole runs: ``understudy sweep ablation=…``, ``search=…`` or ``outer_loop=…``.

Starting the same sweep again tells the outer loop what the journal knows, continues what was asked for and not
finished, and asks for the rest.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import os
import re
import signal
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

from understudy.command.command import tell
from understudy.errors import ConfigError, PreemptedError, RunError, suggestion
from understudy.folders import read, write_atomically
from understudy.options import at
from understudy.records import runs
from understudy.setup.composition import load_experiment
from understudy.setup.config import Experiment
from understudy.setup.plugins import installed
from understudy.signals import StopRequest
from understudy_reinforcement.success import success_of
from understudy_sweeps.journal import Journal
from understudy_sweeps.loops import Executor, OuterLoop, Report, Trial, Work
from understudy_sweeps.page import Page
from understudy_sweeps.progress import Progress
from understudy_sweeps.results import METRICS, OBJECTIVE, SAMPLES, SECONDS, SUCCESS
from understudy_sweeps.trial import JUDGED, REFUSED, folder_of, note_stop, overrides_of
from understudy_training.processes import requested

__all__ = ["sweep"]

#: Overrides that are the sweep's own, not its trials'.
_OWN = re.compile(r"[+~]*(run\.dir|outer_loop|executor)\b")

#: Overrides that mean an option with dots in its name, and stand for nested ones.
_DOTTED = re.compile(
    r"\+*outer_loop\.(parameters|low|high)\.(\w+\.[\w.]*?\w)(?:\.(?:low|high|scale|integer))?="
)


def sweep(overrides: Sequence[str]) -> int:
    """Run the sweep that `overrides` describe; prints a table, its page and the sweep's folder.

    Returns
    -------
    status
        0, or 1 where no trial gave a result, or the loop could not do all that it was to do.

    Raises
    ------
    PreemptedError
        after a stop signal, when trials under way are saved.
    """
    experiment = _composed(overrides)
    if requested() > 1:
        raise ConfigError("A sweep starts its trials itself: start it without torchrun.")
    root, chosen = experiment.root, experiment.need("outer_loop")
    loop: OuterLoop = chosen.build(root.seed)
    if loop.plan and (seeds := [o for o in overrides if re.match(r"[+~]*seed=", o)]):
        raise ConfigError(
            f"{seeds[-1]} is overruled, since variants are trained with outer_loop.seeds. Write seeds=[{seeds[-1].partition('=')[2]}]."
        )
    compared = _compared(experiment, loop)
    identity = _identity(compared)
    given = tuple(o for o in overrides if not _OWN.match(o))
    folder = Path(root.run.dir or Path("runs") / f"sweep-{_slug(overrides)}{identity}")
    work = Work(given, str(folder), root.device)
    first = loop.plan or [chosen.build(root.seed).ask(0)]
    _check_ranges(loop.ranges, first[0], work, at(chosen.effective(), "fidelity.option"))
    known, devices = _check(first, work, loop)
    gpu = next((device for device in sorted(devices) if device.startswith("cuda")), root.device)
    work = dataclasses.replace(work, device=gpu)  # which a variant alone may ask for
    gpus = at(experiment.effective(), "executor.gpus")
    if gpus is not None and loop.plan and devices == {"cpu"}:
        raise ConfigError(
            f"executor.gpus={gpus} gives each trial a GPU, which none uses with device=cpu. Give device=cuda, or leave "
            "executor.gpus out."
        )
    _check_paper(chosen.effective().get("paper"), known)
    executor: Executor = experiment.need("executor").build(work)
    _refuse_other_things(folder)  # before the lock looks through all of it, as of /
    book = runs.Run(_made(folder), {})
    try:
        book.lock()
        _refuse_another(folder / "sweep.json", sorted(given), compared)
        journal = Journal.open(folder / "journal.jsonl")
        journal.move(work.folder)
        known = set(journal.finished)
        page = Page(folder, _title(overrides, folder), chosen.effective().get("paper"))
        with Progress({trial.key for trial in loop.plan}, loop.alike) as progress:
            _carry_out(_Talk(loop, journal, work), executor, page, progress)
        book.write_json("summary.json", loop.summary())
        page.write(journal, loop.summary(), film=True)
        with _one_thread():
            more = page.more(journal, experiment)
    except KeyboardInterrupt as stop:  # when no trial is under way
        raise _interrupted(f"Stopped by {stop}", folder) from None
    finally:
        executor.close()
        book.unlock()
    print(page.table(journal, loop.summary()))
    for key in [key for key in journal.finished if key not in known]:
        if (status := journal.finished[key].status) != "ok":
            tell(f"{key}: {status}")
    for path in (page.path, *more):
        if path.exists():  # why not, was said
            print(f"page: {path}")
    print(f"sweep: {folder}")
    if loop.missing:
        tell(f"Not done: {', '.join(loop.missing)}. The same command tries again.")
    reports = journal.finished.values()
    return int(bool(loop.missing) or (bool(reports) and all(r.status != "ok" for r in reports)))


@contextmanager
def _one_thread() -> Iterator[None]:
    """One torch thread, for the models of searches: they are so small that more would gain nothing, and
    idle ones would spin on the cores that trials need."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


class _Talk:
    """What an outer loop is asked and told, each thing once: a trial that is begun again after a
    crash, or since its run is gone, repeats reports, and is ended early again where it was before."""

    def __init__(self, loop: OuterLoop, journal: Journal, work: Work) -> None:
        self.loop, self.journal, self._work = loop, journal, work
        self._told: set[tuple[str, float]] = set()  #: intermediate reports: trial and samples
        self._stopped: dict[str, float] = {}  #: by trial: after how many samples
        self._number = 0
        self.again: set[str] = set()  #: trials made again, of which the journal has all already

    def replay(self) -> list[Trial]:
        """Tell the loop what the journal knows; the trials to go on with."""
        unfinished = []
        for event in self.journal.events:  # in the order in which it happened
            if isinstance(event, Report):
                self._tell(event)
            else:
                self._number += 1
                if self.loop.recall(event) and event.key not in self.journal.finished:
                    unfinished.append(event)
        return unfinished

    def ask(self) -> Trial | None:
        with _one_thread():
            trial = self.loop.ask(self._number)
        if trial is not None:
            self._number += 1
            self.journal.ask(trial)
        return trial

    def digest(self, report: Report) -> bool:
        """Whether the trial is to end early."""
        new = report.final or (report.key, report.cost) not in self._told
        if new and report.key not in self.again:
            self.journal.tell(report)
            self._tell(report)
        if report.final or report.cost < self._stopped.get(report.key, math.inf):
            return False  # of one that is made again, the loop had more to see
        note_stop(report.key, report.cost, self._work)
        return True

    def _tell(self, report: Report) -> None:
        answer = self.loop.tell(report)
        if not report.final:
            self._told.add((report.key, report.cost))
            if answer == "stop":
                self._stopped[report.key] = report.cost


def _carry_out(talk: _Talk, executor: Executor, page: Page, progress: Progress) -> None:
    """Go on with what is unfinished, then ask, run and tell until there is nothing to ask for."""
    journal, waiting, running = talk.journal, talk.replay(), 0
    page.write(journal, talk.loop.summary())
    with StopRequest() as stop:
        while True:
            while executor.free() > 0:
                trial = waiting.pop(0) if waiting else talk.ask()
                if trial is None:
                    break
                first = _first(trial, journal, page.folder)
                if first is not trial:  # its policy is gone: that one is trained again before
                    waiting.insert(0, trial)
                    if first.key in talk.again:  # already
                        break
                    talk.again.add(first.key)
                executor.start(_placed(first, journal, page.folder))
                running += 1
            progress.show(journal, talk.loop.share, running, talk.loop.summary())
            if running == 0:
                return
            report = _next(executor, stop, page.folder)
            if report.status.startswith(REFUSED):  # the journal has no result of it
                raise ConfigError(report.status.removeprefix(REFUSED))
            if talk.digest(report):
                executor.stop(report.key)
            if report.final:
                if report.key in talk.again and report.status != "ok":
                    raise RunError(
                        f"The run of trial '{report.key}', on which another builds, is gone, and it could not be trained "
                        f"again: {report.status}"
                    )
                running -= 1
                page.keep_up(journal, talk.loop.summary())


def _next(executor: Executor, stop: StopRequest, folder: Path) -> Report:
    """The next report, unless this process is told to stop."""
    while stop.received is None:
        try:
            report = executor.wait()
        except PreemptedError as error:  # a trial in this process took the signal
            raise _interrupted(str(error).partition(" after ")[0], folder) from error
        if report is not None:
            return report
    raise _interrupted(f"Stopped by {signal.Signals(stop.received).name}", folder)


def _interrupted(why: str, folder: Path) -> PreemptedError:
    return PreemptedError(
        f"{why}; finished trials, and the last checkpoints of the others, are in {folder}. Give the "
        "same command again to go on."
    )


def _composed(overrides: Sequence[str]) -> Experiment:
    """The sweep's own configuration."""
    try:
        return load_experiment(overrides, installed())
    except ConfigError as error:
        dotted = (_DOTTED.match(override) for override in overrides)
        if (found := next(filter(None, dotted), None)) and str(error).startswith("outer_loop."):
            group, name = found.groups()
            raise ConfigError(
                f"{error} A name that has dots itself is given in a mapping, as 'outer_loop.{group}={{{name}: …}}'."
            ) from error
        loops = [o for o in overrides if o.startswith(("search=", "ablation="))]
        other = [o for o in overrides if o.startswith("experiment=")]
        if not loops or not other:
            raise
        raise ConfigError(
            f"{error} {loops[-1]} chooses an experiment of its own and sets options of that, which "
            f"{other[-1]} may not have."
        ) from error


def _check(
    trials: Sequence[Trial | None], work: Work, loop: OuterLoop
) -> tuple[set[str], set[str]]:
    """Refuse a sweep of which a variant cannot be composed, or lacks what the `loop` needs of reports, before
    anything runs; the measures of all variants, none where a job may have some of its own, and their devices.
    Variants that differ in nothing are told of."""
    seen: set[str] = set()
    alike: dict[str, str] = {}
    devices: set[str] = set()
    found: list[set[str]] = []
    for trial in trials:
        if trial is None or (trial.variant or trial.key) in seen:
            continue
        seen.add(trial.variant or trial.key)
        later = "trial" in (trial.start or {})  # it begins with what an earlier one learns
        trial = dataclasses.replace(trial, start=None) if later else trial
        try:
            experiment = load_experiment(overrides_of(trial, work))
        except ConfigError as error:
            what = f"Variant '{trial.variant}'" if trial.variant else f"Trial '{trial.key}'"
            raise ConfigError(f"{what} cannot be run: {error}") from error
        devices.add(experiment.root.device)
        raw = {k: v for k, v in experiment.effective().items() if k not in ("run", "seed")}
        words = json.dumps(raw, sort_keys=True, default=str)
        first = trial.variant if later else alike.setdefault(words, trial.variant)
        if first != trial.variant:
            tell(
                f"Variants '{first}' and '{trial.variant}' are one: their configurations differ in nothing."
            )
        known = {c.name for c in experiment.many("measure")}
        found.append(known if experiment.one("job") is None else set())
        if loop.maximises:
            _check_objective(experiment)
        for name in loop.measures if known else ():  # else the job may have some of its own
            if name not in known | {"return", "success_rate"}:
                raise ConfigError(
                    f"outer_loop needs the measure '{name}', which trials have not got."
                    f"{suggestion(name, known)}"
                )
    return set().union(*found) if all(found) else set(), devices


_SEED = "and trials are to differ in what is searched, not by chance"
_PLACE = "which says where and how a trial runs, not what it learns"
_JUDGE = "which says how trials are judged, and those judged in other ways cannot be compared"
#: What a search cannot mean, as options of the configuration, and why.
_NOT_SEARCHED = {
    re.compile(r"seed$"): _SEED,
    re.compile(r"(device|run|checkpoint|simulator\.(device|threads))(\.|$)"): _PLACE,
    re.compile(r"evaluation\.(seconds|success|objective|starts|failures)(\.|$)"): _JUDGE,
}


def _check_ranges(
    ranges: Mapping[str, tuple[float, float]], trial: Trial | None, work: Work, fidelity: Any
) -> None:
    """Refuse a search over what a search cannot mean, other than as its `fidelity`, and one that goes beyond what an option can be: its trials there would fail one by one, and count as
    what the search found. An end that cannot be only together with values of the others is no such thing."""
    if trial is None:
        return
    trial = dataclasses.replace(trial, start=None)  # what it begins with may not be there yet
    for path in ranges:
        why = next((why for named, why in _NOT_SEARCHED.items() if named.match(path)), "")
        if why and path != fidelity:
            raise ConfigError(f"This search takes {path}, {why}. Leave it out of what is searched.")
    ends = [(path, end) for path, both in ranges.items() for end in both]
    if not any(
        _refused({path: both[i] for path, both in ranges.items()}, trial, work) for i in (0, 1)
    ):
        return
    for path, end in ends:
        said = _refused({path: end}, trial, work) or ""
        named = [
            other
            for other in ranges
            if re.search(rf"(?<![\w.]){re.escape(other)}(?!\w|\.\w)", said)
        ]
        if named == [path]:
            low, high = ranges[path]
            cure = "" if said.lower().endswith("leave it out.") else " Give it another range."
            raise ConfigError(
                f"This search takes {path} from {low:g} to {high:g}, and {said}{cure}"
            )


def _refused(point: Mapping[str, float], trial: Trial, work: Work) -> str | None:
    """Why the `trial` cannot be composed with these values in its point, or None if it can be."""
    try:
        experiment = load_experiment(
            overrides_of(dataclasses.replace(trial, point={**trial.point, **point}), work)
        )
    except ConfigError as error:
        return str(error)
    effective = experiment.effective()
    for path, value in point.items():
        if isinstance(at(effective, path), str):
            return f"{path}={value:g} is not possible: it takes a text, and a search chooses numbers. Leave it out."
    return None


def _check_objective(experiment: Experiment) -> None:
    """Refuse a search for the highest of what no trial has: it would rank nothing, and say so nowhere."""
    options = experiment.root.evaluation
    if (
        options.objective == SUCCESS
        and experiment.one("job") is None  # which may judge in its own way
        and success_of(experiment) is None
    ):
        known = ", ".join(sorted({"return", *(c.name for c in experiment.many("measure"))}))
        raise ConfigError(
            f"This search wants the highest evaluation.objective={SUCCESS}, and nothing in this task says whether an "
            f"episode succeeded. Set evaluation.objective to what is to be high ({known}), or say what a success is "
            "(evaluation.success={measure: NAME, at_least: NUMBER})."
        )


def _check_paper(paper: Mapping[str, Any] | None, measures: set[str]) -> None:
    """Refuse published numbers `of` what no table of variants that have `measures` shows."""
    of = (paper or {}).get("of", OBJECTIVE)
    known = {OBJECTIVE, SUCCESS, SAMPLES, SECONDS, *measures}
    if measures and of not in {*known, "return"} and not of.startswith(METRICS):
        raise ConfigError(
            f"outer_loop.paper.of={of} is no figure of these trials.{suggestion(of, known)}"
        )


def _first(trial: Trial, journal: Journal, folder: Path) -> Trial:
    """The trial; or the finished one that has to be trained again before, since it builds on a run that is gone, as where
    a journal alone was kept."""
    for earlier in _built_on(trial, journal, folder):
        if not (folder_of(earlier, folder) / JUDGED).exists():
            return _first(next(t for t in journal.asked if t.key == earlier), journal, folder)
    return trial


def _built_on(trial: Trial, journal: Journal, folder: Path) -> Iterator[str]:
    """The finished trials that `trial` takes something from: with whose policy it begins, or whose run folders its
    overrides name."""
    start = (trial.start or {}).get("trial")
    for key, report in journal.finished.items():
        run = re.escape(str(folder_of(key, folder)))
        named = re.compile(rf"(?<![\w./~-]){run}(?![\w.~%-])")
        if key == start or (
            report.status == "ok" and key != trial.key and any(map(named.search, trial.overrides))
        ):
            yield key


def _placed(trial: Trial, journal: Journal, folder: Path) -> Trial:
    """The trial, beginning from the run folder of the earlier trial that its ``start`` names."""
    start = dict(trial.start or {})
    earlier = start.pop("trial", None)
    if earlier is None:
        return trial
    if earlier not in journal.finished:
        raise RunError(f"Trial '{trial.key}' begins from '{earlier}', which is not finished.")
    return dataclasses.replace(trial, start={**start, "run": str(folder_of(earlier, folder))})


def _compared(experiment: Experiment, loop: OuterLoop) -> dict[str, Any]:
    """What the sweep compares: its configuration less what may be added to it later."""
    raw = experiment.effective()
    for key in ("run", "executor", *(["seed"] if loop.plan else [])):
        raw.pop(key)
    for name in loop.extendable:
        raw["outer_loop"].pop(name)
    return raw


def _identity(compared: Mapping[str, Any]) -> str:
    text = json.dumps(compared, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:8]


def _named(overrides: Sequence[str]) -> str | None:
    """What the command line calls it."""
    words = [o.lstrip("+").partition("=") for o in overrides]
    named = [value for key, _, value in words if key in ("ablation", "search", "experiment")]
    return named[0] if named else None


def _title(overrides: Sequence[str], folder: Path) -> str:
    return _named(overrides) or folder.name


def _slug(overrides: Sequence[str]) -> str:
    """Its name as the beginning of a folder's: two ablations of one experiment, whose variants may be
    added to, are not told apart by what they compare."""
    name = re.sub(r"[^A-Za-z0-9_]+", "-", _named(overrides) or "").strip("-")
    return f"{name}-" if name else ""


#: Of a sweep's folder: what makes it one that can go on; and what it would overwrite or be mixed with.
_OURS = ("sweep.json", "journal.jsonl")
_THEIRS = ("page.*", "film.mp4", "trials.csv", "table.csv", "summary.json", "[!.]*/*")


def _refuse_other_things(folder: Path) -> None:
    """Raise RunError if a sweep that begins in `folder` would lie in a run, or with other things."""
    try:
        place = Path(os.path.realpath(folder))
        for outer in (
            above for above in (place, *place.parents) if os.path.lexists(above / "run.json")
        ):
            where = "is" if outer == place else "is inside"
            raise RunError(f"{folder} {where} the run {outer}. Give run.dir a folder elsewhere.")
        if any(os.path.lexists(folder / name) for name in _OURS):
            return
        for left in (file for name in _THEIRS for file in folder.glob(name)):
            raise RunError(
                f"{folder} is not new: it holds {left.relative_to(folder)}, and no sweep. Give run.dir a folder that is "
                "new or empty, or a sweep's."
            )
    except OSError as error:
        raise RunError(f"The folder {folder} cannot be used: {error.strerror}.") from error


def _made(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunError(
            f"The folder {folder} cannot be made: {error.strerror}. Give run.dir another one."
        ) from error
    return folder


def _refuse_another(path: Path, given: Sequence[str], compared: Mapping[str, Any]) -> None:
    """A folder belongs to one sweep: its trials are known by their names alone.

    The same command goes on with a sweep that an earlier understudy began, where all that is new since
    are options, at their defaults.
    """
    mark = {"sweep": _identity(compared), "given": list(given), "compared": compared}
    mark = json.loads(json.dumps(mark, sort_keys=True, default=str))
    if path.exists():
        try:
            old = json.loads(read(path))
            same = old["sweep"] == mark["sweep"]
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            raise RunError(f"{path} is damaged: {error}. Give run.dir another folder.") from error
        grown = old.get("given") == mark["given"] and _grown(old.get("compared"), mark["compared"])
        if not same and not grown:
            changes = "; ".join(
                runs.differences(old.get("compared", mark["compared"]), mark["compared"])[:4]
            )
            raise RunError(
                f"{path.parent} holds another sweep{f' ({changes})' if changes else ''}. Give run.dir another "
                "folder, or repeat that one."
            )
    write_atomically(path, json.dumps(mark).encode())


def _grown(old: Any, new: Any) -> bool:
    """Whether `new` is `old` with more options, none of them another component."""
    if not isinstance(old, Mapping) or not isinstance(new, Mapping):
        return old == new
    added = [new[key] for key in new.keys() - old.keys()]
    return all(key in new and _grown(old[key], new[key]) for key in old) and not any(
        isinstance(value, Mapping) and "name" in value for value in added
    )
