"""Checks that need no character: frames, spikes, the seam of a loop, the licence."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from scipy.ndimage import median_filter
from torch import Tensor

from understudy_doctor.findings import Finding, Places, Severity, intervals, severity
from understudy_motion.clip import Clip, cycle_transform
from understudy_motion.editing import EVEN
from understudy_motion.reading import SLOWEST_RATE
from understudy_tensors import rotations

__all__ = ["check_clip"]

UNEVEN, UNEVEN_MAJOR = EVEN, 0.5
"""Relative deviation of a frame's duration. Files round it by up to 1 %; half a frame is a lost one."""

INTERPOLATION, INTERPOLATION_MAJOR = 0.05, 0.1
"""rad: what interpolation between frames may miss of a joint. 0.05 rad moves a foot by 4 cm."""

SPEED, ROOT_SPEED = 40.0, 12.5
"""rad/s, m/s, exceeded in a tenth of the frames: a kicking knee and a sprinter's best are just below."""

DUPLICATE = 1e-6
"""rad, m: poses that differ by less are the same pose; a file's rounding is above this."""
MOVING = 0.2
"""rad/s, m/s: beside a repeated frame the motion goes on at more than this, or it merely rests."""

HELD_SPEED = 1.0
"""m/s with which a root that was held goes on in one frame: nobody gets under way like this."""

SPIKE_SPEED, SPIKE_ANGLE = 8.0, 0.1
"""rad/s, rad: slower or smaller jumps are within what captured motion has anyway."""
SPIKE_ANGLE_MAJOR = 0.3
"""rad: a jump that a tracking controller answers with a visible jerk (kp 500: 150 N m)."""
ROOT_SPIKE_SPEED, ROOT_SPIKE, ROOT_SPIKE_MAJOR = 2.0, 0.03, 0.1
"""m/s, m, m: the same of the root's position."""
SPIKE_RATIO = 3.0
"""A spike is this many times faster than the steps beside it go the same way, and than the joint's
median speed around: fast but honest motions speed up and slow down over several frames."""
SPIKE_RATE = 20.0
"""frames/s below which a jump cannot be told from a movement."""
DROPOUT = 0.25
"""s: two spikes within this, the second undoing the first, are one dropout."""

RAD_PER_METRE = 3.0
"""What a metre of height is worth: the bend of a leg that makes it."""
SEAM, SEAM_MAJOR = 0.02, 0.1
"""rad: 0.1 rad in one control step of 1/30 s is 3 rad/s, as fast as a limb swings."""
SEAM_SPEED, SEAM_SPEED_MAJOR = 1.0, 5.0
"""rad/s, beyond :data:`SEAM_RATIO` times what the joint's velocity changes elsewhere in one frame."""
SEAM_RATIO = 1.5
TURNING = np.radians(1.0)
"""rad per cycle: what a walk that is meant to be straight may turn."""

_AROUND = 6  # steps to either side among which a spike stands out


def check_clip(clip: Clip) -> Iterator[Finding]:
    """All findings of this module."""
    places = Places(clip)
    yield from _frames(places)
    yield from _spikes(places)
    if clip.loop:
        yield from _seam(places)
    if not clip.licence or clip.licence == "unknown":
        yield places.finding(
            "licence", Severity.MINOR, "nothing says on what terms the clip may be used", None, 0.0,
            "", "Put a LICENSE file beside it, or fetch it with `understudy motion fetch`.",
        )  # fmt: skip


def speeds(clip: Clip) -> np.ndarray:
    """(F - 1, J, 3) rad/s between frames, in the joints' own frames."""
    return _speeds(clip.rotations, clip.times)


@lru_cache(maxsize=4)  # by the tensors themselves: all checks of a clip ask for them
def _speeds(q: Tensor, times: Tensor) -> np.ndarray:
    steps = rotations.to_exponential_map(rotations.multiply(rotations.conjugate(q[:-1]), q[1:]))
    found = (steps / times.diff()[:, None, None]).numpy()
    found.setflags(write=False)
    return found


# ---------------------------------------------------------------------- frames


