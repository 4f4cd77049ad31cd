"""A skill as a run folder, whole or as what another run keeps of it."""

from __future__ import annotations

import json
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

from understudy.errors import RunError
from understudy.folders import write_atomically
from understudy.inputs import Inputs
from understudy.records import checkpoint, runs
from understudy.running.training import Progress
from understudy_skills.skill import Skill, words_of

__all__ = ["copy_run", "unpack"]


def unpack(skill: Skill, path: Path) -> None:
    """Write `skill` as the run folder `path`, which serves wherever a run does: to begin another training
    (``start.run``), as a controller inside another task (``actuation.runs``), for a harvest (``job.run``).

    A packed skill has no critic, so it gets a new one; it has no optimiser and no worlds, which ``start.run`` does not need.

    Raises
    ------
    ConfigError
        if the skill was packed without the overrides that made it.
    RunError
        if the folder holds a run already or cannot be written, or the overrides are no words.
    """
    if (path / "run.json").exists():
        raise RunError(f"{path} already holds a run. Give another folder.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        beside = path.parent / Path(tempfile.mkdtemp(prefix=".", dir=path.parent)).name
    except OSError as error:
        raise RunError(f"The run folder {path} cannot be made: {error.strerror}.") from error
    try:  # beside it, and moved there: it is there as a whole or not at all
        try:
            _make(skill, beside / "run")
        except RunError as error:  # which names what nobody typed
            raise RunError(str(error).replace(str(beside / "run"), str(path))) from error
        text = (beside / "run" / "run.json").read_text(encoding="utf-8")
        own = text.replace(f"{beside.name}/run", json.dumps(path.name)[1:-1])
        write_atomically(beside / "run" / "run.json", own.encode())
        try:
            (beside / "run").rename(path)
        except OSError as error:
            raise RunError(
                f"The run folder {path} cannot be made: {error.strerror}. Give another folder."
            ) from error
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def _make(skill: Skill, path: Path) -> None:
    """Write `skill` as the new run folder `path`."""
    overrides = words_of(skill.card, skill.name)
    root = skill.experiment.root
    experiment = replace(skill.experiment, root=replace(root, run=replace(root.run, dir=str(path))))
    policy, sources = skill.whole(), skill.card.get("sources") or {}
    run = runs.create(experiment, [*overrides, f"run.dir={path}"], sources)
    try:
        if skill.card.get("licence"):  # what a run's copies would say of themselves
            run.write_json("run.json", {**run.info, "licence": skill.card["licence"]})
        progress = Progress(samples=skill.samples, evaluated_at=skill.samples).state_dict()
        state = {"policy": policy, "progress": progress}
        meta = {"versions": skill.card.get("versions"), "sources": sources}
        checkpoint.save(run.checkpoints / "00000001", state, meta)
        run.write_json("evaluation.json", skill.card.get("evaluation") or {})
    finally:
        run.unlock()


def copy_run(source: str, folder: Path) -> None:
    """Write into `folder` what a skill needs of the run folder `source`: its ``run.json``, only the policy of its newest
    checkpoint, and the copies of what its parts read.

    Raises
    ------
    RunError
        one of these copies is not what the run was made with.
    """
    run = runs.open_run(source)
    state, meta = run.newest()
    (folder / "checkpoints").mkdir(parents=True)
    kept = {"policy": state["policy"], "progress": {"samples": state["progress"]["samples"]}}
    checkpoint.save(folder / "checkpoints" / "00000001", kept, meta)
    (folder / "run.json").write_bytes((run.path / "run.json").read_bytes())
    inputs = Inputs(run.path / "inputs", dict(run.info.get("inputs", {})))
    for asked, names in inputs.kept.items():
        inputs.file(asked, list)  # all inside that folder, and whole
        for name in names:
            (folder / "inputs" / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / "inputs" / name).write_bytes((inputs.folder / name).read_bytes())
