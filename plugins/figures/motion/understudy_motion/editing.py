"""Edits of clips: pure functions, from clip to clip. Whence a clip is (source, licence) is kept."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy_motion.clip import Clip, align_signs, cycle_transform, resample, sample, velocities
from understudy_motion.kinematics import forward_kinematics, need_skeleton
from understudy_tensors import rotations

__all__ = [
    "BLEND_SECONDS",
    "EVEN",
    "bridge",
    "close_loop",
    "cut",
    "evenly_spaced",
    "find_loop",
    "reach",
    "remove_frames",
    "shift",
    "smooth",
]

BLEND_SECONDS = 0.3
"""At each end of a loop: how long the blend over its seam takes. About a quarter of a gait cycle, so
that a pose difference of 0.5 rad is closed at under 3 rad/s, a fraction of a limb's own speed."""

EVEN = 0.01
"""Relative deviation up to which frames count as evenly spaced: what files round durations to."""
MAX_FRAMES = 20_000
"""Of a clip that is evened out: ten minutes at 30 frames/s, three at 120."""

SEARCH_FRAMES = 900
"""Frames that the search for a loop compares, all with all; a longer clip is searched at a lower
rate, then refined."""

MIN_LOOP_SECONDS = 0.4
"""The shortest loop: a sprinter's gait cycle, 5 steps/s."""

WORST_LOOP = 0.4
"""rad of mismatch from which two poses are different ones: a walk's own at opposite steps differ by
0.5."""

_SEARCH_RATE = 30.0
#: What differences are worth in a mismatch, in rad: a metre bends a leg by about 3 rad, and a velocity
#: difference is closed within about 0.1 s.
_RAD_PER_METRE, _CLOSING_SECONDS = 3.0, 0.1
#: Of two loops about as good the shorter is taken: one gait cycle rather than two.
_ABOUT_AS_GOOD, _ABOUT_AS_GOOD_RAD = 1.25, 0.03


def cut(clip: Clip, start: float, stop: float) -> Clip:
    """The part from `start` to `stop` s, which does not loop; its time begins at 0.

    Raises
    ------
    ConfigError
        the part is empty, or not within the clip.
    """
    if not 0.0 <= start < stop <= clip.duration:
        raise ConfigError(
            f"Clip {clip.name} cannot be cut from {start:g} to {stop:g} s: it lasts from 0 to "
            f"{clip.duration:g} s."
        )
    inner = clip.times[(clip.times > start + 1e-9) & (clip.times < stop - 1e-9)]
    ends = torch.tensor([start, stop], dtype=torch.float64)
    times = torch.cat((ends[:1], inner, ends[1:]))
    position, rotation = sample(replace(clip, loop=False), times)
    return replace(
        clip, times=times - start, root_position=position, rotations=rotation, loop=False
    )


def shift(clip: Clip, offset: Tensor) -> Clip:
    """The clip moved by `offset` m, world: (3,) for all frames, or (F, 3)."""
    return replace(clip, root_position=clip.root_position + offset)


def evenly_spaced(clip: Clip) -> Clip:
    """The clip at evenly spaced frames, as many a second as it mostly has; itself if they are that.

    Raises
    ------
    ConfigError
        these would be more than :data:`MAX_FRAMES`.
    """
    steps = clip.times.diff()
    usual = steps.median().item()
    if clip.duration / usual > MAX_FRAMES:
        raise ConfigError(
            f"Clip {clip.name}: {clip.duration / usual:.0f} frames of {usual:g} s are too many; cut it, "
            f"or take every second frame (at most {MAX_FRAMES})."
        )
    if (steps / usual - 1.0).abs().max() <= EVEN:
        return clip
    return resample(clip, 1.0 / usual)


def remove_frames(clip: Clip, frames: Sequence[int], *, close_up: bool = False) -> Clip:
    """The clip without these frames, at least two of which stay, the first and the last among them.

    What is missing is interpolated over; with `close_up` the time it took is taken out instead.
    """
    keep = torch.ones(clip.num_frames, dtype=torch.bool)
    keep[list(frames)] = False
    times = clip.times
    if close_up:
        steps = times.diff() * keep[1:]
        times = torch.cat((times[:1], steps.cumsum(0)))
    return replace(
        clip,
        times=times[keep],
        root_position=clip.root_position[keep],
        rotations=clip.rotations[keep],
    )


