"""What the command is asked to show: clips by file or name, and runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from understudy.errors import UnderstudyError
from understudy.records import runs
from understudy.setup.registry import Registry
from understudy_characters.character import Character
from understudy_characters.fitting import fitting_character
from understudy_characters.overlay import Gauge, Region
from understudy_characters.recording import chosen_character, recorded_clips, run_character
from understudy_motion.clip import Clip
from understudy_motion.readers.npz import Archive
from understudy_viewer.stage import Scene, Subject


def open_scene(
    sources: Sequence[str],
    registry: Registry,
    read: Callable[[str], Clip],
    character: str | None = None,
) -> Scene:
    """What one or two `sources` show: a run folder alone its learned motion beside its reference, with
    what its task draws over them; two sources each their own motion.

    Parameters
    ----------
    sources
        run folders, clip files, or names of clips.
    registry
        where characters and overlays are found.
    read
        opens a source that is no run folder.
    character
        what to draw the figures as; by default a run's own, or the one that fits the clip.

    Raises
    ------
    UnderstudyError
        a source is none, cannot be read, or is not a motion of the character.
    """
    chosen = None if character is None else chosen_character(character, registry)
    if len(sources) == 1 and Path(sources[0]).is_dir():
        return _run(Path(sources[0]), registry, chosen)
    return Scene([_subject(source, registry, read, chosen) for source in sources])


def _subject(
    source: str, registry: Registry, read: Callable[[str], Clip], chosen: Character | None
) -> Subject:
    path = Path(source)
    if path.is_dir():
        return _placed(recorded_clips(path)[0], chosen or run_character(path))
    clip = read(source)
    return _placed(clip, chosen or fitting_character(clip, registry))


def _placed(clip: Clip, character: Character | None) -> Subject:
    x, y = clip.root_position[0, :2].tolist()
    return Subject(clip, character, (x, y))


def _run(path: Path, registry: Registry, chosen: Character | None) -> Scene:
    own = run_character(path)
    learned, reference = recorded_clips(path)
    subjects = [replace(_placed(learned, chosen or own), role="learned")]
    if reference is not None:  # where it is from the learned motion is part of what is seen
        subjects.append(replace(subjects[0], clip=reference, role="reference"))
    tracks = _tracks(path, own, learned, reference)
    marks: list[Gauge | Region] = []
    notes = []
    for name in registry.names("overlay"):
        try:
            component = registry.find("overlay", name)
            with component.guarded("is left out"):
                overlay = component.call()
                marks.extend(overlay.marks(runs.open_run(path).config, tracks, registry))
        except UnderstudyError as error:  # the motion can be seen all the same
            notes.append(str(error))
    return Scene(subjects, marks, notes)


def _tracks(
    path: Path, character: Character, learned: Clip, reference: Clip | None
) -> dict[str, np.ndarray]:
    tracks = {"qpos": character.qpos(learned).numpy()}
    if reference is not None:
        tracks["reference_qpos"] = character.qpos(reference).numpy()
    archive = Archive(path / "recording.npz")
    if "phase" in archive.names:
        tracks["phase"] = archive.floats("phase", None)[: learned.num_frames]
    return tracks
