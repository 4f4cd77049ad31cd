"""A grip: how a hand holds a tool, at some angles between its parts. As a JSON file, and as a config section."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch

from understudy.errors import ConfigError, FileError, RunError, suggestion
from understudy.folders import read
from understudy.inputs import Inputs
from understudy.options import check_range
from understudy.records.checkpoint import write_atomically
from understudy.setup.registry import Registry
from understudy_gripping.balance import Balance, balance
from understudy_gripping.hold import Held, hold, nearest_fingers, placed
from understudy_gripping.holding import holding
from understudy_gripping.pose import Candidate, Poses, PoseSolver
from understudy_gripping.styles import Style, check_style, read_style, written
from understudy_hand.scene import HandScene
from understudy_hand.table import ARM_POSE, FEWEST, FINGERS, Measures
from understudy_hand.tools import GRIPPERS, HALF_LENGTH, Tool, upper_pose
from understudy_tensors import rotations

__all__ = ["NONE_HOLDS", "Grip", "Grips", "load_grip"]

#: N, wanted of each contact, and the share of it that each bears at least; 2 N and a quarter lose the sticks of a human hand under 40 mrad
#: of noise, these do not at 60.
FORCE, LEAST_SHARE = 3.0, 1 / 3
#: m: a wider gap between what shall touch, or less clearance, is no grip.
WIDEST_GAP, LEAST_CLEARANCE = 2e-3, 0.0
#: m: how far each place may be from a first guess in a search, in a human hand.
SPREAD = 0.025
#: m between fingers that may be asked for, at most: knuckles of a human hand are 1 to 2 mm apart.
MOST_CLEARANCE = 0.002
#: Candidates of a search of which all angles are solved, at most.
MOST_HELD = 4
_VERSION = 1
_LARGEST = 1 << 20
#: The name of a grip that has the job for itself.
_ONLY = "grip"
_TOOLS = {"sticks": "two sticks", "tongs": "tongs", "brush": "a brush", "none": "no tool"}
_THE = {"sticks": "the sticks", "tongs": "the tongs", "brush": "the brush"}
#: How the sentence begins that refuses a job of candidates none of which can begin.
NONE_HOLDS = "No candidate holds the sticks."
#: In the folder of a run, beside the grips that were found for it: what is against the others.
_AGAINST = "against.txt"


@dataclass(frozen=True)
class Grip:
    """K angles, H hinges of the hand; m, rad, in the palm's frame. The lower part of a tool that has one is that one."""

    measures: Measures  #: of the hand
    style: Style
    places: tuple[float, ...]  #: by finger that touches, along its part: x of section 5.5.3
    hinges: tuple[str, ...]
    lower: np.ndarray  #: (7,) the lower part's position and rotation, at all angles
    angles: np.ndarray  #: (K,) by which the parts are closed, rising
    poses: np.ndarray  #: (K, H)
    targets: np.ndarray  #: (K, H) of the servos, which press as much as holds the tool
    tool: Tool = "sticks"
    #: Whether it holds the tool without a policy; the T-pose of figure 5.6 does not touch it.
    holds: bool = True
    robot: str = ""  #: the model of the hand (``HandScene.robot``); empty is the human one

    @property
    def upper(self) -> np.ndarray:
        """(K, 7) the upper part's position and rotation; of a tool of one part that one's."""
        angles = torch.from_numpy(self.angles)
        lower = torch.from_numpy(self.lower).expand(len(angles), 7)
        if (gripper := GRIPPERS.get(self.tool)) is None:
            return lower.numpy()
        return torch.cat(upper_pose(lower[:, :3], lower[:, 3:], angles, gripper), dim=1).numpy()

    @property
    def touching(self) -> tuple[str, ...]:
        """The fingers that touch a stick."""
        return tuple(f for f, s in zip(self.measures.names, self.style, strict=True) if s)

    def need(self, scene: HandScene) -> None:
        """Raises:
        ConfigError: it is a grip of another hand than the scene's, or of another tool.
        """
        if scene.options.tool != self.tool:
            raise ConfigError(
                f"The grip {written(self.style)} holds {_TOOLS[self.tool]}, and the scene has "
                f"{_TOOLS[scene.options.tool]}. Set scene.tool={self.tool}, or another grip."
            )
        if scene.robot != self.robot:
            hands = [name or "the human one" for name in (self.robot, scene.robot)]
            raise ConfigError(
                f"The grip {written(self.style)} is one of another hand: {hands[0]}, and the scene's is {hands[1]}. "
                "Set another scene, such as scene=hand/adroit, or another grip."
            )
        if scene.measures != self.measures:
            raise ConfigError(
                f"The grip {written(self.style)} is one of a hand with {_said(self.measures)}, and the "
                f"scene's has {_said(scene.measures)}. Find one: understudy grip STYLE FILE --fingers "
                f"{scene.measures.fingers} --finger-length {scene.measures.finger_length:g} --size "
                f"{scene.measures.size:g}, then grip.file=FILE."
            )
        model = scene.model
        hand = tuple(model.joint(j).name for j in range(len(ARM_POSE), scene.hinges))
        if len(hand) != len(self.hinges) or (not self.robot and hand != self.hinges):
            raise ConfigError(
                f"The grip {written(self.style)} names other hinges than the scene's hand has. Find it anew: "
                "understudy grip STYLE FILE."
            )

    def held(self, scene: HandScene, row: int, seconds: float, settle: float = 0.5) -> Held:
        """The grip at its angle number `row`, simulated under its targets."""
        data = placed(scene, np.array(ARM_POSE), self.poses[row], self.upper[row], self.lower)
        return hold(scene, data, np.array([*ARM_POSE, *self.targets[row]]), seconds, settle)

    def save(self, path: Path) -> None:
        values = {
            "version": _VERSION,
            "hand": asdict(self.measures),
            "tool": self.tool,
            "style": written(self.style),
            "places": _rounded(self.places),
            "hinges": list(self.hinges),
            **{n: _rounded(getattr(self, n)) for n in ("lower", "angles", "poses", "targets")},
            **({} if self.holds else {"holds": False}),
            **({"robot": self.robot} if self.robot else {}),
        }
        lines = ",\n".join(f" {json.dumps(k)}: {json.dumps(v)}" for k, v in values.items())
        write_atomically(path, f"{{\n{lines}\n}}\n".encode())