def bridge(clip: Clip, joint: str, first: int, last: int) -> Clip:
    """The joint's rotation, for the root also the position, in frames `first` to `last` replaced by
    the interpolation between the frames around them; at an end of the clip by the frame beside."""
    row = clip.joint_names.index(joint)
    before, after = first - 1, last + 1
    before, after = (
        (before if before >= 0 else after),
        (after if after < clip.num_frames else before),
    )
    rotation, position = clip.rotations.clone(), clip.root_position.clone()
    span = (clip.times[after] - clip.times[before]).clamp(min=1e-12)
    t = (clip.times[first : last + 1] - clip.times[before]) / span
    ends = clip.rotations[before, row], clip.rotations[after, row]
    rotation[first : last + 1, row] = rotations.slerp(*ends, t)
    if row == 0:
        position[first : last + 1] = torch.lerp(position[before], position[after], t[:, None])
    return replace(clip, rotations=rotation, root_position=position)


def smooth(clip: Clip, cutoff: float) -> Clip:
    """The clip low-pass filtered at `cutoff` Hz, without delay: Butterworth, fourth order in all, as
    is usual in gait analysis (Winter, "Biomechanics and Motor Control of Human Movement", 2009, ch. 3).

    The frames must be evenly spaced. A looping clip stays one. Unchanged if the clip's rate has
    nothing above the cutoff, or if it is shorter than the cutoff's period.
    """
    nyquist = 0.5 * clip.frame_rate
    pad = math.ceil(2.0 * clip.frame_rate / cutoff)
    if cutoff >= 0.95 * nyquist or clip.duration * cutoff < 1.0:
        return clip
    from scipy.signal import butter, sosfiltfilt  # half a second, and few filter

    sections = butter(2, cutoff / nyquist, output="sos")
    if clip.loop:
        steps = torch.arange(-pad, clip.num_frames + pad, dtype=torch.float64)
        position, rotation = sample(clip, steps * (clip.duration / (clip.num_frames - 1)))
        rotation = align_signs(rotation)
        own = slice(pad, pad + clip.num_frames)
        low = sosfiltfilt(sections, position.numpy(), axis=0, padlen=0)[own]
        turned = sosfiltfilt(sections, rotation.numpy(), axis=0, padlen=0)[own]
    else:
        pad = min(pad, clip.num_frames - 1)
        low = sosfiltfilt(sections, clip.root_position.numpy(), axis=0, padlen=pad)
        turned = sosfiltfilt(sections, clip.rotations.numpy(), axis=0, padlen=pad)
    return replace(
        clip,
        root_position=torch.from_numpy(low.copy()),
        rotations=rotations.normalize(torch.from_numpy(turned.copy())),
    )


# ---------------------------------------------------------------------- loops


def close_loop(clip: Clip, blend: float = BLEND_SECONDS) -> Clip:
    """A looping clip: the differences between its last pose and its first, and between their
    velocities, are shared out over `blend` s (at most half the clip) at either end.

    What the root gains in the plane over the clip, a displacement and a turn, is kept: it is what
    one cycle adds. Corrections are cubic in time, in the tangent space of each joint's rotation, so
    poses and velocities stay continuous. The frames must be evenly spaced.
    """
    for _ in range(2):  # the second pass closes what the first leaves of the second order
        clip = _blend_seam(clip, min(blend, 0.5 * clip.duration))
    position, rotation = clip.root_position.clone(), clip.rotations.clone()
    transform = cycle_transform(clip)
    turn = rotations.from_heading(torch.tensor(transform.heading, dtype=torch.float64))
    rotation[-1] = rotation[0]
    rotation[-1, 0] = rotations.multiply(turn, rotation[0, 0])
    position[-1, 2] = position[0, 2]
    return replace(clip, root_position=position, rotations=rotation, loop=True)


