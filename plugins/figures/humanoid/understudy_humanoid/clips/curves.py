"""Curves over time from which the generated clips are put together."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.interpolate import BPoly, CubicSpline, PchipInterpolator

from understudy_humanoid.clips.figure import GRAVITY, Array, Known, Mask, Pose, centre_of_mass

_ROUNDS = 60
_EXACT = 1e-7  # m


def ease(place: Array) -> Array:
    """From 0 at 0 to 1 at 1, at rest with zero acceleration there: 10 s^3 - 15 s^4 + 6 s^5.

    The path of minimum jerk (Flash and Hogan 1985), by which people move from rest to rest.
    """
    s = np.clip(place, 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def between(times: Array, start: float, stop: float) -> Array:
    """:func:`ease` from `start` to `stop` seconds."""
    return ease((times - start) / (stop - start))


def spline(keys: Array, leaving: ArrayLike, meeting: ArrayLike) -> CubicSpline:
    """The cubic spline through `keys` (n, 1 + K), rows of a time and K values, that begins and ends
    with the velocities `leaving` and `meeting` (K,)."""
    ends: Any = ((1, leaving), (1, meeting))  # scipy's stubs know only names
    return CubicSpline(keys[:, 0], keys[:, 1:], bc_type=ends)


def through(times: Array, keys: ArrayLike) -> Array:
    """Smooth curves through `keys` (n, 1 + K), rows of a time and K values, at rest at both ends.

    Cubic splines; before the first and after the last key the values are held. (F,) -> (F, K).
    """
    keys = np.asarray(keys, dtype=float)
    still = np.zeros(keys.shape[1] - 1)
    curve = spline(keys, still, still)
    return curve(np.clip(times, keys[0, 0], keys[-1, 0]))


def monotone(times: Array, keys: ArrayLike) -> Array:
    """A smooth curve through `keys` (n, 2) that is never beyond neighbouring ones (PCHIP), (F,) -> (F,).

    Before the first and after the last key the value is held; at rest only if two keys there agree.
    """
    keys = np.asarray(keys, dtype=float)
    curve = PchipInterpolator(keys[:, 0], keys[:, 1])
    return curve(np.clip(times, keys[0, 0], keys[-1, 0]))


def around(times: Array, keys: ArrayLike, period: float) -> Array:
    """Smooth periodic curves through `keys` (n, 1 + K) of one period. (F,) -> (F, K)."""
    keys = np.asarray(keys, dtype=float)
    closed = np.vstack([keys, keys[:1]])
    closed[-1, 0] += period
    return CubicSpline(closed[:, 0], closed[:, 1:], bc_type="periodic")(times)


def bridged(
    times: Array,
    known: Mask,
    values: Array,
    keys: ArrayLike,
    *,
    period: float | None = None,
    brake: float | None = None,
) -> Array:
    """`values` (F, K) where they are `known` (F,), and elsewhere curves that join them smoothly.

    A bridge is a cubic spline through those `keys` (n, 1 + K) that lie within the gap; it leaves and
    meets the known values with their velocity.

    Parameters
    ----------
    times
        (F,) s, evenly spaced, without the end of the `period` if there is one.
    known
        (F,) bool; known values come at least three in a row.
    keys
        rows of a time and K values.
    period
        of a motion that repeats, s; `keys` are then within one period from ``times[0]``.
    brake
        s in which a bridge loses the velocity with which it begins, and gains that with which
        it ends: fast joints do not overshoot. Keys closer to the ends do not count.
    """
    keys = np.asarray(keys, dtype=float)
    if period is not None:
        count, shift = len(times), np.zeros(keys.shape[1])
        shift[0] = period
        return bridged(
            np.concatenate([times - period, times, times + period]),
            np.tile(known, 3),
            np.tile(values, (3, 1)),
            np.concatenate([keys - shift, keys, keys + shift]),
            brake=brake,
        )[count : 2 * count]
    result, step, margin = values.copy(), times[1] - times[0], brake or 0.0
    edges = np.flatnonzero(np.diff(known.astype(int)))
    for start, stop in zip(edges, edges[1:] + 1, strict=False):
        if known[start + 1]:
            continue
        before, after = values[start - 2 : start + 1], values[stop : stop + 3]
        leaving = np.array([0.5, -2.0, 1.5]) @ before / step
        meeting = np.array([-1.5, 2.0, -0.5]) @ after / step
        first, last = times[start], times[stop]
        rows = keys[(keys[:, 0] > first + margin) & (keys[:, 0] < last - margin)]
        if brake:
            braked = np.append(first + brake, before[-1] + 0.5 * brake * leaving)
            sped = np.append(last - brake, after[0] - 0.5 * brake * meeting)
            rows = np.vstack([braked, rows, sped])
        ends = np.append(first, before[-1]), np.append(last, after[0])
        knots = np.vstack([ends[0], rows, ends[1]])
        gap = slice(start + 1, stop)
        result[gap] = spline(knots, leaving, meeting)(times[gap])
    return result


def bounce(times: Array, contact: float, period: float, drop: float) -> Array:
    """Height (F,) m of a centre of mass that is thrown up again and again, from zero at touchdown.

    It is on the floor from 0 to `contact` and flies from there to `period`, s, as gravity wants; it
    touches down `drop` m lower than it took off. On the floor it is the quintic that meets the
    flight in height, velocity and acceleration, so that the force on the floor begins and ends at 0.
    """
    within = times % period
    flight = period - contact
    off = 0.5 * GRAVITY * flight - drop / flight
    stance = BPoly.from_derivatives(
        [0.0, contact], [[0.0, off - GRAVITY * flight, -GRAVITY], [drop, off, -GRAVITY]]
    )
    flown = within - contact
    falling = drop + off * flown - 0.5 * GRAVITY * flown**2
    return np.where(within < contact, stance(np.minimum(within, contact)), falling)


def inverted_pendulum(support: Array, step: float, height: float) -> Array:
    """The path (F, K) m of a centre of mass that is `height` m above the floor and is held up near
    `support` (F, K) m, given every `step` s; it begins and ends over its support, at rest.

    The linear inverted pendulum ``c - (height / g) c'' = support`` (Kajita et al. 2001) in the least
    squares' sense: near the ends the support gives way a little, as people push off to get going.
    """
    count, stiffness = len(support), height / (GRAVITY * step**2)
    inner = slice(3, -3)
    one: Any = sparse.eye_array(count, format="csc")  # scipy's stubs cannot slice it
    pendulum = one[1:-1] - stiffness * (one[:-2] - 2.0 * one[1:-1] + one[2:])
    ends = [0, 1, 2, -3, -2, -1]
    path = np.repeat(support[[0, -1]], [3, count - 3], axis=0)
    path[inner] = 0.0
    wanted = support[1:-1] - pendulum[:, ends] @ path[ends]
    free = pendulum[:, inner]
    path[inner] = sparse.linalg.spsolve(free.T @ free, free.T @ wanted).reshape(path[inner].shape)
    return path


def carried(
    goal: Array,
    build: Callable[[Array], Pose],
    *,
    axes: tuple[int, ...] = (0, 1, 2),
    room: Callable[[Array], float] | None = None,
    start: Array | None = None,
) -> tuple[Array, Pose]:
    """The root's path (F, 3) m, and the pose, with the centre of mass at `goal` (F, 3).

    Parameters
    ----------
    goal
        m, world; along axes that are not among `axes` it is the root's own path.
    build
        the pose for a root's path; its feet may stay where they are.
    room
        how far a root's path may rise, m; with it the goal's height is known but for a
        constant, and is as high as there is room.
    start
        a root's path (F, 3) m that is nearly right, if there is one: it saves time.
    """
    goal, chosen = goal.copy(), list(axes)
    root = (goal if start is None else start).copy()
    pose, known = build(root), Known()
    for _ in range(_ROUNDS):
        error = (goal - centre_of_mass(root, pose, known))[:, chosen]
        root[:, chosen] += error
        rise = room(root) if room else 0.0
        goal[:, 2] += rise
        root[:, 2] += rise
        pose = build(root)
        if max(np.abs(error).max(), abs(rise)) < _EXACT:
            break
    return root, pose