def _said(measures: Measures) -> str:
    return (
        f"{measures.fingers} fingers, finger_length {measures.finger_length:g} and size "
        f"{measures.size:g}"
    )


def _rounded(values: Any) -> Any:
    return np.round(np.asarray(values, np.float64), 7).tolist()


def find_grip(
    scene: HandScene,
    style: Style,
    places: Sequence[float],
    iterations: int = 400,
    force: float = FORCE,
    finger_clearance: float | None = None,
) -> Grip:
    """A grip from the T-pose: its poses at the tool's angles, targets that hold them by some `force` N a contact, held for a second.

    In its poses links of different fingers keep `finger_clearance` m apart, if that is given.

    Raises
    ------
    ConfigError
        fingers do not reach, are in each other's way, or the tool falls; the sentence says what.
    """
    return _find(
        PoseSolver(scene, finger_clearance), Candidate(style, tuple(places)), iterations, force
    )


def search_grip(
    scene: HandScene,
    style: Style,
    places: Sequence[float],
    tries: int,
    seed: int = 0,
    iterations: int = 200,
    force: float = FORCE,
    finger_clearance: float | None = None,
) -> Grip:
    """Of `tries` places and starts, drawn about `places` and the tool's own, the grip that slips least in ten
    seconds at any of its angles.

    Where the links lie that bear the tool is drawn as well, and so is where the tool's search begins: another hand
    has them elsewhere, and the thesis gives none. Those whose fingers reach are balanced and held for two seconds at
    the last angle, where most is to be borne; of :data:`MOST_HELD` that slip least the other angles are solved.

    Raises
    ------
    ConfigError
        none holds; the sentence says how far they came.
    """
    solver, generator = PoseSolver(scene, finger_clearance), np.random.default_rng(seed)
    own, size = solver.holding, scene.measures.size
    named = [place for name, (_, place) in own.supports.items() if name in scene.links]
    candidates, nominal = [], []
    for number in range(tries):
        wide = 0.0 if number == 0 else 1.0  # the first one is what there is without a search
        drawn = wide * generator.uniform(-1.0, 1.0, (len(places) + len(named) + 6,))
        along = np.array([*places, *named]) + SPREAD * size * drawn[:-6]
        along = along.clip(-HALF_LENGTH, HALF_LENGTH).tolist()
        turn = rotations.from_exponential_map(torch.tensor(own.turned * drawn[-3:]) + 1e-12)
        turn = rotations.multiply(torch.tensor(own.turn, dtype=torch.float64), turn)
        place = size * (np.array(own.place) + own.far * drawn[-6:-3])
        nominal.append([*place, *turn.tolist()])
        supports = tuple(along[len(places) :])
        candidates.append(Candidate(style, tuple(along[: len(places)]), supports))
    first = solver.solve(
        candidates,
        iterations,
        angles=own.angles[-1:] * tries,
        nominal=torch.tensor(nominal, dtype=torch.float64),
    )
    reach = (first.gaps <= WIDEST_GAP) & (first.clearance >= LEAST_CLEARANCE)
    idle = tuple(f for f, part in zip(scene.measures.names, style, strict=True) if not part)
    slips = dict[int, float]()
    for row in reach.nonzero()[:, 0].tolist():
        data, found = _balanced(solver, style, first, row, force)
        slips[row] = _slip(hold(scene, data, found.targets, 2.0, 0.5), idle)
    best, least, said = None, math.inf, "it falls within two seconds, or other fingers hold it too"
    for row in sorted((r for r, s in slips.items() if s < math.inf), key=slips.__getitem__)[
        :MOST_HELD
    ]:
        try:
            grip = _find(solver, candidates[row], iterations, force, _rows(first, row))
        except ConfigError as error:
            said = str(error)
            continue
        slip = max(_slip(grip.held(scene, k, 10.0, 1.0), idle) for k in range(len(grip.angles)))
        if slip < least:
            best, least = grip, slip
    if best is None:
        raise ConfigError(
            f"None of {tries} places of the style {written(style)} holds; the fingers reach {len(slips)} of them. Of the "
            f"last one: {said}"
        )
    return best


