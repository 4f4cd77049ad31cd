"""Evaluating a run again, and drawing it."""

from __future__ import annotations

import argparse
import contextlib
import copy
import hashlib
import json
import math
import re
import shutil
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from understudy.command.command import Command, tell
from understudy.errors import ConfigError, RunError, UnderstudyError
from understudy.folders import write_atomically
from understudy.records import checkpoint, runs
from understudy.records.runs import Run
from understudy.running.training import Reporter, Training
from understudy.setup.composition import compose_raw, replaced
from understudy.setup.root import Root
from understudy_judging.half_step import Finer, compared
from understudy_skills.folder import run_folder
from understudy_skills.words import refuse_of_trainings
from understudy_training.unread import noting, unread
from understudy_training.watching import observers
from understudy_training.workflow import judge

__all__ = ["load"]

#: Words for what one changes of an evaluation most often, and the keys that they stand for.
_EVALUATION = {"episodes": "evaluation.final_episodes", "seconds": "evaluation.seconds"}
_PICTURE = {
    "episodes": "evaluation.final_episodes",
    "seconds": "run.video_seconds",
    "size": "run.video_size",
    "camera": "run.video_camera",
}
#: How the value of such a word is written.
_FORMS = {
    "episodes": "N",
    "seconds": "S",
    "size": "WIDTHxHEIGHT",
    "camera": "DEGREES",
    "checkpoint": "ITERATION|last|best|SHARE",
    "half_step": "false",
}
#: What it does.
_MEANINGS = {
    "episodes": "how many are judged, in place of the run's own number",
    "seconds": "how long each lasts at most, or the video",
    "size": "of the video, pixels",
    "camera": "turned about the vertical: 0 from behind, 90 from the right, 180 from ahead",
    "checkpoint": "which one: the newest (last), that of the best evaluation, of an iteration, or after a SHARE of the "
    "training (0.5); without it the newest",
    "half_step": "leaves out the second judging, at half the time step of physics",
}
#: Keys that say where a run is judged, not what of it.
_WHERE = ("device", "num_worlds", "simulator.threads")
#: Of a run folder: where what was drawn otherwise is.
RENDERS = "renders"


class Evaluate(Command):
    """Judges the newest checkpoint on starts that no training drew, and again at half the time step of
    physics; writes ``evaluation.json`` and the page. With further words, the
    result has a file of its own, such as ``evaluation-episodes-4.json``."""

    example = "understudy evaluate runs/spacetime-walk-001 episodes=32 checkpoint=best"

    takes_overrides = True

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        _declare(parser, *_EVALUATION, "checkpoint", "half_step")

    def run(self, options: argparse.Namespace) -> int:
        words, half_step = _without_half_step(options.overrides)
        training, run, reporter, chosen = load(options.run, words, _EVALUATION)
        try:
            evaluation, _ = training.judge()
            episodes = training.experiment.root.evaluation.final_episodes
            job = training.job if half_step else None
            finer = job.evaluate_finer("final", episodes) if isinstance(job, Finer) else None
        finally:
            training.close()
        for note in unread(training.experiment, words):
            tell(note)
        changed = _changed(words, _EVALUATION)
        result = evaluation.as_json(training.progress.samples, changed)
        if finer is not None:
            result["half_step"] = compared(evaluation, *finer)
        name = _name(words, chosen)
        file = f"evaluation-{name}.json" if name else "evaluation.json"
        try:
            run.write_json(file, result)
        finally:  # also where the folder is somebody else's, or the disk is full
            print(json.dumps(result, indent=1))
        tell(f"Written to {run.path / file}." + (_KEPT if name else ""))
        if not name:
            reporter.observers = observers()
            reporter.notify("evaluated", run, tell)
        return 0


def _declare(parser: argparse.ArgumentParser, *words: str) -> None:
    """Add the argument ``run``, and a usage that names the `words` that may follow it."""
    forms = " ".join(f"[{word}={_FORMS[word]}]" for word in words)
    parser.usage = f"{parser.prog} RUN {forms} [KEY=VALUE …]"
    parser.add_argument("run", help="run folder, or a skill")
    lines = [
        textwrap.fill(f"{word}={_FORMS[word]}  {_MEANINGS[word]}", 80, subsequent_indent="  ")
        for word in words
    ]
    parser.description = "\n".join(["words that may follow RUN:", *lines])


def _without_half_step(words: Sequence[str]) -> tuple[list[str], bool]:
    """The other `words`, and whether half the time step is to be tried."""
    rest, wanted = [], True
    for word in words:
        key, _, value = word.partition("=")
        if key != "half_step":
            rest.append(word)
        elif value.lower() not in ("true", "false"):
            raise ConfigError(f"{word} is not possible: write half_step=false to leave it out.")
        else:
            wanted = value.lower() == "true"
    return rest, wanted


_KEPT = " The run's own result is as it was."