def _blend_seam(clip: Clip, blend: float) -> Clip:
    turn = rotations.from_heading(torch.tensor(-cycle_transform(clip).heading, dtype=torch.float64))
    q, p, times = clip.rotations, clip.root_position, clip.times
    last = torch.cat((rotations.multiply(turn, q[-1, :1]), q[-1, 1:]))
    pose = rotations.to_exponential_map(rotations.multiply(rotations.conjugate(q[0]), last))
    # in the joint's own frame, like the corrections
    steps = rotations.to_exponential_map(rotations.multiply(rotations.conjugate(q[:-1]), q[1:]))
    first_rate, last_rate = _end_rates(steps, times)
    height = torch.zeros(3, dtype=torch.float64)
    height[2] = p[-1, 2] - p[0, 2]
    first_velocity, last_velocity = _end_rates(p.diff(dim=0), times)
    last_velocity = rotations.rotate(turn, last_velocity)

    value, slope = _ramp(times, blend)
    value_end, slope_end = _ramp(times[-1] - times, blend)
    slope_end = -slope_end  # its time runs backwards
    rate = 0.5 * (last_rate - first_rate)
    bend = 0.5 * (value - value_end)[:, None, None] * pose
    bend = bend + (slope - slope_end)[:, None, None] * rate
    velocity = 0.5 * (last_velocity - first_velocity)
    move = 0.5 * value[:, None] * height + slope[:, None] * velocity
    move_end = -0.5 * value_end[:, None] * height - slope_end[:, None] * velocity
    move = move + rotations.rotate(rotations.conjugate(turn), move_end)
    return replace(
        clip,
        root_position=p + move,
        rotations=rotations.multiply(q, rotations.from_exponential_map(bend)),
    )


def _end_rates(steps: Tensor, times: Tensor) -> tuple[Tensor, Tensor]:
    """Velocities at the first and the last frame, by extrapolation from the two steps beside."""
    dt = times.diff().view(-1, *[1] * (steps.dim() - 1))
    rates = steps / dt
    if len(rates) < 2:
        return rates[0], rates[-1]
    first = rates[0] + (rates[0] - rates[1]) * dt[0] / (dt[0] + dt[1])
    last = rates[-1] + (rates[-1] - rates[-2]) * dt[-1] / (dt[-1] + dt[-2])
    return first, last


def _ramp(times: Tensor, blend: float) -> tuple[Tensor, Tensor]:
    """Hermite's cubics over [0, blend], zero after: one begins at value 1, one with slope 1."""
    u = (times / blend).clamp(0.0, 1.0)
    return 1.0 - u**2 * (3.0 - 2.0 * u), blend * u * (1.0 - u) ** 2


@dataclass(frozen=True)
class Loop:
    """Two frames between which a clip can loop."""

    first: int
    last: int
    mismatch: float
    """rad: root mean square over the joints of what the blend has to close."""


def find_loop(clip: Clip, contacts: Tensor | None = None) -> Loop | None:
    """Two frames of matching pose, velocities and contacts, a whole cycle of the motion apart.

    Of the loops that match about as well as the best one, the shortest. A loop must run through at
    least half the variety of poses in the clip, so that standing still is none in a clip that walks;
    and where feet come down in the clip, each of them must within the loop, all equally often.

    Parameters
    ----------
    clip
        not looping, at evenly spaced frames.
    contacts
        (F, K) bool, which of K feet are on the ground.

    Returns
    -------
    Loop | None
        The frames and their mismatch; None if no two frames fit.
    """
    stride = max(
        1, round(clip.frame_rate / _SEARCH_RATE), math.ceil(clip.num_frames / SEARCH_FRAMES)
    )
    every = torch.arange(0, clip.num_frames, stride)
    features = _Features.of(clip)
    pose, mismatch = features.differences(every, every)
    lag = (every[None] - every[:, None]) / clip.frame_rate
    possible = (lag >= MIN_LOOP_SECONDS - 1e-9) & (mismatch < WORST_LOOP)
    possible &= _variety(pose)
    if contacts is not None:
        possible &= _whole_cycles(contacts, every)
    if not possible.any():
        return None
    mismatch = torch.where(possible, mismatch, torch.inf)
    best = mismatch.min().item()
    good = mismatch <= max(_ABOUT_AS_GOOD * best, best + _ABOUT_AS_GOOD_RAD)
    shortest = lag[good].min()
    near = good & (lag <= 1.15 * shortest)
    place = torch.where(near, mismatch, torch.inf).argmin().item()
    first, last = (int(every[i]) for i in divmod(int(place), len(every)))
    return _refined(features, contacts, first, last, stride)