def _rows(poses: Poses, *rows: int) -> Poses:
    """Those of the candidates `rows`."""
    chosen = list(rows)
    return replace(
        poses, **{n: getattr(poses, n)[chosen] for n in ("pose", "lower", "angle", "gaps", "clearance", "cost")}
    )  # fmt: skip


def _slip(held: Held, idle: tuple[str, ...]) -> float:
    """m, infinite where something fell, or a finger touches that the style has `idle`."""
    helped = any(link.partition("_")[0] in idle for link in held.links if "metacarpal" not in link)
    return float(held.drift.max()) if held.fell is None and not helped else math.inf


def _balanced(
    solver: PoseSolver, style: Style, poses: Poses, row: int, force: float
) -> tuple[mujoco.MjData, Balance]:
    """The scene in the pose number `row`, and what balances the tool there."""
    scene, lower = solver.scene, poses.lower[row : row + 1]
    upper = lower
    if (gripper := GRIPPERS.get(solver.tool)) is not None:
        angle = poses.angle[row : row + 1]
        upper = torch.cat(upper_pose(lower[:, :3], lower[:, 3:], angle, gripper), dim=1)
    pose = poses.pose[row].numpy()
    data = placed(scene, np.array(ARM_POSE), pose, upper[0].numpy(), lower[0].numpy())
    return data, balance(scene, data, style, force, LEAST_SHARE * force)


def _find(
    solver: PoseSolver,
    candidate: Candidate,
    iterations: int,
    force: float,
    base: Poses | None = None,
) -> Grip:
    """The grip of `candidate`, whose pose at one of the angles is `base`."""
    scene, style, angles = solver.scene, candidate.style, solver.holding.angles
    what = f"The style {written(style)} with places {_rounded(candidate.places)}"
    if base is None:
        base = solver.solve([candidate], iterations, angles=angles[:1])
    _refuse_unreachable(what, base)
    count = len(angles)
    start = replace(_rows(base, *[0] * count), angle=torch.tensor(angles, dtype=torch.float64))
    poses = solver.solve([candidate] * count, iterations, start, angles)
    _refuse_unreachable(what, poses)
    arm, targets = len(ARM_POSE), []
    for row in range(count):
        data, found = _balanced(solver, style, poses, row, force)
        if solver.finger_clearance is not None:
            _refuse_entangled(what, *nearest_fingers(scene, data), solver.finger_clearance)
        targets.append(found.targets[arm:])
    grip = Grip(
        scene.measures, style, candidate.places, poses.hinges, poses.lower[0].numpy(),
        np.array(angles), poses.pose.numpy(), np.array(targets), solver.tool, robot=scene.robot,
    )  # fmt: skip
    for row, angle in enumerate(angles):
        if (fell := grip.held(scene, row, 1.0).fell) is not None:
            raise ConfigError(
                f"{what} does not hold {_THE[solver.tool]}: at an angle of {angle:g} rad one falls after "
                f"{fell:.2f} s. Try other places."
            )
    return grip