def duplicates(clip: Clip) -> list[tuple[int, int]]:
    """Runs (first, last) of frames that repeat the frame before, in the middle of a movement."""
    dt = clip.times.diff().numpy()
    turn = np.linalg.norm(speeds(clip), axis=-1).max(1) * dt
    move = np.linalg.norm(clip.root_position.diff(dim=0).numpy(), axis=-1)
    step = np.maximum(turn, move)
    found = []
    for first, last in intervals(step < DUPLICATE):
        if first == 0 or last == len(step) - 1:
            continue
        if min(step[first - 1] / dt[first - 1], step[last + 1] / dt[last + 1]) > MOVING:
            found.append((first + 1, last + 1))
    return found


def held(clip: Clip) -> list[tuple[int, int]]:
    """Runs (first, last) of frames whose root position was lost: it stays exactly where it was while
    the joints go on, then jumps off, until it is where the way before and after it agree."""
    t, place, found = clip.times.numpy(), clip.root_position.numpy(), []

    def pace(a: int, b: int) -> np.ndarray:
        return (place[b] - place[a]) / (t[b] - t[a])

    step = np.linalg.norm(np.diff(place, axis=0), axis=-1)
    turn = np.linalg.norm(speeds(clip), axis=-1).max(1)
    for first, last in intervals((step < DUPLICATE) & (turn > MOVING)):
        count, after = last - first + 1, last + 1
        if count < 2 or after == len(step) or np.linalg.norm(pace(after, after + 1)) < HELD_SPEED:
            continue
        ends = range(after + 1, min(after + count, clip.num_frames - 1 - count) + 1)
        jumps = {k: np.linalg.norm(pace(first, k) - pace(k, k + count)) for k in ends}
        if jumps:
            found.append((first + 1, min(jumps, key=lambda k: jumps[k]) - 1))
    return found


def _frames(places: Places) -> Iterator[Finding]:
    clip = places.clip
    dt = clip.times.diff().numpy()
    usual = float(np.median(dt))
    uneven = np.abs(dt / usual - 1.0)
    if uneven.max() > UNEVEN:
        first, last = intervals(uneven > UNEVEN, close=len(dt))[0]
        yield places.finding(
            "uneven_frames",
            severity(float(uneven.max()), UNEVEN_MAJOR),
            f"frames last from {1e3 * dt.min():.1f} to {1e3 * dt.max():.1f} ms, mostly "
            f"{1e3 * usual:.1f} ms",
            (first, last + 1),
            float(uneven.max()),
            "of a frame",
            "--fix OUT takes evenly spaced frames.",
        )
    for first, last in duplicates(clip):
        count = last - first + 1
        yield places.finding(
            "duplicate_frames",
            Severity.MAJOR,
            f"{count} frame{'s repeat' if count > 1 else ' repeats'} the pose before, so that the "
            "motion stops and jumps",
            (first, last),
            float(count),
            "frames",
            "--fix OUT interpolates over it.",
        )
    for first, last in held(clip):
        yield places.finding(
            "held_root", Severity.MAJOR,
            f"the root stays in one place for {last - first + 1} frames while its joints go on, or "
            "makes up for it", (first, last), float(last - first + 1), "frames",
            "--fix OUT moves it steadily.", [clip.joint_names[0]],
        )  # fmt: skip
    if usual > 1.0 / SLOWEST_RATE:
        yield places.finding(
            "slow_frames", Severity.MAJOR,
            f"its frames are {usual:.4g} s apart, so that it lasts {clip.duration:.4g} s", None, usual, "s",
            f"If these are frames per second, write its times in seconds, or give --source-rate {usual:.4g}.",
        )  # fmt: skip
    yield from _too_fast(places)
    error, joint, frames = _interpolation_error(clip)
    if error > INTERPOLATION:
        needed = clip.frame_rate * np.sqrt(error / INTERPOLATION)
        yield places.finding(
            "frame_rate",
            severity(error, INTERPOLATION_MAJOR),
            f"{clip.frame_rate:.0f} frames/s are too few for this motion: between frames about "
            f"{error:.2f} rad are lost",
            frames,
            error,
            "rad",
            f"Export it again at {10 * np.ceil(needed / 10):.0f} frames/s.",
            [clip.joint_names[joint]],
        )