@dataclass(frozen=True)
class _Features:
    """What must match, per frame; the place and the heading of the root do not count."""

    joints: Tensor  #: (F, J - 1, 4)
    up: Tensor  #: (F, 3) the vertical in the root's frame
    rates: Tensor  #: (F, 3 J) rad/s and rad-worth of m/s, in the root's or the parents' frames
    height: Tensor  #: (F, 1) m

    @staticmethod
    def of(clip: Clip) -> _Features:
        linear, angular = velocities(clip)
        root = clip.rotations[:, 0]
        vertical = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
        spin = rotations.inverse_rotate(root, angular[:, 0])
        move = _RAD_PER_METRE * rotations.inverse_rotate(root, linear)
        return _Features(
            clip.rotations[:, 1:],
            rotations.inverse_rotate(root, vertical),
            torch.cat((move, spin, angular[:, 1:].flatten(1)), dim=1),
            clip.root_position[:, 2:],
        )

    def differences(self, rows: Tensor, columns: Tensor) -> tuple[Tensor, Tensor]:
        """(A, B) rad, root mean squares over the joints: of the poses, and with the velocities."""
        total = (_RAD_PER_METRE * torch.cdist(self.height[rows], self.height[columns])) ** 2
        total += torch.acos((self.up[rows] @ self.up[columns].T).clamp(-1.0, 1.0)) ** 2
        for joint in self.joints.unbind(1):
            cosine = (joint[rows] @ joint[columns].T).abs().clamp(max=1.0)
            total += (2.0 * torch.acos(cosine)) ** 2
        count = self.joints.shape[1] + 1
        closing = (_CLOSING_SECONDS * torch.cdist(self.rates[rows], self.rates[columns])) ** 2
        return (total / count).sqrt(), ((total + closing) / count).sqrt()


def _variety(pose: Tensor) -> Tensor:
    """(n, n) bool: the poses from i to j get at least half as far from pose i as any of the clip."""
    reached = torch.cummax(torch.triu(pose), dim=1).values
    return reached >= 0.5 * pose.max()


def _whole_cycles(contacts: Tensor, every: Tensor) -> Tensor:
    """(n, n) bool: the contacts agree, and every foot that comes down does so equally often between."""
    contacts = contacts.to(torch.long)
    landings = (contacts.diff(dim=0) == 1).to(torch.long).cumsum(0)
    landings = torch.cat((torch.zeros_like(landings[:1]), landings))[:, contacts.any(0)]
    walking = landings[-1] > 0
    state, landings = contacts[every], landings[every][:, walking]
    same = (state[:, None] == state[None]).all(-1)
    if landings.shape[1] == 0:
        return same
    count = landings[None] - landings[:, None]
    return same & (count > 0).all(-1) & (count == count[..., :1]).all(-1)


def _refined(
    features: _Features, contacts: Tensor | None, first: int, last: int, stride: int
) -> Loop:
    """The best pair of frames within a stride of the two that were found."""
    frames = len(features.height)
    rows = torch.arange(max(0, first - stride + 1), min(frames, first + stride))
    columns = torch.arange(max(0, last - stride + 1), min(frames, last + stride))
    _, mismatch = features.differences(rows, columns)
    if contacts is not None:
        same = (contacts[rows][:, None] == contacts[columns][None]).all(-1)
        mismatch = torch.where(same, mismatch, torch.inf)
    row, column = divmod(int(mismatch.argmin()), len(columns))
    return Loop(int(rows[row]), int(columns[column]), mismatch[row, column].item())


# ---------------------------------------------------------------------- limbs