def _refuse_unreachable(what: str, poses: Poses) -> None:
    gap, clearance = float(poses.gaps.max()), float(poses.clearance.min())
    if not gap <= WIDEST_GAP:
        raise ConfigError(
            f"{what} has no pose: {1e3 * gap:.1f} mm are left between a stick and what shall touch it. "
            "Try other places."
        )
    if not clearance >= LEAST_CLEARANCE:
        raise ConfigError(
            f"{what} has no pose: a finger is {-1e3 * clearance:.1f} mm inside a stick. Try other places."
        )


def _refuse_entangled(what: str, distance: float, pair: tuple[str, str], clearance: float) -> None:
    if distance < clearance:
        names = " and ".join(name.replace("_", " ") for name in pair)
        far = (
            f"{1e3 * distance:.1f} mm apart"
            if distance >= 0
            else f"{-1e3 * distance:.1f} mm in each other"
        )
        raise ConfigError(
            f"{what} has no pose: {names} are {far}, and {1e3 * clearance:g} mm were asked for. Try other places, or less "
            "clearance."
        )


def load_grip(path: Path) -> Grip:
    """The grip in the JSON file `path`, as :meth:`Grip.save` writes it.

    Raises
    ------
    FileError
        the file is missing, or no grip.
    """
    try:
        values = json.loads(read(path, _LARGEST))
        if not isinstance(values, dict) or values.get("version") != _VERSION:
            raise ValueError(f"it is not of version {_VERSION}")
        measures = Measures(
            int(values["hand"]["fingers"]), *(float(values["hand"][k]) for k in ("finger_length", "size"))
        )  # fmt: skip
        tool = values.get("tool", "sticks")  # what the first of these files were of
        if tool not in _THE:
            raise ValueError(f"there is no tool {tool!r}")
        if not isinstance(holds := values.get("holds", True), bool):
            raise ValueError("holds is neither true nor false")
        style = read_style(str(values["style"]), measures.fingers, tool)
        hinges = tuple(map(str, values["hinges"]))
        if len(set(hinges)) != len(hinges) or not hinges:
            raise ValueError("its hinges are not named each once")
        rows = len(values["angles"])
        grip = Grip(
            measures,
            style,
            tuple(_numbers(values, "places", (sum(map(bool, style)),)).tolist()),
            hinges,
            _numbers(values, "lower", (7,)),
            _numbers(values, "angles", (rows,)),
            _numbers(values, "poses", (rows, len(hinges))),
            _numbers(values, "targets", (rows, len(hinges))),
            tool,
            holds,
            str(values.get("robot", "")),
        )
        if rows < 2 or (np.diff(grip.angles) <= 0).any():
            raise ValueError("its angles are not two or more that rise")
        if not math.isclose(np.linalg.norm(grip.lower[3:]), 1.0, abs_tol=1e-3):
            raise ValueError("the lower stick's rotation is no unit quaternion")
    except FileNotFoundError as error:
        raise FileError(f"There is no grip at {path}.") from error
    except (
        OSError, ValueError, TypeError, KeyError, ArithmeticError, RecursionError, ConfigError
    ) as error:  # fmt: skip
        reason = f"it has no {error}" if isinstance(error, KeyError) else str(error).rstrip(".")
        raise FileError(f"{path} is no grip: {reason}.") from error
    return grip


def _numbers(values: dict[str, Any], name: str, shape: tuple[int, ...]) -> np.ndarray:
    found = np.array(values[name])
    if found.shape != shape or found.dtype.kind not in "if" or not np.isfinite(found).all():
        raise ValueError(f"{name} are not {' × '.join(map(str, shape))} finite numbers")
    if np.abs(found).max() > 1e3:
        raise ValueError(f"{name} are larger than any of a hand's")
    return found.astype(np.float64)


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
        path = registry.find("grip", options.name).factory()
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
            f"grip.style={written(style)} is of two sticks, and the scene has {_TOOLS[options.tool]}. Set "
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
        against = json.loads(read(path, _LARGEST))
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


def _packaged(name: str) -> Path:
    return Path(__file__).parent / "grips" / f"{name}.json"


def standard() -> Path:
    """The standard style of the human hand, found from the T-pose."""
    return _packaged("standard")


def t_pose() -> Path:
    """Straight fingers beside the sticks (figure 5.6), which hold nothing: what figure 5.22 compares with."""
    return _packaged("t_pose")


#: Other tools in the human hand.
tongs, tongs_wide, brush = (partial(_packaged, name) for name in ("tongs", "tongs_wide", "brush"))
#: Sticks in other hands (section 5.7.3), the last a robot's.
long, large, tri_finger, adroit = (
    partial(_packaged, name) for name in ("long", "large", "tri_finger", "adroit")
)
