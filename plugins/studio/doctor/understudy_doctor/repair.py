"""Repairs: what a clip can be rid of without being captured again. Pure functions, clip to clip.

Each repair acts only where the examination found what it repairs, so a clean clip comes out as it
went in. Repairs of a looping clip are made on three cycles of it, of which the middle one is kept,
so that what they change at the seam fits.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.linalg import solveh_banded
from scipy.ndimage import gaussian_filter1d

from understudy.errors import ConfigError
from understudy_characters.character import Character
from understudy_doctor.ballistic import mend_flights
from understudy_doctor.character_checks import STANDS_ON
from understudy_doctor.clip_repairs import mend_frames, mend_held, mend_seam, mend_spikes
from understudy_doctor.examination import Examination, examine
from understudy_doctor.findings import Severity, intervals
from understudy_doctor.measurements import GRAVITY, Measurements
from understudy_doctor.proportions import scaled
from understudy_motion.clip import Clip, cycle_transform, sample
from understudy_motion.editing import close_loop, cut, evenly_spaced, find_loop, reach, shift
from understudy_tensors import rotations

GROUND_MARGIN = 0.005
"""m that a repaired clip may still go into the ground: contacts are never exact."""
FLOAT_MARGIN = 0.02
"""m that it may still be above the ground in contact: below the least that counts as floating."""
GROUND_CUTOFF = 4.0
"""Hz: corrections of height faster than this would be felt as a jolt, so they are not made."""
FARTHEST_LOCK = 0.15
"""m: a foot that slides farther to either side is left sliding; its leg would look broken."""
SMOOTH_SECONDS = 0.04
"""s: the width (standard deviation) over which the turns that lock a foot are spread."""

TRAVEL, IN_PLACE, ALIKE = 0.3, 0.25, 0.75
"""m/s, a share, a share: when feet slide back at this nearly all the time they stand, and the root goes
less than that share of their way, the clip was made to stay in place."""

WORSE = 1.05
"""Times: by how much a repair may raise the worst value of a kind; less is noise."""
BALLISTIC_MARGIN = 0.008
"""m by which it may bend a flight away from a parabola: 1 cm, with room for how the centre of mass is measured."""
_STRAIGHT = 1e6  # times: how much stiffer a curve is where it must be straight
_REMEMBERED = 3_000  # frames: of longer clips what steps made is not kept, since it takes much room


@dataclass(frozen=True)
class Repair:
    """A repaired clip and what was done to it, in words."""

    clip: Clip
    done: tuple[str, ...]
    left: tuple[str, ...] = ()  #: what was left undone, for the harm it would do


def repair(examined: Examination) -> Repair:
    """Repair what can be repaired of what was found, and nothing that would do harm.

    All repairs together are taken if that does no harm; else one after another, each by itself or, if
    it needs those that come after it, with them. What was left is tried once more in the end.
    """
    feet = examined.measured.feet if examined.measured else ()
    steps = [*_FIRST, *map(_foot_step, feet), *_LAST]
    state = _State(examined)
    whole = _carry_out(steps, state)
    if not harm(examined, whole.examined):
        return Repair(whole.examined.clip, whole.done)
    left: list[_Step] = []
    for number, step in enumerate(steps):
        tried = _carry_out([step], state)
        if harm(state.examined, tried.examined):
            later = steps[number + 1 :]
            together = _carry_out(later, tried)
            for after in (together, _harmless(later, tried)[0]):
                if not harm(state.examined, after.examined):
                    state = after
                    break
            else:
                left.append(step)
                continue
            break
        state = tried
    state, reasons = _harmless(left, state)
    return Repair(state.examined.clip, state.done, reasons)


def _harmless(steps: Sequence[_Step], state: _State) -> tuple[_State, tuple[str, ...]]:
    """Those of the `steps` that do no harm, one after another; and why each of the others does."""
    reasons: list[str] = []
    for step in steps:
        tried = _carry_out([step], state)
        if reason := harm(state.examined, tried.examined):
            reasons += [f"not {words}: {reason}" for words in tried.done[len(state.done) :]]
        else:
            state = tried
    return state, tuple(reasons)


@dataclass(frozen=True)
class _Step:
    """A repair, and the findings for which it is made."""

    kinds: frozenset[str]
    mend: Callable[..., tuple[Clip, list[str]]]
    on_body: bool = True  #: whether it takes a clip and its measurements, or the examination


@dataclass(frozen=True)
class _State:
    """A clip on its way through the repairs."""

    examined: Examination
    done: tuple[str, ...] = ()
    #: What single steps made of it: they are tried alone, and with others after them.
    tried: dict[_Step, _State] = field(default_factory=dict, compare=False, repr=False)

    @cached_property
    def body(self) -> tuple[Clip, Measurements] | None:
        """What repairs on the body are made of: the clip, of a looping one three cycles, on its character."""
        clip, character = self.examined.clip, self.examined.character
        measured = self.examined.measured
        if character is None or measured is None:
            return None
        if clip.loop:
            clip = _thrice(clip)
        elif measured.clip is clip and self.examined.level is None:
            return clip, measured  # nothing of it was interpolated over
        return clip, Measurements(clip, character)

    def after(self, step: _Step) -> _State:
        """After one step, if what is found asks for it."""
        if step not in self.tried:
            mended, words = self._mended(step)
            if not words:
                return self
            was = self.examined
            again = examine(mended, was.character, was.floor, was.level)
            made = _State(again, (*self.done, *words))
            if was.clip.num_frames > _REMEMBERED:
                return made
            self.tried[step] = made
        return self.tried[step]

    def _mended(self, step: _Step) -> tuple[Clip, list[str]]:
        examined = self.examined
        kinds = {finding.kind for finding in examined.findings}
        # Where legs are of another length, everything on the ground follows from that.
        if not step.kinds & kinds or (step.on_body and "proportions" in kinds):
            return examined.clip, []
        if not step.on_body:
            return step.mend(examined)
        if self.body is None:
            return examined.clip, []
        mended, words = step.mend(*self.body)
        if words and examined.clip.loop:
            mended = _middle(examined.clip, mended)
        return mended, words


def _carry_out(steps: Sequence[_Step], state: _State) -> _State:
    """Each of the `steps` that what is found by then asks for."""
    for step in steps:
        state = state.after(step)
    return state


def harm(before: Examination, after: Examination) -> str:
    """Why what was done to the clip between the two examinations does harm; empty if it does none.

    It must not add findings, neither major ones of any kind nor in all; it must not make the worst of
    a kind worse; and bodies in flight must stay on their parabolas.
    """
    if after is before:
        return ""
    if len(after.findings) > len(before.findings):
        return f"it would make {len(before.findings)} findings {len(after.findings)}"
    for kind in sorted({f.kind for f in after.findings}):
        was, now = (
            [abs(f.value) for f in e.findings if f.kind == kind and f.severity == Severity.MAJOR]
            for e in (before, after)
        )
        if len(now) > len(was) or max(now, default=0.0) > WORSE * max(was, default=0.0):
            return f"it would make '{kind}' worse"
    if (stray := straying(before, after)) > BALLISTIC_MARGIN:
        return f"it would bend a flight by {100 * stray:.1f} cm"
    return ""


def straying(before: Examination, after: Examination) -> float:
    """m: by how much farther a repair leaves the centre of mass, in flight, from a parabola that falls
    at g than it was. Where the repair changed how long the clip is, flights are those of its result."""
    old, new = before.measured, after.measured
    if old is None or new is None:
        return 0.0
    if abs(new.clip.duration - old.clip.duration) > old.dt:
        was, now = (max(map(_off(m), m.flights), default=0.0) for m in (old, new))
        return now - was
    if not old.flights:
        return 0.0
    there = CubicSpline(new.clip.times.numpy(), new.centre)(old.clip.times.numpy())
    return max((_off(old, there)(f) - _off(old)(f) for f in old.flights), default=0.0)


def _off(measured: Measurements, centre: np.ndarray | None = None) -> Callable[[Any], float]:
    """How far, m at most, the centre of mass is in a flight from the nearest parabola that falls at g."""

    def off(flight: tuple[int, int]) -> float:
        path = measured.centre if centre is None else centre
        during = slice(flight[0], flight[1] + 1)
        clock = measured.dt * np.arange(flight[1] - flight[0] + 1)
        rest = path[during] + 0.5 * np.array([0.0, 0.0, GRAVITY]) * clock[:, None] ** 2
        steady = np.column_stack([np.ones_like(clock), clock])
        rest = rest - steady @ np.linalg.lstsq(steady, rest, rcond=None)[0]
        return float(np.linalg.norm(rest, axis=1).max())

    return off


def make_loop(clip: Clip, character: Character | None) -> Repair:
    """The best loop in `clip`, cut out and closed.

    Raises
    ------
    ConfigError
        the clip loops already, or no two of its frames fit.
    """
    if clip.loop:
        raise ConfigError(f"Clip {clip.name} loops already; leave --loop out.")
    clip = evenly_spaced(clip)
    contacts = None
    if character is not None:
        measured = Measurements(clip, character)
        contacts = torch.from_numpy(measured.touching[:, measured.feet])
    loop = find_loop(clip, contacts)
    if loop is None:
        raise ConfigError(
            f"Clip {clip.name} has no loop: no two of its frames, a whole cycle apart, have the same "
            "feet on the ground."
        )
    start, stop = clip.times[[loop.first, loop.last]].tolist()
    closed = close_loop(cut(clip, start, stop))
    what = (
        f"cut one cycle of {stop - start:.2f} s from {start:.2f} to {stop:.2f} s (frames {loop.first}–"
        f"{loop.last}), whose ends differ by {loop.mismatch:.2f} rad, and blended them"
    )
    return Repair(closed, (what,))


# ---------------------------------------------------------------------- the body


def _mend_hinges(clip: Clip, measured: Measurements) -> tuple[Clip, list[str]]:
    character = measured.character
    qpos = measured.qpos.clone()
    result, done = clip.rotations.clone(), []
    for joint in character.joints[1:]:
        if len(joint.axes) == 0:
            continue
        addresses = list(joint.addresses)
        low, high = torch.from_numpy(joint.ranges).unbind(1)
        held = torch.minimum(torch.maximum(qpos[:, addresses], low), high)
        beyond = (held != qpos[:, addresses]).any(1)
        if not beyond.any():
            continue
        qpos[:, addresses] = held
        made = character.clip(qpos, clip.times, name=clip.name)
        row = clip.joint_names.index(joint.name)
        result[beyond, row] = made.rotations[beyond, made.joint_names.index(joint.name)]
        done.append(f"held {joint.name} at its limit")
    return replace(clip, rotations=result), done


def _mend_proportions(examined: Examination) -> tuple[Clip, list[str]]:
    scale = examined.scale
    what = f"scaled travel and height by {scale:.2f}, and time by {math.sqrt(scale):.2f}"
    return scaled(examined.clip, scale), [f"{what}, for legs of another length"]


def _mend_flights(examined: Examination) -> tuple[Clip, list[str]]:
    character = examined.character
    if character is None or examined.measured is None or examined.scale != 1.0:
        return examined.clip, []
    return mend_flights(examined.clip, character)


def _mend_level(clip: Clip, measured: Measurements) -> tuple[Clip, list[str]]:
    """The floor that the clip stands on comes to z = 0."""
    offset = torch.tensor([0.0, 0.0, -measured.ground], dtype=torch.float64)
    return shift(clip, offset), [f"moved the clip up or down by {-100 * measured.ground:+.1f} cm"]


def _mend_ground(clip: Clip, measured: Measurements) -> tuple[Clip, list[str]]:
    """The root is raised and lowered along the smoothest curve that keeps the lowest point out of
    the ground, and on it wherever something must carry the body; steadily while it flies."""
    lowest = measured.heights.min(1)
    carried = measured.touching.any(1) | (
        measured.supported & (lowest - measured.ground < STANDS_ON)
    )
    level, steady = measured.ground, np.zeros(len(lowest), dtype=bool)
    for first, last in measured.flights:
        steady[first : last + 1] = True
    least, most = -lowest - GROUND_MARGIN, np.where(carried, -lowest + FLOAT_MARGIN, np.inf)
    rise = -level + _between(least + level, most + level, steady, measured.dt)
    offset = torch.zeros(len(rise), 3, dtype=torch.float64)
    offset[:, 2] = torch.from_numpy(rise)
    span = (
        f"by {100 * rise.mean():+.1f} cm"
        if np.ptp(rise) < 1e-3
        else f"by {100 * rise.min():+.1f} to {100 * rise.max():+.1f} cm over time"
    )
    return shift(clip, offset), [f"moved the root up or down {span}"]


def _between(least: np.ndarray, most: np.ndarray, steady: np.ndarray, dt: float) -> np.ndarray:
    """(F,) the smoothest curve from `least` to `most`, near 0 where they leave it the choice, and
    straight where it is to be `steady`.

    Penalised least squares (Eilers, "A Perfect Smoother", 2003) with targets where a bound is
    crossed, set and freed again until they settle. Staying above `least` comes first.
    """
    frames = len(least)
    if frames < 3:
        return np.full(frames, least.max())
    straight = steady[:-2] & steady[1:-1] & steady[2:]
    # The squared second differences, by the diagonals of their matrix.
    inner = np.where(straight, _STRAIGHT, 1.0)
    stiffness = np.zeros((3, frames))
    stiffness[2] = np.convolve(inner, [1.0, 4.0, 1.0])
    stiffness[1, 1:] = np.convolve(inner, [-2.0, -2.0])
    stiffness[0, 2:] = inner
    stiffness *= (2.0 * np.pi * GROUND_CUTOFF * dt) ** -4
    nothing, free, over, under = np.zeros(frames), 1e-3, 1.0, 10.0
    target, weight, curve = nothing.copy(), np.full(frames, free), nothing
    for _ in range(50):
        inside = (curve > least + 1e-5) & (curve < most - 1e-5) & (weight > free)
        changes = (
            (curve < least - 1e-5, least, under),
            (curve > most + 1e-5, most, over),
            (inside, nothing, free),
        )
        if not any(where.any() for where, _, _ in changes):
            break
        for where, goal, strength in changes:
            target[where], weight[where] = goal[where], strength
        matrix = stiffness.copy()
        matrix[2] += weight
        curve = solveh_banded(matrix, weight * target)
    return curve


def _mend_travel(clip: Clip, measured: Measurements) -> tuple[Clip, list[str]]:
    """What stays in one place, all its feet sliding back under it alike, gets under way."""
    steps = measured.slides / measured.dt
    standing = (measured.touching[:-1] & measured.touching[1:])[:, measured.feet]
    if not standing.any():
        return clip, []
    steps = steps[:, measured.feet][standing]
    velocity = np.median(steps, axis=0)
    speed = float(np.linalg.norm(velocity))
    strolled = float(np.ptp(clip.root_position[:, :2].numpy(), axis=0).max())
    alike = np.linalg.norm(steps - velocity, axis=1) < 0.5 * speed
    if speed < TRAVEL or strolled > IN_PLACE * speed * clip.duration or alike.mean() < ALIKE:
        return clip, []
    way = torch.zeros(clip.num_frames, 3, dtype=torch.float64)
    way[:, :2] = -clip.times[:, None] * torch.from_numpy(velocity)
    return shift(clip, way), [f"set it going at {speed:.2f} m/s, as its feet slide back"]


def _mend_foot(foot: int, clip: Clip, measured: Measurements) -> tuple[Clip, list[str]]:
    """The foot stays where it came down, and on the ground, as far as the leg does it smoothly."""
    figure, path = measured.figure, _foot_path(measured, foot)
    if not _hangs_on_a_leg(foot, measured) or not path.any():
        return clip, []
    result = clip.rotations.clone()
    parents = measured.character.skeleton.parents
    knee = parents[foot]
    axes = measured.character.joints[knee].axes
    bend_axis = axes[0].tolist() if len(axes) == 1 else None
    name = figure.joint_names[foot]
    moved = reach(figure, name, torch.from_numpy(path), bend_axis)
    for row in (foot, knee, parents[knee]):
        old, new = figure.rotations[:, row], moved.rotations[:, row]
        turn = rotations.to_exponential_map(rotations.multiply(rotations.conjugate(old), new))
        # A nearly straight leg answers the least shortening with a kick of the knee.
        width = SMOOTH_SECONDS / measured.dt
        calm = torch.from_numpy(gaussian_filter1d(turn.numpy(), width, axis=0, mode="nearest"))
        column = clip.joint_names.index(figure.joint_names[row])
        result[:, column] = rotations.multiply(old, rotations.from_exponential_map(calm))
    most = 100.0 * np.linalg.norm(path, axis=1).max()
    what = f"locked {name} where it stands, moving it by up to {most:.1f} cm"
    return replace(clip, rotations=result), [what]


def _hangs_on_a_leg(foot: int, measured: Measurements) -> bool:
    """Whether two joints above the foot, short of the root, carry nothing else. Toes hang on a foot."""
    parents = measured.character.skeleton.parents
    knee = parents[foot]
    hip = parents[knee] if knee > 0 else 0
    return hip > 0 and knee not in measured.feet and parents.count(knee) == parents.count(hip) == 1


def _foot_path(measured: Measurements, foot: int) -> np.ndarray:
    """By what a foot is to be moved, (F, 3) m, smoothly between its contacts."""
    frames, moves = [], []
    for first, last in intervals(measured.touching[:, foot]):
        way = np.zeros((last - first + 1, 3))
        way[1:, :2] = np.cumsum(measured.slides[first:last, foot], axis=0)
        way[:, :2] -= 0.5 * (way[:, :2].max(0) + way[:, :2].min(0))
        height = measured.heights[first : last + 1, foot]
        # Out of the ground, and down by what it is usually above it: landing stays a landing.
        way[:, 2] = np.minimum(height, max(float(np.median(height)), 0.0))
        if np.linalg.norm(way, axis=1).max() > FARTHEST_LOCK:
            way[:] = 0.0
        frames.append(np.arange(first, last + 1))
        moves.append(-way)
    if not frames:
        return np.zeros((len(measured.times), 3))
    known, values = np.concatenate(frames), np.concatenate(moves)
    if len(known) == 1:
        return np.repeat(values, len(measured.times), axis=0)
    every = np.arange(len(measured.times)).clip(known[0], known[-1])
    return PchipInterpolator(known, values)(every)


def _on_clip(mend: Callable[[Clip], tuple[Clip, list[str]]]) -> Callable[[Examination], Any]:
    return lambda examined: mend(examined.clip)


_FIRST = (
    _Step(frozenset({"proportions"}), _mend_proportions, on_body=False),
    _Step(frozenset({"held_root"}), _on_clip(mend_held), on_body=False),
    _Step(frozenset({"duplicate_frames", "uneven_frames"}), _on_clip(mend_frames), on_body=False),
    _Step(frozenset({"spike"}), _on_clip(mend_spikes), on_body=False),
    _Step(frozenset({"seam_pose", "seam_velocity"}), _on_clip(mend_seam), on_body=False),
    _Step(frozenset({"flight"}), _mend_flights, on_body=False),
    _Step(frozenset({"ground_offset"}), _mend_level),
    _Step(frozenset({"penetration", "float"}), _mend_ground),
    _Step(frozenset({"foot_skate"}), _mend_travel),
)
_LAST = (
    _Step(frozenset({"joint_limit"}), _mend_hinges),
    # Locked feet may be in the ground again, and what moved legs moved the centre of mass.
    _Step(frozenset({"penetration"}), _mend_ground),
    _Step(frozenset({"flight"}), _mend_flights, on_body=False),
)


def _foot_step(foot: int) -> _Step:
    return _Step(frozenset({"foot_skate", "penetration"}), functools.partial(_mend_foot, foot))


def _thrice(clip: Clip) -> Clip:
    """Three cycles of a looping clip, as one that does not loop."""
    steps = clip.num_frames - 1
    times = torch.arange(-steps, 2 * steps + 1, dtype=torch.float64) * (clip.duration / steps)
    position, rotation = sample(clip, times)
    return replace(
        clip, times=times - times[0], root_position=position, rotations=rotation, loop=False
    )


def _middle(clip: Clip, thrice: Clip) -> Clip:
    """The looping `clip` as the middle one of three repaired cycles has it."""
    steps = clip.num_frames - 1
    middle = slice(steps, 2 * steps + 1)
    position, rotation = thrice.root_position[middle].clone(), thrice.rotations[middle].clone()
    # The two cycles beside it were mended a little differently; the seam must be exact.
    turn = rotations.from_heading(torch.tensor(cycle_transform(clip).heading, dtype=torch.float64))
    rotation[-1] = rotation[0]
    rotation[-1, 0] = rotations.multiply(turn, rotation[0, 0])
    position[-1, 2] = position[0, 2]
    return replace(clip, root_position=position, rotations=rotation)
