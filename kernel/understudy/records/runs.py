"""Run folders: everything needed to resume, compare and render a training again.

::

    run.json           composed config, overrides, versions, seed, sources and licences
    inputs/            copies of the files that its parts read
    metrics.jsonl      one row an iteration
    checkpoints/       see :mod:`understudy.records.checkpoint`
    faults/            what led to the first numerical failure, to be replayed
    evaluation.json    the last evaluation
    recording.npz      see :mod:`understudy.records.recording`

Run observers leave their own files beside these.
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import json
import math
import os
import platform
import re
import shutil
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Any

from understudy.errors import RunError
from understudy.folders import UNSUPPORTED, check_within, open_lock, opened, read, write_atomically
from understudy.inputs import Inputs
from understudy.options import at
from understudy.setup import plugins
from understudy.setup.config import Experiment
from understudy.setup.registry import Registry
from understudy.setup.validation import refuse_code, validate
from understudy.task import State

__all__ = [
    "Run",
    "cores",
    "create",
    "differences",
    "newest_state",
    "open_run",
    "refuse_a_second",
    "versions",
]

LAYOUT = 3  #: version of the folder's layout
_METRICS, _ROW = 2**30, 2**20  #: most bytes of the metrics file, and of one of its rows
#: What a new run's folder must not contain.
_LEFT = ("metrics.jsonl", "evaluation*.json", "*.npz", "*.html", "*.mp4", "[!.]*/*")
VERSIONED = ("understudy", "torch", "numpy", "mujoco", "hydra-core", "mujoco-warp", "warp-lang")


def cores() -> int:
    """How many processor cores this process may use."""
    asked = getattr(os, "sched_getaffinity", None)  # macOS cannot be asked
    return len(asked(0)) if asked else os.cpu_count() or 1


@functools.cache
def versions() -> dict[str, str]:
    """Versions of Python and of the libraries that results depend on."""
    found = {"python": platform.python_version()}
    for name in VERSIONED:
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


@dataclass
class Run:
    """An open run folder. A lock file sees to it that at most one process trains in it."""

    path: Path
    info: dict[str, Any]
    _registry: Registry | None = None
    _lock: Any = None

    @property
    def registry(self) -> Registry:
        """Where its parts are found: where it was composed from, else the installed plugins."""
        return self._registry or plugins.installed().registry

    @property
    def checkpoints(self) -> Path:
        return self.path / "checkpoints"

    @property
    def metrics_file(self) -> Path:
        return self.path / "metrics.jsonl"

    @property
    def config(self) -> dict[str, Any]:
        return self.info["config"]

    def experiment(
        self, registry: Registry | None = None, config: Mapping[str, Any] | None = None
    ) -> Experiment:
        """Its configuration, or `config`, validated; parts read the run's own copies of files."""
        inputs = Inputs(self.path / "inputs", dict(self.info.get("inputs", {})))
        return replace(validate(config or self.config, registry or self.registry), inputs=inputs)

    def lock(self) -> None:
        """Hold the folder for this process; a RunError if another does, or a link leads out."""
        try:
            check_within(self.path)
            self._lock = open_lock(self.path / ".lock")  # held until the run ends
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise RunError(
                f"Another process is training in {self.path}. Wait for it, or give run.dir another folder."
            ) from error
        except OSError as error:
            if error.errno not in UNSUPPORTED:
                raise RunError(f"{self.path} cannot be written: {error.strerror}.") from error
            text = f"The file system of {self.path} has no locks: start no second training in it."
            print(text, file=sys.stderr)

    def check_held(self) -> None:
        """Called before writing into the folder: a RunError if it is not the one that :meth:`lock`
        holds any more, because it was removed or replaced."""
        if self._lock is None:
            return
        held = False
        with contextlib.suppress(OSError):
            held = os.path.samestat(os.fstat(self._lock.fileno()), os.lstat(self.path / ".lock"))
        if not held:
            raise RunError(
                f"{self.path} was removed or replaced while a process trained in it, so nothing more is "
                "written there. Put the folder back and resume it, or train anew."
            )

    def unlock(self) -> None:
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def write_json(self, name: str, value: Any) -> None:
        self.check_held()
        write_atomically(self.path / name, (json.dumps(value, indent=1) + "\n").encode())

    def words(self, more: Sequence[str]) -> list[str]:
        """The overrides that made it, then `more`, to be composed; a ConfigError if one of its own
        would be filled in from this machine."""
        # Imported here, since Hydra takes time.
        from understudy.setup.composition import refuse_resolvers, replaced

        words = replaced(self.info["overrides"], more)
        refuse_resolvers(words[: len(words) - len(more)], f"{self.path}")
        return words

    def judged(self) -> int | None:
        """The samples after which it was judged and its pictures were made; None before that."""
        return self.info.get("judged")

    def newest(
        self, warn: Callable[[str], None] = lambda text: print(text, file=sys.stderr)
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """``(state, meta)`` of the newest intact checkpoint, a RunError if none is; `warn` hears of damaged ones."""
        from understudy.records import checkpoint  # without tensors, torch is not imported

        state, meta, path = checkpoint.load_newest(self.checkpoints, warn)
        samples = at(state, "progress.samples")
        if type(samples) is not int or not 0 <= samples < 2**63:
            raise RunError(f"{path} is damaged: it does not say after how many samples it is.")
        if samples == 0 and path != checkpoint.newest(self.checkpoints)[0]:
            raise RunError(f"{self.path}: only the checkpoint before training is intact; resume.")
        return state, meta

    def metrics(self) -> list[dict[str, Any]]:
        """The rows of the metrics file, without one that a crash cut short. A RunError if it is no
        file, or larger than any training makes it."""
        rows = []
        try:
            with contextlib.suppress(FileNotFoundError), opened(self.metrics_file, _METRICS) as f:
                while line := f.readline(_ROW):
                    with contextlib.suppress(ValueError, RecursionError):
                        rows.append(json.loads(line.decode(errors="replace")))
        except OSError as error:
            raise RunError(f"{self.metrics_file} cannot be read: {error.strerror}.") from error
        return [row for row in rows if isinstance(row, dict)]

    def keep_metrics_until(self, iteration: int) -> None:
        """Drop the rows after `iteration`, which the resumed training writes again."""
        self.check_held()
        rows = [(row, row.get("iteration")) for row in self.metrics()]
        kept = [row for row, at in rows if not isinstance(at, int) or at <= iteration]
        write_atomically(self.metrics_file, "".join(json.dumps(r) + "\n" for r in kept).encode())

    def append_metrics(self, row: Mapping[str, Any]) -> None:
        self.check_held()
        try:
            with open(self.metrics_file, "a", encoding="utf-8") as file:
                wrong = [k for k, v in row.items() if isinstance(v, float) and not math.isfinite(v)]
                file.write(json.dumps({**row, **dict.fromkeys(wrong)}) + "\n")  # JSON has no NaN
        except OSError as error:
            raise RunError(
                f"{self.metrics_file} could not be written: {error.strerror}. "
                "The last checkpoint is intact; `understudy resume` continues from it."
            ) from error


def create(experiment: Experiment, overrides: Sequence[str], sources: Mapping[str, Any]) -> Run:
    """Make the run folder of a new training; a RunError if it has a run or cannot be written."""
    import torch

    root = experiment.root
    named = [o.partition("=")[2] for o in overrides if o.lstrip("+").startswith("experiment=")]
    used = {(c.kind, c.name): c for c in experiment.components()}
    cited, registry = {c.plugin for c in used.values()}, experiment.registry
    facts = ("kind", "name", "plugin", "distribution", "version")
    threads = torch.get_num_threads()
    info = {
        "layout": LAYOUT,
        "config": experiment.effective(),
        "overrides": list(overrides),
        "created": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "versions": versions(),
        "machine": {"system": platform.platform(), "cores": cores(), "threads": threads},
        "command": [Path(sys.argv[0]).name, *sys.argv[1:]],
        "components": [{f: getattr(c, f) for f in facts} for _, c in sorted(used.items())],
        "sources": dict(sources),
        "citations": [c.summary for c in registry.citations.values() if c.plugin in cited],
    }
    with contextlib.ExitStack() as undo:
        try:
            path = Path(root.run.dir or _free_folder([root.task or "run", *named][-1]))
            refuse_a_second(path)  # before `lock` looks through all of it, which may be /
            path.mkdir(parents=True, exist_ok=True)
            run = Run(path, info, registry)
            run.lock()
            refuse_a_second(path)  # one that another process has just made
            if os.listdir(path) == [".lock"]:  # the folder is left whole, or not at all
                undo.callback(shutil.rmtree, path, ignore_errors=True)
            for folder in ("checkpoints", "faults"):
                (path / folder).mkdir(exist_ok=True)
            info["inputs"] = experiment.inputs.copy(path / "inputs")
        except (OSError, RecursionError) as error:  # of too many folders in one another
            why = f"cannot be made: {getattr(error, 'strerror', 'too deep')}. Give run.dir another one."
            raise RunError(f"The run folder {root.run.dir or 'runs'!s:.200} {why}") from error
        run.write_json("run.json", info)
        undo.pop_all()
    return run


def refuse_a_second(path: Path) -> None:
    """Raise RunError if a new run in `path` would overwrite what is there, or be taken for it."""
    if (path / "run.json").exists():
        raise RunError(
            f"{path} already holds a run. Continue it with `understudy resume {path}`, or give "
            "run.dir another folder."
        )
    above = Path(os.path.realpath(path)).parents
    for outer in (folder for folder in above if os.path.lexists(folder / "run.json")):
        raise RunError(f"{path} is inside the run {outer}. Give run.dir a folder elsewhere.")
    for left in (file for name in _LEFT for file in path.glob(name)):
        if left.parent.name != "inputs":  # copies of files, from a run that was killed as it began
            text = f"{path} is not new: it holds {left.relative_to(path)}, as of another run."
            raise RunError(f"{text} Give run.dir a folder that is new or empty.")


def _free_folder(name: str) -> Path:
    """A new folder with the next free number, made at once so that nobody else takes it."""
    stem = re.sub(r"[^A-Za-z0-9]+", "-", name).strip("-")
    Path("runs").mkdir(exist_ok=True)
    for number in range(1, 100_000):
        path = Path("runs") / f"{stem}-{number:03d}"
        with contextlib.suppress(FileExistsError):
            path.mkdir()
            return path
    raise RunError("The folder runs/ is full of runs of this task. Give run.dir a folder.")


def open_run(path: str | Path) -> Run:
    """Open a run folder; a RunError if it is none, damaged, has links out, or is another version's."""
    path = Path(path)
    file = path / "run.json"
    if not os.path.lexists(file):
        one = min(path.glob("*/run.json"), default=Path("runs/NAME/run.json")).parent  # of a sweep
        raise RunError(f"{path} is no run folder: it has no run.json. Name one, as {one}.")
    check_within(path)
    try:
        info = json.loads(read(file))
        if not (isinstance(info, dict) and {"layout", "config"} <= info.keys()):
            raise ValueError("it does not say what was trained")
        refuse_code(info["config"])
        if not isinstance(info["config"], dict):
            raise ValueError("its config is no mapping")
        if not {"overrides", "sources"} <= info.keys():
            raise ValueError("it lacks overrides or sources")
        json.dumps([info["config"], info["sources"]], allow_nan=False)  # as in checkpoints
        words = info["overrides"]
        if not (isinstance(words, list) and all(isinstance(word, str) for word in words)):
            raise ValueError("its overrides are no words")
        for names in info.get("inputs", {}).values():
            if not names or not all(isinstance(n, str) for n in (*names, *names.values())):
                raise ValueError("its inputs are no names and digests")
    except OSError as error:
        raise RunError(f"{file} cannot be read: {error.strerror}.") from error
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise RunError(f"{file} is damaged: {error}.") from error
    if (layout := info["layout"]) != LAYOUT:
        who, what = "a newer understudy", "Install that version or a newer one."
        if isinstance(layout, int) and layout < LAYOUT:
            who = "an older understudy, whose tasks and states mean other things"
            what = "Use that version for it, or train anew."
        raise RunError(
            f"{path} was written by {who} (layout {layout}; this one reads {LAYOUT}). {what}"
        )
    return Run(path, info)


def newest_state(path: str) -> State:
    """The state of the newest intact checkpoint of the run folder `path`."""
    return open_run(path).newest()[0]


def differences(old: Any, new: Any, where: str = "") -> list[str]:
    """The key paths at which two nested configurations differ, with both values."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        return [
            difference
            for key in sorted({*old, *new}, key=str)
            for difference in differences(old.get(key), new.get(key), f"{where}.{key}".lstrip("."))
        ]
    return [] if old == new else [f"{where}: {old!r} → {new!r}"]