class Render(Command):
    """Judges the newest checkpoint while recording it, and makes the run's pictures and report anew. With
    further words, they have a folder of their own in ``RUN/renders``, which can be played and exported as a run."""

    example = "understudy render runs/spacetime-walk-001 seconds=12 size=960x540 camera=90"

    takes_overrides = True

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        _declare(parser, *_PICTURE, "checkpoint")

    def run(self, options: argparse.Namespace) -> int:
        training, run, reporter, chosen = load(options.run, options.overrides, _PICTURE)
        reporter.observers = observers()
        changed = _changed(options.overrides, _PICTURE)
        changed += [f"checkpoint={int(chosen)}"] if chosen else []
        name = _name(options.overrides, chosen)
        with contextlib.ExitStack() as undo, contextlib.closing(training):
            if name:
                if not (folder := run.path / RENDERS / name).exists():
                    undo.callback(_remove, folder)  # whole, or not at all
                run = _beside(run, name, chosen, options.overrides, training)
            judge(training, run, reporter, changed, _seconds(training, options.overrides))
            undo.pop_all()
        for note in unread(training.experiment, options.overrides):
            tell(note)
        if name:
            tell(f"This is in a folder of its own.{_KEPT}")
        print(f"run: {run.path}")
        return 0


def _seconds(training: Training, words: Sequence[str]) -> float:
    """The length of the film: the run's, unless the `words` set it; the default if the run had no film."""
    asked = any(word.partition("=")[0] in ("seconds", _PICTURE["seconds"]) for word in words)
    seconds = training.experiment.root.run.video_seconds
    return seconds if asked else seconds or Root().run.video_seconds


def _name(words: Sequence[str], chosen: str) -> str:
    """A name for files of what is judged as `words` say, the same for the same words; "" without words."""
    words = [f"checkpoint={int(chosen)}" if w.startswith("checkpoint=") else w for w in words]
    text = " ".join(sorted(words))
    plain = re.sub(r"[^A-Za-z0-9_.]+", "-", text).strip("-.")
    if plain == text.replace("=", "-").replace(" ", "-") and len(plain) < 80:
        return plain
    digest = hashlib.sha256(text.encode(errors="replace")).hexdigest()[:8]
    return f"{plain[:60]}-{digest}" if text else ""


def _beside(run: Run, name: str, chosen: str, words: Sequence[str], training: Training) -> Run:
    """A folder within that of `run` for what is drawn as `words` say, with all that is needed to play and export it:
    policy, inputs, metrics."""
    own = replace(run, path=run.path / RENDERS / name)
    state, meta = _checkpoint(run, chosen)[0] if chosen else run.newest()
    if "policy" in state:
        state = {key: state[key] for key in ("policy", "progress")}
    inputs = training.experiment.inputs
    overrides = [word for word in words if word.partition("=")[0] not in (*_PICTURE, "checkpoint")]
    info = {**run.info, "overrides": replaced(run.info["overrides"], overrides)}
    try:
        own.checkpoints.mkdir(parents=True, exist_ok=True)
        checkpoint.save(own.checkpoints / f"{state['progress']['iteration']:08d}", state, meta)
        for asked, names in inputs.kept.items():
            inputs.file(asked, list)  # all inside that folder, and whole
            for copied in names:
                target = own.path / "inputs" / copied
                target.parent.mkdir(parents=True, exist_ok=True)
                write_atomically(target, (inputs.folder / copied).read_bytes())
        info["inputs"] = inputs.copy(own.path / "inputs")
        own.write_json("run.json", info)
        if rows := run.metrics():
            write_atomically(own.metrics_file, "".join(json.dumps(r) + "\n" for r in rows).encode())
    except (OSError, UnderstudyError) as error:
        _remove_empty(own.path)
        if isinstance(error, UnderstudyError):
            raise
        raise RunError(f"{own.path} cannot be written: {error.strerror}.") from error
    return own


def _remove(folder: Path) -> None:
    """Remove `folder` with all that is in it, and the folder around it if nothing else is there."""
    shutil.rmtree(folder, ignore_errors=True)
    _remove_empty(folder)


def _remove_empty(folder: Path) -> None:
    """Remove `folder`, the folders in it and the folder around it, as far as they contain no files."""
    inside = sorted((p for p in folder.rglob("*") if p.is_dir()), reverse=True)
    for one in (*inside, folder, folder.parent):
        with contextlib.suppress(OSError):  # not empty, or not there
            one.rmdir()


def _changed(words: Sequence[str], short: Mapping[str, str]) -> list[str]:
    """The `words` of a command line that change the task that was trained."""
    aside = {*short, *short.values(), "checkpoint", *_WHERE}
    return [word for word in words if word.partition("=")[0] not in aside]


