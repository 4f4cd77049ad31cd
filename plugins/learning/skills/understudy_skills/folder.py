"""The run folder of a skill, for commands that read one."""

from __future__ import annotations

import hashlib
import os
from dataclasses import replace
from pathlib import Path
from shlex import quote

from understudy.command.command import tell
from understudy.errors import RunError
from understudy.folders import read
from understudy.records import runs
from understudy.records.runs import Run
from understudy.running.training import Training
from understudy.setup.plugins import installed
from understudy.setup.registry import Registry
from understudy.setup.root import Root
from understudy_skills.as_run import unpack
from understudy_skills.pack import others_named
from understudy_skills.skill import open_skill
from understudy_training.watching import reporter

__all__ = ["MAKE_A_RUN", "run_folder"]

#: What gives a pack the clip that it names, for commands that take no overrides.
MAKE_A_RUN = (
    "make a run of it with yours, `understudy play SKILL {} --unpack FOLDER`, and name that"
)

#: Where skills are unpacked, in the working folder.
FOLDER = Path("runs") / "skills"
_SUFFIXES = (".json", ".safetensors")  #: of the two files of a packed skill


def run_folder(source: str, *, recorded: bool = False, registry: Registry | None = None) -> str:
    """The folder of the run `source`; of a skill's name or a packed file (.json) that of the skill, which is
    unpacked the first time, below ``runs/skills``, and found there again as long as the skill is the same.

    Anything else is returned as it is, for :func:`understudy.records.runs.open_run` to judge. With `recorded` an
    unpacked skill also gets a recording of one episode and what is drawn of it, as at a training's end. `registry` is
    that of the installed plugins unless given.

    Raises
    ------
    UnderstudyError
        nothing is named; or the skill is damaged, needs what is not here, or its folder cannot be written.
    """
    if not source:
        raise RunError("'' names no run, as of an empty variable. Name one, as runs/NAME.")
    registry = registry or installed().registry
    if Path(source).is_dir() or (packed := _packed(source, registry)) is None:
        return source
    digest = hashlib.sha256(b"".join(read(file) for file in _files(packed))).hexdigest()[:8]
    folder = FOLDER / f"{source.removesuffix('.json').replace(os.sep, '-').strip('-.')}-{digest}"
    if not (folder / "run.json").is_file():
        try:
            skill = open_skill(source, registry=registry)
            with others_named(skill, source, MAKE_A_RUN.replace("SKILL", quote(source))):
                unpack(skill, folder)
        except RunError:
            if not (folder / "run.json").is_file():  # else another process was first
                raise
        tell(f"{source} is unpacked as the run {folder}.")
    if recorded and not (folder / "recording.npz").is_file():
        tell(f"{folder} is recorded for the first time.")
        _record(runs.open_run(folder))
    return str(folder)


def _packed(source: str, registry: Registry) -> Path | None:
    """The path of the packed skill, without suffixes; None if it is none."""
    path = Path(source)
    if source in registry.names("skill"):
        return registry.find("skill", source).call()
    packed = path.suffix == ".json" and all(file.is_file() for file in _files(path))
    return path.with_suffix("") if packed else None


def _files(path: Path) -> list[Path]:
    return [path.with_name(f"{path.name.removesuffix('.json')}{s}") for s in _SUFFIXES]


def _record(run: Run) -> None:
    """Record and draw one episode of the policy of `run`; its evaluation stays."""
    experiment = run.experiment()
    root = experiment.root
    evaluation = replace(root.evaluation, episodes=1, final_episodes=1)
    training = Training(replace(experiment, root=replace(root, evaluation=evaluation)))
    try:
        training.load_learned(run.newest()[0])
        _, recording = training.judge(root.run.video_seconds or Root().run.video_seconds)
    finally:
        training.close()
    if recording is None:
        raise RunError(f"{run.path}: what it learned has no motion to record.")
    recording.save(run.path / "recording.npz")
    reporter().notify("judged", run, recording, tell)
