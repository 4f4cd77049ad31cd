"""A generated run.

The centre of mass comes first: it flies as gravity wants, and on the floor it bounces on one leg at a
time. The standing foot touches down with its fore part, lies flat and rolls over its toe without
sliding; inverse kinematics joins hip and foot. A swinging leg folds and reaches forward through a few
key angles. Pelvis and chest turn against each other, bent arms swing against the legs.

The profiles are drawn by hand after the common description of running (Novacheck, "The biomechanics
of running", 1998); contact and step times follow Cavanagh and Kram (1989) for a leg of 0.88 m.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from understudy_humanoid.clips import figure
from understudy_humanoid.clips.curves import bounce, carried, monotone
from understudy_humanoid.clips.limbs import PlantedLeg, arm, leg_keys, on_legs, planted
from understudy_motion.clip import Clip

STEP_HALF_WIDTH = 0.045  #: m, of the ankles from the line of travel
TOE_OUT = np.radians(5.0)

_REACH = 0.972  #: of the leg at its longest, at toe-off: the knee is never straight
_DROP = 0.018  #: m, by which the centre of mass touches down lower than it takes off
_AHEAD = (
    0.31  #: how far ahead of the centre of mass a foot strikes, as a part of its path in contact
)
_EASY = 3.0  #: m/s, from which the profiles grow with the speed
#: Foot pitch in degrees, toe down positive, at fractions of the contact after the strike.
_PITCH = ((0.24, 0.0), (0.34, 0.0), (0.66, 20.0), (1.0, 58.0))


@figure.remembered
def generated_run(
    *,
    #: m/s, from 2 to 5; faster runs take shorter contacts, and shorter and longer steps
    speed: float = 3.0,
    #: return only the poses of strike, mid-stance, toe-off and mid-flight
    key_poses: bool = False,
    #: frames/s, rounded so that a step is a whole number of frames
    frame_rate: float = 60.0,
) -> Clip:
    """One cycle, two steps, of a run along +x, from a right foot strike.

    Returns a looping clip whose second half mirrors its first.

    Raises
    ------
    ConfigError
        a parameter is outside its range.
    """
    figure.check("run", 2.0, 5.0, speed=speed)
    contact, cycle = contact_and_cycle(speed)
    motion = figure.grid("run", cycle, frame_rate, cyclic=True, multiple=2)
    times = motion.times
    effort = speed - _EASY

    wave = 2.0 * np.pi * times / cycle
    pelvis = figure.turns(7.0 * np.cos(wave - 0.2), 9.0 + effort, -4.0 * np.sin(wave))
    upper = _upper_body(wave, pelvis, effort)
    legs = [
        _leg("right", times, speed, contact, cycle, 0.0),
        _leg("left", times, speed, contact, cycle, 0.5 * cycle),
    ]

    height = bounce(times, contact, 0.5 * cycle, _DROP) + 0.8
    root, pose = carried(
        np.stack([speed * times, np.zeros_like(times), height], axis=1),
        on_legs(upper, legs, times),
        room=lambda root: min(each.room(root, pelvis, _REACH) for each in legs),
    )
    clip = figure.make_clip("run", motion, root, pose, advance=speed * cycle)
    if not key_poses:
        return clip
    step = 0.5 * cycle
    keys = [0.0, 0.5 * contact, contact, 0.5 * (contact + step)]
    return figure.only_key_poses(clip, [*keys, *(step + key for key in keys), clip.duration])


def contact_and_cycle(speed: float) -> tuple[float, float]:
    """Seconds for which a foot is on the floor, and seconds per two steps."""
    return (0.51 + 0.06 * speed) / speed, 0.83 - 0.04 * speed


def _leg(
    side: figure.Side,
    times: figure.Array,
    speed: float,
    contact: float,
    cycle: float,
    strike: float,
) -> PlantedLeg:
    """The leg whose foot strikes at `strike` s."""
    since = (times - strike) % cycle
    x = speed * (times - since) + _AHEAD * speed * contact
    place = np.stack([x, np.full_like(x, figure.SIGN[side] * STEP_HALF_WIDTH)], axis=1)
    effort = speed - _EASY
    pitch = monotone(since / contact, [(0.0, 11.0 - 3.0 * effort), *_PITCH])
    ankle, foot = planted(place, figure.SIGN[side] * TOE_OUT, np.radians(pitch))
    swing = [
        (0.22, -2.0, 0.0, 70.0 + 2.0 * effort, 12.0),
        (0.45, 28.0, 0.0, 100.0 + 9.0 * effort, 4.0),
        (0.75, 52.0 + 5.0 * effort, 0.0, 62.0 + 4.0 * effort, -4.0),
    ]
    keys = leg_keys(side, swing)
    keys[:, 0] = (strike + contact + keys[:, 0] * (cycle - contact)) % cycle
    return PlantedLeg(side, since < contact, ankle, foot, keys[np.argsort(keys[:, 0])], cycle)


def _upper_body(wave: figure.Array, pelvis: Rotation, effort: float) -> figure.Pose:
    """Chest against the pelvis, a head that looks ahead, bent arms against the legs."""
    thorax = figure.turns(-10.0 * np.cos(wave - 0.4), 8.0 + 1.5 * effort, np.sin(wave))
    pose = figure.trunk(pelvis, thorax, figure.turns(0.0 * wave, 4.0, 0.0))
    for side in figure.SIDES:
        sign = figure.SIGN[side]
        forward = sign * np.cos(wave - 0.25)
        yaw = -sign * (12.0 + 12.0 * forward)
        upper = figure.turns(yaw, 6.0 - (35.0 + 4.0 * effort) * forward, sign * 12.0)
        elbow = np.radians(92.0 - 14.0 * forward)
        pose |= arm(side, np.column_stack([upper.as_rotvec(), elbow]))
    return pose
