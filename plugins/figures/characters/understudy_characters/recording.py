"""The motion that a run's last evaluation recorded, as clips."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch

from understudy.errors import ConfigError, FileError
from understudy.records import runs
from understudy.records.runs import Run
from understudy.setup.building import build_scene
from understudy.setup.config import Experiment
from understudy.setup.registry import Registry
from understudy.task import Scene
from understudy_characters.character import Character, load_character
from understudy_characters.scene import CharacterScene, other_bodies
from understudy_motion.clip import Clip, Skeleton
from understudy_motion.limits import MAX_ROTATIONS
from understudy_motion.readers.npz import Archive
from understudy_motion.writing import Shown
from understudy_mujoco.scene import MujocoScene

__all__ = [
    "WITH_SURROUNDINGS",
    "check_frames",
    "chosen_character",
    "recorded_clips",
    "recorded_fields",
    "recorded_scene",
    "recorded_surroundings",
    "run_character",
    "unsimulated",
]

#: Endings of files that hold several motions, so that a run's surroundings go into them, too.
WITH_SURROUNDINGS = (".glb", ".gltf")


def run_character(path: str | Path) -> Character:
    """The character of the run folder `path`, as its own saved configuration describes it.

    Nothing is simulated, so the run's simulator need not be here, and the run's clip is not read.

    Raises
    ------
    RunError
        it is no run folder.
    ConfigError
        the configuration is not valid here (a plugin is missing, say), or its scene is
        no MuJoCo model of one character.
    """
    return _character(unsimulated(runs.open_run(path)))


def chosen_character(named: str, registry: Registry) -> Character:
    """The character that a command's ``--character`` names: that of a run folder, a registered one, or
    an MJCF or URDF file.

    Raises
    ------
    UnderstudyError
        as :func:`run_character` and :func:`understudy_characters.character.load_character`.
    """
    return run_character(named) if Path(named).is_dir() else load_character(named, registry)


def recorded_clips(path: str | Path) -> tuple[Clip, Clip | None]:
    """What the first recorded episode of the run folder `path` shows.

    Returns
    -------
    tuple[Clip, Clip | None]
        The learned motion, and its reference where the task has one. Neither loops. Licence, URL and
        attribution of both are those of the clip that the run learned from.

    Raises
    ------
    RunError, ConfigError
        as :func:`run_character`.
    FileError
        the run has no recording, or one that is damaged, does not fit its character, or
        ends before its second frame.
    """
    run = runs.open_run(path)
    file = run.path / "recording.npz"
    if not file.is_file():
        raise FileError(f"{run.path} has no recording (recording.npz); {_another(run.path)}.")
    character = _character(unsimulated(run))
    archive = Archive(file)
    control_dt, first_episode = archive.number("control_dt"), archive.number("first_episode")
    about = _about(run)

    def clip(recorded: np.ndarray, name: str) -> Clip:
        qpos = torch.from_numpy(recorded[: max(0, int(min(first_episode, len(recorded))))])
        if len(qpos) < 2:
            raise FileError(
                f"{file}: the recorded episode ended before its second frame; train on, then make "
                f"another recording with `understudy render {run.path}`."
            )
        times = control_dt * torch.arange(len(qpos), dtype=torch.float64)
        return character.clip(qpos, times, name=name, loop=False, **about)

    recorded = archive.floats("qpos", None, character.model.nq)
    learned = clip(recorded, run.path.resolve().name)
    if "phase" in archive.names:  # whoever wants it reads it
        _check_length(run, "phase", _track(archive, "phase"), len(recorded))
    if "reference_qpos" not in archive.names:
        return learned, None
    reference = archive.floats("reference_qpos", None, character.model.nq)
    _check_length(run, "reference_qpos", reference, len(recorded))
    return learned, clip(reference, f"{learned.name}-reference")


def _another(run: Path) -> str:
    """Where the run in this folder has a recording, of a `render` with words of its own, or how to make one."""
    rendered = sorted(run.glob("renders/*/recording.npz"))
    if rendered:
        return f"name one that was rendered by other words, such as {rendered[0].parent}"
    return f"make one with `understudy render {run}`"


def recorded_surroundings(path: str | Path) -> list[Shown]:
    """What stands around the character in the first recorded episode of the run folder `path`: each
    thing a motion of one joint, with the frames of :func:`recorded_clips`. In a MuJoCo scene of no
    character it is all that is drawn beside the body of :func:`run_character`.

    Raises
    ------
    RunError, ConfigError, FileError
        as :func:`recorded_clips`.
    """
    run = runs.open_run(path)
    scene = recorded_scene(run)
    if not isinstance(scene, MujocoScene):
        return []
    archive = Archive(run.path / "recording.npz")
    frames, dt = max(0, int(archive.number("first_episode"))), archive.number("control_dt")
    qpos = archive.floats("qpos", None, None)[:frames]
    tracks = {name: track[:frames] for name, track in recorded_fields(run, scene).items()}
    if isinstance(scene, CharacterScene):
        things = scene.surroundings({"qpos": qpos, **tracks})
    else:
        character = _character(unsimulated(run))
        if frames:
            scene.look(character.model, tracks, 0)
        things = other_bodies(character, qpos)
    found = []
    for thing in things:
        names = (thing.name,)
        clip = Clip(
            name=thing.name,
            times=dt * torch.arange(len(thing.positions), dtype=torch.float64),
            root_position=torch.from_numpy(thing.positions),
            rotations=torch.from_numpy(thing.rotations[:, None]),
            joint_names=names,
            loop=False,
            skeleton=Skeleton(names, (-1,), np.zeros((1, 3))),
            source=str(run.path),
        )
        found.append(Shown(clip, thing.shapes))
    return found


def recorded_scene(run: Run) -> Scene:
    """The scene of `run`, with what stands around its character, to show the recording in.

    Raises
    ------
    ConfigError
        the configuration is not valid here, as of :func:`run_character`.
    """
    experiment = unsimulated(run)
    made, inputs = experiment.registry.sections, experiment.inputs
    sections = {
        name: made[name].build.factory(options, experiment.registry, inputs)
        for name, options in experiment.sections.items()
        if name != "motion"  # its clip may not be there any more
    }
    scene = build_scene(experiment, sections).scene
    assert scene is not None
    return scene


def recorded_fields(run: Run, scene: Scene) -> dict[str, np.ndarray]:
    """What else than its motion and the reference the scene wants of the recording of `run`, as far as
    it is there: by field, each (T,) or (T, …), with all frames.

    Raises
    ------
    FileError
        one that is damaged, or has not the frames of ``qpos``.
    """
    archive = Archive(run.path / "recording.npz")
    frames = len(archive.floats("qpos", None, None))
    found = {}
    for name in archive.names.intersection(scene.recorded) - {"qpos", "reference_qpos", "phase"}:
        found[name] = _track(archive, name)
        _check_length(run, name, found[name], frames)
    return found


def _check_length(run: Run, name: str, track: np.ndarray, frames: int) -> None:
    if len(track) != frames:
        raise FileError(
            f"{run.path}: of '{name}' {len(track)} frames were recorded, of 'qpos' {frames}; make "
            f"another recording with `understudy render {run.path}`."
        )


def check_frames(clip: Clip, frames: float, cure: str, most: int = MAX_ROTATIONS) -> None:
    """Raise FileError where so many frames of `clip`, times its joints, are more than `most`; `cure`
    says what to do then."""
    if frames * len(clip.joint_names) > most:
        raise FileError(
            f"Clip {clip.source}: at this rate and length it has too many frames (times joints at "
            f"most {most}); {cure}."
        )


def _track(archive: Archive, name: str) -> np.ndarray:
    """(T,) or (T, …)"""
    try:
        return archive.floats(name, None, None)
    except FileError:
        return archive.floats(name, None)


def unsimulated(run: Run) -> Experiment:
    """The experiment of `run` without its simulator, which may be on another machine only.

    Raises
    ------
    ConfigError
        the rest of its configuration is not valid here.
    """
    config = {key: value for key, value in run.config.items() if key != "simulator"}
    return run.experiment(config=config)


def _character(experiment: Experiment) -> Character:
    scene, name = build_scene(experiment, {}).scene, experiment.need("scene").component.name
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