def load(
    path: str, words: Sequence[str], short: Mapping[str, str]
) -> tuple[Training, Run, Reporter, str]:
    """The run at `path`, or the skill of that name, with what it learned, as `words` of the command line change it; and the
    name of the checkpoint, if they choose one.

    Words are overrides; those of `short` set what the run recorded and nothing else.
    """
    beside = " What is judged otherwise lies in the run's folder."
    refuse_of_trainings(words, "a judgement", beside)
    run = runs.open_run(run_folder(path))
    given = {key: value for key, _, value in (word.partition("=") for word in words)}
    own = {key: given[key] for key in (*short, "checkpoint") if key in given}
    overrides = [word for word in words if word.partition("=")[0] not in own]
    config = copy.deepcopy(run.config)
    if overrides:
        config = compose_raw(run.words(overrides))
    chosen = own.pop("checkpoint", "")
    for key, value in own.items():
        _set(config, short[key], _value(key, value))
    if "episodes" in own:  # as many at once as there are
        most = config["evaluation"].get("episodes")
        asked = _value("episodes", own["episodes"])
        _set(config, "evaluation.episodes", min(most, asked) if type(most) is int else asked)
    experiment = noting(run.experiment(config=config))
    options = experiment.root.evaluation
    if "evaluation.episodes" in given and options.episodes < options.final_episodes:
        tell(
            f"evaluation.episodes={options.episodes} says how many run at once here, and {options.final_episodes} are "
            f"judged: episodes={options.episodes} judges as many in all."
        )
    run.info["config"] = experiment.effective()  # what is drawn; the file keeps what was trained
    reporter = Reporter(tell)
    if chosen:
        (state, _), chosen = _checkpoint(run, chosen)
    else:
        state, _ = run.newest(reporter.message)
        if run.metrics() and not state["progress"]["samples"]:
            raise RunError(
                f"{path} has no checkpoint yet but that before training. Wait for one (checkpoint.minutes), or resume it if "
                "nobody trains it."
            )
    training = Training(experiment, reporter)
    training.load_learned(state)
    return training, run, reporter, chosen


def _checkpoint(run: Run, chosen: str) -> tuple[tuple[Any, Any], str]:
    """The (state, meta) of the checkpoint `chosen`, and its name. It is the one after that iteration, the ``last``, the
    ``best`` by the evaluations in between, or the nearest to a share of the training (``0.5``, ``50%``)."""
    there = {path.name: path for path in checkpoint.newest(run.checkpoints)}
    kept = sorted(int(name) for name in there if name.isdigit())
    name = chosen.rpartition("/")[2].partition(".")[0]
    share = _share(chosen)
    if kept and chosen == "last":
        name = str(kept[-1])
    elif kept and chosen == "best":
        name = str(_best(run, kept))
    elif kept and share is not None:
        name = str(_nearest(kept, share))
        if name != str(round(share * kept[-1])):
            tell(
                f"checkpoint={chosen} is iteration {name} of {kept[-1]}, the nearest that is kept; "
                "checkpoint.keep=20 keeps more in a training."
            )
    name = name.zfill(8) if name.isdigit() else name
    if name not in there:
        raise RunError(
            f"{run.path} keeps no checkpoint={chosen}: there is {', '.join(map(str, kept)) or 'none'}; or "
            "write last, best, or a share of the training, as 0.5."
        )
    return checkpoint.load(there[name]), name


def _share(text: str) -> float | None:
    """The number that `text` stands for, if it is a share: ``0.5`` or ``50%``."""
    number, percent, rest = text.partition("%")
    if rest or not re.fullmatch(r"[0-9]*\.?[0-9]+", number) or not (percent or "." in number):
        return None
    share = float(number) / (100.0 if percent else 1.0)
    return share if share <= 1.0 else None


def _nearest(kept: Sequence[int], share: float) -> int:
    """The iteration with a checkpoint that is nearest to this `share` of the last; of two, the later."""
    return min(kept, key=lambda iteration: (abs(iteration - share * kept[-1]), -iteration))


def _best(run: Run, kept: Sequence[int]) -> int:
    """The iteration with a checkpoint that succeeded most, and of equal ones the last; by the returns of training episodes
    if nothing was evaluated."""
    for figure in ("evaluation/success_rate", "episode/return"):
        found: dict[int, float] = {}
        for row in run.metrics():
            value = row.get(figure, row.get(f"{figure}_at_most"))
            if isinstance(value, int | float) and math.isfinite(value):
                judged = row.get("iteration")
                later = [i for i in kept if isinstance(judged, int) and i >= judged]
                if later:  # what it was judged on is in the next one that is kept
                    found[min(later)] = float(value)
        if found:
            return max(found, key=lambda iteration: (found[iteration], iteration))
    return kept[-1]


def _value(key: str, text: str) -> Any:
    if key == "size":
        width, _, height = text.partition("x")
        if not (width.isdigit() and height.isdigit()):
            raise ConfigError(
                f"size={text} is not possible. Write size=WIDTHxHEIGHT, as size=640x360."
            )
        return [int(width), int(height)]
    try:
        value = float(text)  # 010 is ten, as whoever types it has it, and 1e3 a thousand
    except ValueError as error:
        raise ConfigError(f"{key}={text} is not possible: it takes a number.") from error
    if key == "episodes" and not (value.is_integer() and value >= 1):
        raise ConfigError(f"episodes={text} is not possible: it takes a whole number from 1.")
    return int(value) if value.is_integer() else value


def _set(config: dict[str, Any], path: str, value: Any) -> None:
    group, _, key = path.partition(".")
    before = config.get(group) or {}
    if not isinstance(before, Mapping):
        raise RunError(f"The run's configuration is damaged: its '{group}' is no mapping.")
    config[group] = {**before, key: value}
