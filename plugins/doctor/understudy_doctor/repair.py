"""Repairs: what a clip can be rid of without being captured again. Pure functions, clip to clip.

Each repair acts only where the examination found what it repairs, so a clean clip comes out as it
went in. Repairs of a looping clip are made on three cycles of it, of which the middle one is kept,
so that what they change at the seam fits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.interpolate import PchipInterpolator
from scipy.linalg import solveh_banded
from scipy.ndimage import gaussian_filter1d

from understudy.errors import ConfigError
from understudy_basics import rotations
from understudy_characters.character import Character
from understudy_doctor.character_checks import STANDS_ON
from understudy_doctor.clip_repairs import mend_frames, mend_seam, mend_spikes
from understudy_doctor.examination import Examination, examine
from understudy_doctor.findings import intervals
from understudy_doctor.measurements import Measurements
from understudy_motion.clip import Clip, cycle_transform, sample
from understudy_motion.editing import (
    close_loop,
    cut,
    evenly_spaced,
    find_loop,
    reach,
    shift,
)

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

TRAVEL = 0.3
"""m/s: when the feet slide back at this all the time, the clip was made to stay in place."""

_ClipRepair = Callable[[Clip], tuple[Clip, list[str]]]
_BodyRepair = Callable[[Clip, Measurements], tuple[Clip, list[str]]]


@dataclass(frozen=True)
class Repair:
    """A repaired clip and what was done to it, in words."""

    clip: Clip
    done: tuple[str, ...]


def repair(examined: Examination) -> Repair:
    """Repair what can be repaired of what was found."""
    clip, character = examined.clip, examined.character
    kinds = {finding.kind for finding in examined.findings}
    done: list[str] = []
    for applies, step in _CLIP_REPAIRS:
        if applies & kinds:
            clip, words = step(clip)
            done += words
    if character is None or examined.measured is None:
        return Repair(clip, tuple(done))
    for applies, mend in _BODY_REPAIRS:  # each looks at the clip as the one before left it
        if applies & {finding.kind for finding in examine(clip, character).findings}:
            clip, words = _over_the_seam(clip, character, mend)
            done += words
    return Repair(clip, tuple(done))


def make_loop(clip: Clip, character: Character | None) -> Repair:
    """The best loop in `clip`, cut out and closed.

    Raises:
        ConfigError: the clip loops already, or no two of its frames fit.
    """
    if clip.loop:
        raise ConfigError(f"Clip {clip.source} loops already; leave --loop out.")
    clip = evenly_spaced(clip)
    contacts = None
    if character is not None:
        measured = Measurements(clip, character)
        contacts = torch.from_numpy(measured.touching[:, measured.feet])
    loop = find_loop(clip, contacts)
    if loop is None:
        raise ConfigError(
            f"Clip {clip.source} has no loop: no two of its frames, a whole cycle apart, have the same "
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


def _mend_ground(clip: Clip, measured: Measurements) -> tuple[Clip, list[str]]:
    """The root is raised and lowered along the smoothest curve that keeps the lowest point out of
    the ground, and on it wherever something must carry the body."""
    lowest = measured.heights.min(1)
    carried = measured.touching.any(1) | (
        measured.supported & (lowest - measured.ground < STANDS_ON)
    )
    least = -lowest - GROUND_MARGIN
    most = np.where(carried, -lowest + FLOAT_MARGIN, np.inf)
    rise = -measured.ground + _between(least + measured.ground, most + measured.ground, measured.dt)
    offset = torch.zeros(len(rise), 3, dtype=torch.float64)
    offset[:, 2] = torch.from_numpy(rise)
    span = (
        f"by {100 * rise.mean():+.1f} cm"
        if np.ptp(rise) < 1e-3
        else f"by {100 * rise.min():+.1f} to {100 * rise.max():+.1f} cm over time"
    )
    return shift(clip, offset), [f"moved the root up or down {span}"]


def _between(least: np.ndarray, most: np.ndarray, dt: float) -> np.ndarray:
    """(F,) the smoothest curve from `least` to `most`, near 0 where they leave it the choice.

    Penalised least squares (Eilers, "A Perfect Smoother", 2003) with targets where a bound is
    crossed, set and freed again until they settle. Staying above `least` comes first.
    """
    frames = len(least)
    if frames < 3:
        return np.full(frames, least.max())
    inner = np.ones(frames - 2)  # the squared second differences, by the diagonals of their matrix
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
    """What moves in place, feet sliding under it, gets under way."""
    steps = measured.slides / measured.dt
    standing = (measured.touching[:-1] & measured.touching[1:])[:, measured.feet]
    velocity = np.median(steps[:, measured.feet][standing], axis=0)
    speed = float(np.linalg.norm(velocity))
    if not standing.any() or speed < TRAVEL:
        return clip, []
    way = torch.zeros(clip.num_frames, 3, dtype=torch.float64)
    way[:, :2] = -clip.times[:, None] * torch.from_numpy(velocity)
    return shift(clip, way), [f"set it going at {speed:.2f} m/s, as its feet slide back"]


def _mend_feet(clip: Clip, measured: Measurements) -> tuple[Clip, list[str]]:
    """Feet stay where they came down, and on the ground, as far as the legs do it smoothly."""
    figure, done = measured.figure, []
    result = clip.rotations.clone()
    parents = measured.character.skeleton.parents
    width = SMOOTH_SECONDS / measured.dt
    for foot in measured.feet:
        path = _foot_path(measured, foot)
        if not _hangs_on_a_leg(foot, measured) or not path.any():
            continue
        knee = parents[foot]
        axes = measured.character.joints[knee].axes
        bend_axis = axes[0].tolist() if len(axes) == 1 else None
        moved = reach(figure, figure.joint_names[foot], torch.from_numpy(path), bend_axis)
        for row in (foot, knee, parents[knee]):
            old, new = figure.rotations[:, row], moved.rotations[:, row]
            turn = rotations.to_exponential_map(rotations.multiply(rotations.conjugate(old), new))
            # A nearly straight leg answers the least shortening with a kick of the knee.
            calm = torch.from_numpy(gaussian_filter1d(turn.numpy(), width, axis=0, mode="nearest"))
            column = clip.joint_names.index(figure.joint_names[row])
            result[:, column] = rotations.multiply(old, rotations.from_exponential_map(calm))
        most = 100.0 * np.linalg.norm(path, axis=1).max()
        done.append(
            f"locked {figure.joint_names[foot]} where it stands, moving it by up to {most:.1f} cm"
        )
    return replace(clip, rotations=result), done


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


_CLIP_REPAIRS: tuple[tuple[frozenset[str], _ClipRepair], ...] = (
    (frozenset({"duplicate_frames", "uneven_frames"}), mend_frames),
    (frozenset({"spike"}), mend_spikes),
    (frozenset({"seam_pose", "seam_velocity"}), mend_seam),
)
_BODY_REPAIRS: tuple[tuple[frozenset[str], _BodyRepair], ...] = (
    (frozenset({"ground_offset", "penetration", "float"}), _mend_ground),
    (frozenset({"foot_skate"}), _mend_travel),
    (frozenset({"foot_skate", "penetration"}), _mend_feet),
    (frozenset({"joint_limit"}), _mend_hinges),
)


def _over_the_seam(clip: Clip, character: Character, mend: _BodyRepair) -> tuple[Clip, list[str]]:
    """`mend` on a clip, of a looping one on the middle of three cycles."""
    if not clip.loop:
        return mend(clip, Measurements(clip, character))
    steps = clip.num_frames - 1
    times = torch.arange(-steps, 2 * steps + 1, dtype=torch.float64) * (clip.duration / steps)
    position, rotation = sample(clip, times)
    thrice = replace(
        clip, times=times - times[0], root_position=position, rotations=rotation, loop=False
    )
    mended, done = mend(thrice, Measurements(thrice, character))
    middle = slice(steps, 2 * steps + 1)
    position, rotation = mended.root_position[middle].clone(), mended.rotations[middle].clone()
    # The two cycles beside it were mended a little differently; the seam must be exact.
    turn = rotations.from_heading(torch.tensor(cycle_transform(clip).heading, dtype=torch.float64))
    rotation[-1] = rotation[0]
    rotation[-1, 0] = rotations.multiply(turn, rotation[0, 0])
    position[-1, 2] = position[0, 2]
    return replace(clip, root_position=position, rotations=rotation), done
