"""Flights that obey gravity: the centre of mass on a parabola, the angular momentum constant.

The poses of a flight stay, joint by joint, and so do its ends; the whole figure is moved and turned in
between. Where a flight falls at another rate than g it lasts as long as it would at g, if that moves
the figure less.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import torch
from scipy.optimize import least_squares

from understudy_characters.character import Character
from understudy_characters.letting_go import Bodies, bodies_of
from understudy_doctor.findings import intervals
from understudy_doctor.measurements import GRAVITY, Measurements
from understudy_motion.clip import Clip, sample
from understudy_tensors import rotations

ALOFT = 0.01
"""m above the ground from which on nothing carries the figure: what is lower may be a foot that leaves."""
SHORTEST = 0.2
"""s: in a shorter flight nothing gets far."""
RATE = 60.0
"""Hz: between fewer frames a flight is no parabola, since poses are interpolated."""
STRETCH = (0.75, 1.35)
"""Times as long as it was: by how much a flight may be stretched; beyond it is another motion."""
FARTHEST = 0.25
"""m: a flight that is farther off is none, or another motion than the clip's."""
LESS = 0.8
"""Times: stretching is worth it where it moves the figure by less than this share of what it would be."""


@dataclass(frozen=True)
class Flight:
    """A stretch of frames in which the figure is in the air; the ends are still, or again, on the ground."""

    first: int
    last: int

    @property
    def frames(self) -> slice:
        return slice(self.first, self.last + 1)


def flights(measured: Measurements) -> list[Flight]:
    """The flights of a motion, none of which crosses the seam of a loop."""
    high = measured.heights.min(1) - measured.ground > ALOFT
    least = max(3, round(SHORTEST / measured.dt))
    return [
        Flight(first - 1, last + 1)
        for first, last in intervals(high, least=least)
        if first > 0 and last + 1 < len(high)
    ]


def _during(measured: Measurements, start: float, stop: float) -> Flight:
    """The flight whose middle is between `start` and `stop` s; those frames if there is none any more."""
    for flight in flights(measured):
        if start <= 0.5 * (flight.first + flight.last) * measured.dt <= stop:
            return flight
    return Flight(
        round(start / measured.dt), min(round(stop / measured.dt), len(measured.times) - 1)
    )


def mend_flights(clip: Clip, character: Character) -> tuple[Clip, list[str]]:
    """Every flight on its parabola, with constant angular momentum; and what was done, in words."""
    done = []
    measured = Measurements(_at_least(clip, RATE), character)
    spans = [
        (flight.first * measured.dt, flight.last * measured.dt) for flight in flights(measured)
    ]
    for start, stop in reversed(spans):  # so that none moves in time before its turn
        as_it_was, flight = measured, _during(measured, start, stop)
        factor = _stretch(measured, flight)
        if factor != 1.0:
            measured = Measurements(_stretched(measured.clip, flight, factor), character)
            stop = start + factor * (stop - start)
            flight = _during(measured, start, stop)
        if straying(measured, flight) > FARTHEST:
            measured = as_it_was
            continue
        mended, moved, turned = _flown(measured, flight)
        lasts = f", {factor:.2f} times as long" if factor != 1.0 else ""
        done.insert(
            0,
            f"flew {start:.2f}–{stop:.2f} s on a parabola with constant angular momentum{lasts}, moving "
            f"the body by up to {100 * moved:.0f} cm and {turned:.2f} rad",
        )
        measured = Measurements(mended, character)
    return (measured.clip, done) if done else (clip, [])


def _at_least(clip: Clip, rate: float) -> Clip:
    """The clip with so many evenly spaced frames a second, or its own if those are as many."""
    if clip.frame_rate >= rate:
        return clip
    frames = math.ceil(clip.duration * rate) + 1
    times = torch.linspace(0.0, clip.duration, frames, dtype=torch.float64)
    position, rotation = sample(replace(clip, loop=False), times)
    return replace(clip, times=times, root_position=position, rotations=rotation)


def straying(measured: Measurements, flight: Flight) -> float:
    """m: how far the centre of mass is, at most, from the parabola through its flight's ends."""
    centre = measured.centre[flight.frames]
    return float(np.linalg.norm(_parabola(centre, measured.dt) - centre, axis=1).max())


def _parabola(centre: np.ndarray, dt: float, gravity: float = GRAVITY) -> np.ndarray:
    """(F, 3) m: the path from the first to the last of `centre` (F, 3) that falls at `gravity`."""
    clock, whole = dt * np.arange(len(centre))[:, None], dt * (len(centre) - 1)
    path = centre[0] + (centre[-1] - centre[0]) * clock / whole
    path[:, 2:] += 0.5 * gravity * clock * (whole - clock)
    return path


