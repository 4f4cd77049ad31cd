"""The motion that a run's last evaluation recorded, as clips."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from understudy.errors import ConfigError, FileError
from understudy.records import runs
from understudy.records.runs import Run
from understudy.setup.config import Experiment
from understudy.setup.plugins import installed
from understudy.task import Context
from understudy_characters.character import Character
from understudy_characters.scene import CharacterScene
from understudy_motion.clip import Clip
from understudy_motion.readers.npz import Archive
from understudy_mujoco.scene import MujocoScene


def run_character(path: str | Path) -> Character:
    """The character of the run folder `path`, as its own saved configuration describes it.

    Nothing is simulated, and the run's clip is not read.

    Raises:
        RunError: it is no run folder.
        ConfigError: the configuration is not valid here (a plugin is missing, say), or its scene is
            no MuJoCo model of one character.
    """
    return _character(_experiment(runs.open_run(path)))


def recorded_clips(path: str | Path) -> tuple[Clip, Clip | None]:
    """What the first recorded episode of the run folder `path` shows.

    Returns:
        The learned motion, and its reference where the task has one. Neither loops. Licence, URL and
        attribution of both are those of the clip that the run learned from.

    Raises:
        RunError, ConfigError: as :func:`run_character`.
        FileError: the run has no recording, or one that is damaged, does not fit its character, or
            ends before its second frame.
    """
    run = runs.open_run(path)
    file = run.path / "recording.npz"
    if not file.is_file():
        raise FileError(
            f"{run.path} has no recording (recording.npz); make one with `understudy render {run.path}`."
        )
    character = _character(_experiment(run))
    archive = Archive(file)
    control_dt, first_episode = archive.number("control_dt"), archive.number("first_episode")
    about = _about(run)

    def clip(track: str, name: str) -> Clip:
        recorded = archive.floats(track, None, character.model.nq)
        qpos = torch.from_numpy(recorded[: max(0, int(min(first_episode, len(recorded))))])
        if len(qpos) < 2:
            raise FileError(
                f"{file}: the recorded episode ended before its second frame; train on, then make "
                f"another recording with `understudy render {run.path}`."
            )
        times = control_dt * torch.arange(len(qpos), dtype=torch.float64)
        return character.clip(qpos, times, name=name, loop=False, **about)

    learned = clip("qpos", run.path.resolve().name)
    if "reference_qpos" not in archive.names:
        return learned, None
    return learned, clip("reference_qpos", f"{learned.name}-reference")


def _experiment(run: Run) -> Experiment:
    return run.experiment(installed().registry)


def _character(experiment: Experiment) -> Character:
    control = experiment.root.control
    context = Context(
        seed=0,
        device=torch.device("cpu"),
        num_worlds=1,
        control_dt=1.0 / control.frequency,
        substeps=control.substeps,
        inputs=experiment.inputs,
    )
    chosen = experiment.need("scene")
    scene, name = chosen.build(context), chosen.component.name
    if not isinstance(scene, MujocoScene):
        raise ConfigError(f"The run's scene '{name}' is no MuJoCo model, so it has no character.")
    if isinstance(scene, CharacterScene):
        name = scene.character.name
    return Character(name, scene.shown().compile())


def _about(run: Run) -> dict[str, str]:
    """Where the run's motion comes from: fields of :class:`Clip`, from what ``run.json`` recorded."""
    sources: Any = run.info["sources"]
    motion = sources.get("motion") if isinstance(sources, dict) else None
    recorded = motion if isinstance(motion, dict) else {}
    texts = {
        key: recorded[key]
        for key in ("licence", "url", "attribution")
        if isinstance(recorded.get(key), str)
    }
    return {"source": str(run.path), **texts}