def reach(
    clip: Clip, end: str, displacement: Tensor, bend_axis: Sequence[float] | None = None
) -> Clip:
    """The joint `end` (an ankle) moved by `displacement` (F, 3) m, world, by turning the two joints
    above it (knee and hip); its own rotation in the world stays, and so does everything else.

    The middle joint bends about `bend_axis`, in its own frame, or if None in the limb's plane; then
    the upper one turns by the least that brings the end to its place. Where it is out of reach, the
    limb is stretched, or bent, as far as it goes.

    Raises
    ------
    FileError
        the clip has no skeleton.
    ConfigError
        fewer than two joints are above `end`.
    """
    skeleton = need_skeleton(clip)
    c = clip.joint_names.index(end)
    b = skeleton.parents[c]
    a = skeleton.parents[b] if b >= 0 else -1
    if a <= 0:
        raise ConfigError(
            f"'{end}' has no two joints between it and the root, which could move it."
        )
    positions, world = forward_kinematics(clip)
    goal = positions[:, c] + displacement - positions[:, a]
    # In the upper joint's frame: the upper bone, the lower bone, the axis of the bend.
    upper = torch.as_tensor(skeleton.offsets[b], dtype=torch.float64).expand(len(goal), 3)
    local = clip.rotations[:, b]
    lower = rotations.rotate(local, torch.as_tensor(skeleton.offsets[c], dtype=torch.float64))
    if bend_axis is None:
        side = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
        axis = torch.linalg.cross(upper, lower)
        length = torch.linalg.vector_norm(axis, dim=-1, keepdim=True)
        axis = torch.where(length > 1e-6, axis / length.clamp(min=1e-6), side)
    else:
        axis = rotations.rotate(local, torch.as_tensor(bend_axis, dtype=torch.float64))
    bend = rotations.from_axis_angle(axis, _bend(upper, lower, axis, goal.square().sum(-1)))
    local = rotations.multiply(bend, local)
    straight = rotations.rotate(world[:, a], upper + rotations.rotate(bend, lower))
    hip = rotations.multiply(_shortest_arc(straight, goal), world[:, a])
    knee = rotations.multiply(hip, local)
    result = clip.rotations.clone()
    above = world[:, skeleton.parents[a]]
    result[:, a] = rotations.multiply(rotations.conjugate(above), hip)
    result[:, b] = local
    result[:, c] = rotations.multiply(rotations.conjugate(knee), world[:, c])
    return replace(clip, rotations=result)


def _bend(upper: Tensor, lower: Tensor, axis: Tensor, square: Tensor) -> Tensor:
    """(F,) rad: the least turn of `lower` about `axis` after which |upper + lower|^2 is `square`.

    ``upper . turned lower`` is ``k + C cos(angle) + S sin(angle)``, by Rodrigues' formula.
    """

    def dot(x: Tensor, y: Tensor) -> Tensor:
        return (x * y).sum(-1)

    along = dot(upper, axis) * dot(lower, axis)
    cosine = dot(upper, lower) - along
    sine = dot(upper, torch.linalg.cross(axis, lower))
    wanted = 0.5 * (square - dot(upper, upper) - dot(lower, lower)) - along
    half = torch.acos((wanted / torch.hypot(cosine, sine).clamp(min=1e-12)).clamp(-1.0, 1.0))
    centre = torch.atan2(sine, cosine)
    choices = torch.stack((centre + half, centre - half))
    choices = torch.remainder(choices + math.pi, 2.0 * math.pi) - math.pi
    return choices.gather(0, choices.abs().argmin(0, keepdim=True))[0]


def _shortest_arc(a: Tensor, b: Tensor) -> Tensor:
    """The least rotation that turns the direction of `a` into that of `b`: (F, 3) twice -> (F, 4)."""
    axis = torch.linalg.cross(a, b)
    sine = torch.linalg.vector_norm(axis, dim=-1, keepdim=True)
    angle = torch.atan2(sine, (a * b).sum(-1, keepdim=True))
    return rotations.from_exponential_map(angle * axis / sine.clamp(min=1e-12))