def _stretch(measured: Measurements, flight: Flight) -> float:
    """How many times as long the flight is to last; 1 where that would not move the figure less."""
    centre, dt = measured.centre[flight.frames], measured.dt
    clock, whole = dt * np.arange(len(centre)), dt * (len(centre) - 1)
    line = centre[0, 2] + (centre[-1, 2] - centre[0, 2]) * clock / whole
    arch = 0.5 * clock * (whole - clock)
    falls = float((centre[:, 2] - line) @ arch / (arch @ arch))  # m/s², by least squares
    factor = math.sqrt(max(falls, 0.0) / GRAVITY)
    if not STRETCH[0] <= factor <= STRETCH[1]:
        return 1.0
    moved = [np.abs(_parabola(centre, dt, g) - centre).max() for g in (GRAVITY, falls)]
    return factor if moved[1] < LESS * moved[0] else 1.0


def _stretched(clip: Clip, flight: Flight, factor: float) -> Clip:
    """The flight lasts `factor` times as long, all else as long as before; frames are evenly spaced."""
    step = clip.duration / (clip.num_frames - 1)
    begin, end = flight.first * step, flight.last * step
    later = (factor - 1.0) * (end - begin)
    duration = clip.duration + later
    frames = round(duration / step) + 1
    times = torch.linspace(0.0, duration, frames, dtype=torch.float64)
    knots = np.array([0.0, begin, end + later, duration])
    before = torch.from_numpy(np.interp(times, knots, [0.0, begin, end, clip.duration]))
    before[-1] = clip.duration
    position, rotation = sample(replace(clip, loop=False), before)
    return replace(clip, times=times, root_position=position, rotations=rotation)


def _flown(measured: Measurements, flight: Flight) -> tuple[Clip, float, float]:
    """The clip with the flight's figure moved and turned; by how much at most, m and rad."""
    clip, during = measured.clip, flight.frames
    whole = _bodies(measured, flight)
    path = _parabola(whole.centres, measured.dt)
    momentum = least_squares(
        lambda kept: rotations.to_exponential_map(_turns(whole, kept, measured.dt)[-1:])[0].numpy(),
        whole.spins[1:-1].mean(0),
        x_scale=np.maximum(np.abs(whole.spins).max(0), 1.0),
        max_nfev=50,
    ).x
    turns = _turns(whole, momentum, measured.dt)
    centres = torch.from_numpy(whole.centres)
    position, rotation = clip.root_position.clone(), clip.rotations.clone()
    arm = position[during] - centres
    position[during] = torch.from_numpy(path) + rotations.rotate(turns, arm)
    rotation[during, 0] = rotations.multiply(turns, rotation[during, 0])
    most = float(np.linalg.norm(path - whole.centres, axis=1).max())
    turned = float(torch.linalg.vector_norm(rotations.to_exponential_map(turns), dim=1).max())
    return replace(clip, root_position=position, rotations=rotation), most, turned


def _bodies(measured: Measurements, flight: Flight) -> Bodies:
    """The figure as one body in the flight, with the velocities of its poses."""
    model = measured.character.model
    qpos = measured.qpos[flight.frames].numpy()
    steps = np.zeros((len(qpos) - 1, model.nv))
    for row, before, after in zip(steps, qpos[:-1], qpos[1:], strict=True):
        mujoco.mj_differentiatePos(model, row, measured.dt, before, after)
    ends: Sequence[np.ndarray] = (steps[:1], 0.5 * (steps[1:] + steps[:-1]), steps[-1:])
    return bodies_of(measured.character, qpos, np.concatenate(ends))


def _turns(whole: Bodies, momentum: np.ndarray, dt: float) -> torch.Tensor:
    """(F, 4): by what a body with this angular momentum is turned from the motion's, frame by frame,
    where it begins as that does (see ``letting_go``)."""
    turn = torch.tensor([[1.0, 0.0, 0.0, 0.0]], dtype=torch.float64)
    kept, turns = torch.from_numpy(momentum)[None], [turn]
    for frame in range(1, len(whole.spins)):
        halves = slice(frame - 1, frame + 1)
        own = rotations.rotate(rotations.conjugate(turn), kept)[0].numpy()
        rates = np.einsum("fij,fj->fi", whole.inverses[halves], own - whole.spins[halves]).mean(0)
        step = rotations.from_exponential_map(torch.from_numpy(rates * dt)[None])
        turn = rotations.normalize(rotations.multiply(turn, step))
        turns.append(turn)
    return torch.cat(turns)