def _too_fast(places: Places) -> Iterator[Finding]:
    """Speeds that nobody reaches: most often the frame rate, or the unit, is wrong."""
    clip = places.clip
    turning = np.quantile(np.linalg.norm(speeds(clip), axis=-1), 0.9, axis=0)
    steps = np.linalg.norm(clip.root_position.diff(dim=0).numpy(), axis=-1)
    moving = float(np.quantile(steps / clip.times.diff().numpy(), 0.9))
    joint = int(turning.argmax())
    remedy = "Check the frame rate (--source-rate) and the unit (--unit) of its file."
    for value, most, unit, what, name in (
        (float(turning[joint]), SPEED, "rad/s", "turns", clip.joint_names[joint]),
        (moving, ROOT_SPEED, "m/s", "moves", clip.joint_names[0]),
    ):
        if value > most:
            yield places.finding(
                "speed", Severity.MAJOR, f"{what} at {value:.3g} {unit}, faster than people can",
                None, value, unit, remedy, [name],
            )  # fmt: skip


def _interpolation_error(clip: Clip) -> tuple[float, int, tuple[int, int]]:
    """What interpolation loses: |second difference| / 8, exceeded in one frame of twenty; rad, with
    the joint and the frames of its fastest stretch."""
    if clip.num_frames < 4:
        return 0.0, 0, (0, clip.num_frames - 1)
    w, dt = speeds(clip), clip.times.diff().numpy()
    lost = np.linalg.norm(np.diff(w, axis=0), axis=-1) * dt[1:, None] / 8.0
    typical = np.quantile(lost, 0.95, axis=0)
    joint = int(typical.argmax())
    peaks = np.flatnonzero(lost[:, joint] >= typical[joint]) + 1
    return float(typical[joint]), joint, (int(peaks.min()), int(peaks.max()))


# ---------------------------------------------------------------------- spikes


def spikes(velocity: np.ndarray, dt: np.ndarray, least_speed: float, least: float) -> np.ndarray:
    """(K, J) bool: steps that stand out of those around them.

    Parameters
    ----------
    velocity
        (K, J, 3), step by step.
    dt
        (K,) s.
    least_speed
        of a spike, beyond :data:`SPIKE_RATIO` times what is around it.
    least
        how far a spike goes at least.
    """
    speed = np.linalg.norm(velocity, axis=-1)
    direction = velocity / np.maximum(speed, 1e-12)[..., None]
    beside = np.concatenate([velocity[1:2], velocity, velocity[-2:-1]])
    along = np.maximum((beside[:-2] * direction).sum(-1), (beside[2:] * direction).sum(-1))
    usual = median_filter(speed, size=(2 * _AROUND + 1, 1), mode="nearest")
    fast = speed > SPIKE_RATIO * np.maximum(along, usual) + least_speed
    return fast & (speed * dt[:, None] > least)


@dataclass(frozen=True)
class Spike:
    """A joint (row; -1: the root's position) jumps between frame `step` and the next; `back` is the
    step that undoes it, if one does."""

    row: int
    step: int
    back: int | None

    @property
    def frames(self) -> tuple[int, int]:
        """The wrong frames; of a jump that is not undone, those before and after it."""
        return (self.step, self.step + 1) if self.back is None else (self.step + 1, self.back)


def find_spikes(clip: Clip) -> list[Spike]:
    """The spikes of all joints; none in a clip of too few frames a second to tell."""
    if clip.frame_rate < SPIKE_RATE or clip.num_frames < 4:
        return []
    dt = clip.times.diff().numpy()
    moving = (clip.root_position.diff(dim=0).numpy() / dt[:, None])[:, None]
    flags = np.concatenate(
        [
            spikes(moving, dt, ROOT_SPIKE_SPEED, ROOT_SPIKE),
            spikes(speeds(clip), dt, SPIKE_SPEED, SPIKE_ANGLE),
        ],
        axis=1,
    )
    for first, last in duplicates(clip):  # the jump out of a frozen frame belongs to it
        flags[first - 1 : last + 1] = False
    for first, last in held(clip):
        flags[first - 1 : last + 1, 0] = False
    found = []
    for column in range(flags.shape[1]):
        row, steps = column - 1, np.flatnonzero(flags[:, column]).tolist()
        while steps:
            step = steps.pop(0)
            later = [s for s in steps if dt[step:s].sum() <= DROPOUT][:1]
            back = next((s for s in (*later, step + 1) if _undone(clip, row, step, s)), None)
            if back in later:
                steps.remove(back)
            elif back is None and step > 0 and _undone(clip, row, step - 1, step):
                step, back = step - 1, step  # the way out was hidden in a fast movement
            found.append(Spike(row, step, back))
    return found


