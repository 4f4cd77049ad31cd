"""Generated hops, on both legs or on one.

As in the run the centre of mass comes first: it flies as gravity wants and bounces on the floor in
between. The feet touch down with their fore parts, lie flat, and roll over their toes without sliding.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from understudy_humanoid.clips import figure, limbs, standing
from understudy_humanoid.clips.curves import around, bounce, carried, monotone
from understudy_humanoid.clips.limbs import PlantedLeg, arm, arm_keys, leg_keys, on_legs, planted
from understudy_motion.clip import Clip

_REACH = 0.975  #: of the leg at its longest, at take-off
_DROP = 0.02  #: m, by which the centre of mass touches down lower than it takes off
#: m, how far ahead of the ankles the centre of mass is in the middle of the contact, by legs.
_OVER = {2: 0.08, 1: 0.05}
#: Foot pitch in degrees, toe down positive, at fractions of the contact, by legs.
_PITCH = {
    2: ((0.0, 20.0), (0.25, 0.0), (0.65, 0.0), (1.0, 46.0)),
    1: ((0.0, 14.0), (0.20, 0.0), (0.70, 0.0), (1.0, 44.0)),
}
#: Degrees by which the pelvis is higher on the right, by what hops.
_LIST = {"both": 0.0, "left": 4.0, "right": -4.0}
_BRAKE = 0.05  #: s, in which a leg that has left the floor ends its stretch


@figure.remembered
def generated_hop(
    *,
    #: m by which the centre of mass rises after take-off, from 0.05 to 0.3
    height: float = 0.12,
    #: m forward, from 0 to 0.7
    distance: float = 0.0,
    #: which leg hops
    leg: Literal["both", "left", "right"] = "both",
    #: frames/s of the clip, from 10 to 1000
    frame_rate: float = 60.0,
) -> Clip:
    """One hop of many, in place or forward along +x, from the touchdown to the next.

    Returns a looping clip.

    Raises
    ------
    ConfigError
        a parameter is outside its range.
    """
    figure.check("hop", 0.05, 0.3, height=height)
    figure.check("hop", 0.0, 0.7, distance=distance)
    sides: list[figure.Side] = [side for side in figure.SIDES if leg in ("both", side)]
    contact, flight = _phases(height, len(sides))
    period = contact + flight
    motion = figure.grid("hop", period, frame_rate, cyclic=True)
    times = motion.times

    pelvis = _pelvis(times, contact, period, _LIST[leg])
    upper = _upper_body(times, contact, period, pelvis, height)
    for side in set(figure.SIDES) - set(sides):
        upper |= _free_leg(side, times, contact, period)
    middle = distance * 0.5 * contact / period - _OVER[len(sides)]
    pitch = np.radians(monotone(times / contact, _PITCH[len(sides)]))
    flying = (contact + 0.55 * flight, 16.0 + 20.0 * distance, 0.0, 28.0 + 30.0 * distance, 30.0)
    legs = []
    for side in sides:
        aside = figure.SIGN[side] * standing.HALF_WIDTH if leg == "both" else 0.0
        ankle, foot = planted(
            np.array([middle, aside]), figure.SIGN[side] * standing.TOE_OUT, pitch
        )
        keys = leg_keys(side, [flying])
        legs.append(PlantedLeg(side, times < contact, ankle, foot, keys, period, _BRAKE))

    reach = _REACH - 0.06 * height
    level = bounce(times, contact, period, _DROP) + 0.8
    root, pose = carried(
        np.stack([distance * times / period, np.zeros_like(times), level], axis=1),
        on_legs(upper, legs, times),
        room=lambda root: min(each.room(root, pelvis, reach) for each in legs),
    )
    return figure.make_clip("hop", motion, root, pose, advance=distance)


def _phases(height: float, legs: int) -> tuple[float, float]:
    """Seconds on the floor and in flight, for a flight that rises `height` m off so many `legs`.

    Between touchdown and take-off the centre of mass sinks by about ``v t / pi + g t^2 / 29``, for
    the contact time t, the speed v, and a force that rises and falls like a sine.
    """
    speed = math.sqrt(2.0 * figure.GRAVITY * height)
    flight = (speed + math.sqrt(speed**2 + 2.0 * figure.GRAVITY * _DROP)) / figure.GRAVITY
    depth = (0.15 if legs == 2 else 0.12) + 0.3 * height
    a, b = figure.GRAVITY / 29.0, speed / math.pi
    return (math.sqrt(b**2 + 4.0 * a * depth) - b) / (2.0 * a), flight


def _free_leg(side: figure.Side, times: figure.Array, contact: float, period: float) -> figure.Pose:
    """The leg that does not hop, bent, swinging a little up at take-off."""
    keys = leg_keys(
        side,
        [
            (0.5 * contact, 14.0, 2.0, 78.0, 12.0),
            (contact, 30.0, 2.0, 80.0, 12.0),
            (0.5 * (contact + period), 26.0, 2.0, 84.0, 12.0),
        ],
    )
    return limbs.leg(side, around(times, keys, period))


def _pelvis(times: figure.Array, contact: float, period: float, roll: float) -> Rotation:
    """Leaning forward over bent knees, upright in flight; `roll` degrees higher on the right."""
    pitch = around(
        times,
        [(0.0, 9.0), (0.5 * contact, 17.0), (contact, 6.0), (0.5 * (contact + period), 4.0)],
        period,
    )[:, 0]
    return figure.turns(0.0, pitch, -roll)


def _upper_body(
    times: figure.Array, contact: float, period: float, pelvis: Rotation, height: float
) -> figure.Pose:
    """A steady trunk, a level head, and arms that are thrown forward at take-off."""
    pitch = np.degrees(pelvis.as_euler("ZYX")[:, 1])
    pose = figure.trunk(
        pelvis, figure.turns(0.0, 0.9 * pitch + 3.0, 0.0), figure.turns(0.0, 0.35 * pitch, 0.0)
    )
    swing = 0.7 + 1.2 * height
    rows = [
        (0.0, 12.0 * swing, 12.0, 45.0),
        (0.55 * contact, -38.0 * swing, 12.0, 28.0),
        (contact, 28.0 * swing, 12.0, 50.0),
        (0.5 * (contact + period), 42.0 * swing, 14.0, 58.0),
    ]
    for side in figure.SIDES:
        pose |= arm(side, around(times, arm_keys(side, rows), period))
    return pose
