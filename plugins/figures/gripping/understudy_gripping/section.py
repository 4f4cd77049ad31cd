"""The config section ``grip``: one grip, or several that share one job; those that are asked for by style are found, and kept in the run."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import torch

from understudy.errors import ConfigError, FileError, RunError, suggestion
from understudy.folders import read, write_atomically
from understudy.inputs import Inputs
from understudy.options import check_range
from understudy.setup.registry import Registry
from understudy_gripping.finding import find_grip
from understudy_gripping.grip import LARGEST, TOOLS, Grip, load_grip
from understudy_gripping.holding import holding
from understudy_gripping.pose import Candidate
from understudy_gripping.styles import Style, check_style, read_style, written
from understudy_hand.scene import HandScene
from understudy_hand.table import FEWEST, FINGERS, Measures
from understudy_hand.tools import HALF_LENGTH

__all__ = ["NONE_HOLDS", "Grips"]

#: m between fingers that may be asked for, at most: knuckles of a human hand are 1 to 2 mm apart.
MOST_CLEARANCE = 0.002
#: The name of a grip that has the job for itself.
_ONLY = "grip"
#: How the sentence begins that refuses a job of candidates none of which can begin.
NONE_HOLDS = "No candidate holds the sticks."
#: In the folder of a run, beside the grips that were found for it: what is against the others.
_AGAINST = "against.txt"


@dataclass
class Grips:
    """What the config section ``grip`` gives: one grip, or several that share one job."""

    by_name: Mapping[str, Grip] = field(default_factory=dict)
    #: Those that are none, and what is against each.
    against: Mapping[str, str] = field(default_factory=dict)
    #: Finds them once the hand is known, where they are asked for by style.
    find: Callable[[HandScene], Grips] | None = None
    #: Whether a job has begun with these, so that none can be left out any more: its policy sees whose world it is.
    begun: bool = False

    @property
    def are_candidates(self) -> bool:
        """Whether they were asked for by name to share a job; that one is left of them changes nothing."""
        return tuple(self.by_name) != (_ONLY,) or bool(self.against)

    def in_hand(self, scene: HandScene) -> Grips:
        """These, which are found now if they were not yet.

        Raises
        ------
        ConfigError
            none holds the sticks, or they are for another hand than that of `scene`.
        """
        if self.find is not None:
            with torch.inference_mode(False), torch.enable_grad():  # whoever only plays needs none
                found = self.find(scene)
            self.by_name, self.against, self.find = found.by_name, found.against, None
        return self

    def leave_out(self, against: Mapping[str, str]) -> None:
        """Go on without those candidates, each with what is `against` it; the others are not touched.

        Raises
        ------
        ConfigError
            none is left, or they cannot be left out: a grip that has the job for itself, or a job that has begun.
        """
        if not against:
            return
        if self.begun or not self.are_candidates:
            raise ConfigError(next(iter(against.values())))
        self.against = {**self.against, **against}
        self.by_name = {n: grip for n, grip in self.by_name.items() if n not in against}
        self._need_one()

    def _need_one(self) -> None:
        if not self.by_name:
            raise ConfigError(f"{NONE_HOLDS} {next(iter(self.against.values()))}")


@dataclass(frozen=True)
class CandidateOptions:
    #: by digits from the thumb on
    style: str
    #: m along the sticks from their middle, by finger that touches; null is a first guess
    places: Mapping[str, float] | None = None

    def __post_init__(self) -> None:
        check_range(self, "places", least=-1e3, most=1e3)


@dataclass(frozen=True)
class GripOptions:
    name: str = "standard"  #: a grip that comes with a plugin
    file: str | None = None  #: path of another one; wins over ``name``
    #: A style, by digits from the thumb on: its grip in a human hand is found as the task is built, in some seconds; wins
    #: over both.
    style: str | None = None
    #: m along the sticks from their middle, by finger that touches, of the grip that is found; null is a first guess.
    places: Mapping[str, float] | None = None
    #: Several grips that share the job, by name, each in worlds of its own; those that cannot be have no world. Wins
    #: over all others.
    candidates: Mapping[str, CandidateOptions] = field(default_factory=dict)
    #: m that links of different fingers, and of fingers and palm, keep from one another in the poses of grips that are found;
    #: null lets them lie in one another, as the thesis' search does.
    finger_clearance: float | None = None

    def __post_init__(self) -> None:
        check_range(self, "finger_clearance", least=0, most=MOST_CLEARANCE)
        check_range(self, "places", least=-1e3, most=1e3)
        if self.places is not None and self.style is None:
            raise ValueError("places need a style: set style, such as 11120.")
        for name in self.candidates:
            if not name.isidentifier():
                raise ValueError(f"candidates names '{name}', which is no name of a field.")


def build_grips(options: GripOptions, registry: Registry, inputs: Inputs) -> Grips:
    """The config section ``grip``."""
    if options.candidates:
        return _found(options.candidates, inputs, options.finger_clearance)
    if options.style is not None:
        only = CandidateOptions(options.style, options.places)
        return _found({_ONLY: only}, inputs, options.finger_clearance)
    if options.finger_clearance is not None:
        raise ConfigError(
            "grip.finger_clearance is of grips that are found, and this one is there already. Set grip.style, such as "
            "11120, or leave it out."
        )
    if (given := options.file) is not None:
        path = inputs.file(f"grip.file={given}", lambda: [Path(given)])
    else:
        known = registry.names("grip")
        if options.name not in known:
            raise ConfigError(
                f"There is no grip '{options.name}'.{suggestion(options.name, known)}"
            )
        path = registry.find("grip", options.name).call()
    return Grips({_ONLY: load_grip(path)})


def _candidate(options: CandidateOptions) -> Candidate:
    """Of a human hand of as many fingers as its style has."""
    text = options.style
    fingers = len(text) if text.isdigit() else len(FINGERS)
    if not FEWEST <= fingers <= len(FINGERS):
        read_style(text, len(FINGERS))  # which says why not
    style = read_style(text, fingers)
    touching = [f for f, stick in zip(FINGERS, style, strict=False) if stick]
    guess = dict(zip(touching, holding("sticks").first_guess(style), strict=True))
    chosen = guess if options.places is None else options.places
    if set(chosen) != set(touching):
        raise ConfigError(
            f"grip.places of the style {written(style)} are those of {', '.join(touching)}, and not of "
            f"{', '.join(chosen) or 'none'}."
        )
    for finger, place in chosen.items():
        if not abs(place) <= HALF_LENGTH:
            raise ConfigError(
                f"grip.places.{finger}={place:g} is not on a stick: give m from its middle, at most "
                f"{HALF_LENGTH:g}."
            )
    return Candidate(style, tuple(chosen[finger] for finger in touching))


def _found(
    options: Mapping[str, CandidateOptions], inputs: Inputs, clearance: float | None
) -> Grips:
    """The grips of human hands; a run keeps them, and what was against others.

    Raises
    ------
        ConfigError: they are of hands of different sizes, or none of them holds the sticks.
    """
    candidates = {name: _candidate(given) for name, given in options.items()}
    fingers = {len(candidate.style) for candidate in candidates.values()}
    if len(fingers) > 1:
        raise ConfigError(
            f"grip.candidates are styles of hands of {' and '.join(map(str, sorted(fingers)))} fingers. Give those "
            "of one hand."
        )

    def keep(folder: Path) -> None:
        if grips.find is not None:
            raise ConfigError(
                "Nothing here holds a tool, so grip.style finds no grip. Leave it out."
            )
        folder.mkdir(parents=True, exist_ok=True)
        for name, grip in grips.by_name.items():
            grip.save(folder / f"{name}.json")
        write_atomically(folder / _AGAINST, json.dumps(grips.against).encode())

    asked = f"grips {[(n, written(c.style), c.places) for n, c in candidates.items()]}"
    if clearance is not None:
        asked += f" apart by {clearance}"
    folder = inputs.folder_of(asked, Path(), keep)
    if folder != Path():
        return _kept(folder, list(candidates))

    def find(scene: HandScene) -> Grips:
        for candidate in candidates.values():
            _refuse_another_hand(candidate.style, scene)
        if len(candidates) > 1:
            found = _found_apart(candidates, clearance)
        else:
            ((name, candidate),) = candidates.items()
            human = HandScene(HandScene.Options(scene.measures.fingers))
            style, places = candidate.style, candidate.places
            grip = find_grip(human, style, places, finger_clearance=clearance)
            found = Grips({name: grip})
        found._need_one()
        return found

    grips = Grips(find=find)
    return grips


def _refuse_another_hand(style: Style, scene: HandScene) -> None:
    """Raises:
    ConfigError: it is not the style of a human hand, with two sticks, as `scene` has; before anything is searched for.
    """
    check_style(style, scene.measures.fingers)
    options = scene.options
    if options.tool != "sticks":
        raise ConfigError(
            f"grip.style={written(style)} is of two sticks, and the scene has {TOOLS[options.tool]}. Set "
            f"scene.tool=sticks, or grip.name={options.tool if options.tool != 'none' else 'standard'}."
        )
    if scene.robot or scene.measures != Measures(scene.measures.fingers):
        raise ConfigError(
            f"grip.style={written(style)} finds a grip of the human hand, and the scene's is another one. Find one: "
            "understudy grip STYLE FILE --scene NAME (scene=NAME), then grip.file=FILE."
        )


def _found_apart(candidates: Mapping[str, Candidate], clearance: float | None) -> Grips:
    """The grips of several, as many at once as there are cores: each takes seconds of one."""
    by_name, against = dict[str, Grip](), dict[str, str]()
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(os.cpu_count()) as threads:
        files = {name: Path(folder) / f"{name}.json" for name in candidates}
        ended = threads.map(
            partial(_find_apart, clearance=clearance), candidates.values(), files.values()
        )
        for (name, file), said in zip(files.items(), ended, strict=True):
            if said is None:
                by_name[name] = load_grip(file)
            else:
                against[name] = said
    return Grips(by_name, against)


def _find_apart(candidate: Candidate, file: Path, clearance: float | None) -> str | None:
    """Find one in a process of its own, into `file`; or what is against it."""
    words = [
        sys.executable,
        "-P",
        "-m",
        "understudy_gripping.apart",
        str(file),
        written(candidate.style),
        "none" if clearance is None else str(clearance),
    ]
    done = subprocess.run(
        [*words, *map(str, candidate.places)],
        capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    if done.returncode == 0:
        return None
    said = done.stderr.strip().splitlines()
    if done.returncode != ConfigError.exit_status:
        raise RunError(
            f"Finding the grip {written(candidate.style)} broke off: {said[-1] if said else 'killed'}"
        )
    return said[-1]


def _kept(folder: Path, names: Sequence[str]) -> Grips:
    """Of a run's folder. Raises FileError if it is not what a run keeps."""
    path = folder / _AGAINST
    try:
        against = json.loads(read(path, LARGEST))
        if not isinstance(against, dict) or not all(isinstance(v, str) for v in against.values()):
            raise ValueError("it has no sentences")
    except (OSError, ValueError, RecursionError) as error:
        raise FileError(f"{path} is not what a run keeps of its grips: {error}.") from error
    if not set(names) - against.keys():
        raise FileError(f"{path} is not what a run keeps of its grips: it leaves none.")
    return Grips(
        {name: load_grip(folder / f"{name}.json") for name in names if name not in against},
        {name: against[name] for name in names if name in against},
        begun=True,
    )