def _undone(clip: Clip, row: int, step: int, later: int) -> bool:
    """Whether the jump at `later` takes the joint most of the way back from the jump at `step`."""
    if later + 1 >= clip.num_frames:
        return False
    jumps = (_distance(clip, row, s, s + 1) for s in (step, later))
    return _distance(clip, row, step, later + 1) < 0.5 * max(jumps)


def _distance(clip: Clip, row: int, a: int, b: int) -> float:
    if row < 0:
        return float(torch.linalg.vector_norm(clip.root_position[b] - clip.root_position[a]))
    return float(rotations.angle_between(clip.rotations[a, row], clip.rotations[b, row]))


def _spikes(places: Places) -> Iterator[Finding]:
    clip = places.clip
    together: dict[tuple[int, int, bool], list[Spike]] = {}
    for spike in find_spikes(clip):
        moved = spike.row < 0
        together.setdefault((*spike.frames, moved), []).append(spike)
    for (first, last, moved), group in sorted(together.items()):
        step = group[0].step
        size = max(_distance(clip, spike.row, step, step + 1) for spike in group)
        dt = (clip.times[step + 1] - clip.times[step]).item()
        unit = "m" if moved else "rad"
        back = group[0].back
        ends = "" if back is None else f" and back {back - step} later"
        yield places.finding(
            "spike",
            severity(size, ROOT_SPIKE_MAJOR if moved else SPIKE_ANGLE_MAJOR),
            f"jumps by {size:.2f} {unit} in one frame ({size / dt:.0f} {unit}/s){ends}",
            (first, last),
            size,
            unit,
            "--fix OUT interpolates over it.",
            [clip.joint_names[max(spike.row, 0)] for spike in group],
        )


# ---------------------------------------------------------------------- loops


def seam_pose(clip: Clip) -> tuple[np.ndarray, float]:
    """How far the last pose is from the first, which it should be: (J,) rad, and m of height."""
    turn = rotations.from_heading(torch.tensor(cycle_transform(clip).heading, dtype=torch.float64))
    first = torch.cat((rotations.multiply(turn, clip.rotations[0, :1]), clip.rotations[0, 1:]))
    height = (clip.root_position[-1, 2] - clip.root_position[0, 2]).item()
    return rotations.angle_between(first, clip.rotations[-1]).numpy(), height


def closes(clip: Clip) -> bool:
    """Whether a looping clip's poses meet at the seam."""
    angles, height = seam_pose(clip)
    return max(float(angles.max()), RAD_PER_METRE * abs(height)) <= SEAM


def _seam(places: Places) -> Iterator[Finding]:
    clip = places.clip
    angles, height = seam_pose(clip)
    size = np.maximum(angles, np.eye(len(angles))[0] * RAD_PER_METRE * abs(height))
    ends = (clip.num_frames - 1, clip.num_frames - 1)
    if size.max() > SEAM:
        yield places.finding(
            "seam_pose",
            severity(float(size.max()), SEAM_MAJOR),
            f"the loop does not close: its last pose is {angles.max():.2f} rad"
            f"{f' and {100 * height:+.1f} cm of height' if abs(height) > 0.005 else ''} "
            "from its first",
            ends,
            float(size.max()),
            "rad",
            "--fix OUT shares the difference out on either side of the seam.",
            [
                n
                for n, s in zip(clip.joint_names, size, strict=True)
                if s > max(SEAM, 0.5 * size.max())
            ],
        )
    w = speeds(clip)
    jump = np.linalg.norm(w[-1] - w[0], axis=-1)
    usual = np.linalg.norm(np.diff(w, axis=0), axis=-1).max(0, initial=0.0)
    excess = jump - SEAM_RATIO * usual
    joint = int(excess.argmax())
    if excess[joint] > SEAM_SPEED:
        yield places.finding(
            "seam_velocity",
            severity(float(excess[joint]), SEAM_SPEED_MAJOR),
            f"the velocity jumps by {jump[joint]:.1f} rad/s where the loop begins again",
            ends,
            float(jump[joint]),
            "rad/s",
            "--fix OUT blends over the seam.",
            [clip.joint_names[joint]],
        )
    heading = cycle_transform(clip).heading
    if abs(heading) > TURNING:
        yield places.finding(
            "turning",
            Severity.MINOR,
            f"each cycle turns by {np.degrees(heading):+.1f}° (left is positive)",
            None,
            abs(heading),
            "rad",
            "If that is not meant, choose another cycle.",
        )
