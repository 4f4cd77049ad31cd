"""The character as the generated clips see it: proportions, centre of mass, clips.

A pose is each joint's rotation relative to its parent by the joint's name, the root's in the world;
with the path of the root it is a motion. All arrays are float64 and run over F frames.
"""

from __future__ import annotations

import copy
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, ParamSpec, TypeAlias

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from understudy.errors import ConfigError
from understudy_characters.table import Link
from understudy_humanoid.character import BODIES
from understudy_motion.clip import Clip, Skeleton, sample

Array: TypeAlias = NDArray[np.float64]
Mask: TypeAlias = NDArray[np.bool_]
Pose: TypeAlias = dict[str, Rotation]
Side: TypeAlias = Literal["left", "right"]

SIDES: tuple[Side, Side] = ("right", "left")
#: 1 for what lies on the left, at positive y.
SIGN: Mapping[Side, float] = {"left": 1.0, "right": -1.0}
GRAVITY = 9.81

ROWS = {row.name: row for row in BODIES}
_JOINTS = [row for row in BODIES if row.joints or row.parent is None]
_NAMES = tuple(row.name for row in _JOINTS)
_PARENTS = tuple(-1 if row.parent is None else _NAMES.index(row.parent) for row in _JOINTS)
_Parameters = ParamSpec("_Parameters")
#: Clips of a family that are kept: a training and its evaluations ask for the same few.
_KEPT = 16
#: Times per second of a grid, at least.
_FINENESS = 480.0
#: Numbers of rotations from which numpy multiplies them sooner than scipy.
_MANY = 128


def check(clip: str, least: float, most: float, **parameters: float) -> None:
    """Raise a ConfigError that names the first of a clip's parameters outside [least, most]."""
    for name, value in parameters.items():
        if not least <= value <= most:
            raise ConfigError(
                f"{clip}: {name}={value:g} is not possible: "
                f"it must be at least {least:g} and at most {most:g}."
            )


def remembered(make: Callable[_Parameters, Clip]) -> Callable[_Parameters, Clip]:
    """The clip of the same parameters is made once; each caller has a copy of its own."""
    kept = functools.lru_cache(_KEPT, typed=True)(make)

    @functools.wraps(make)
    def again(*none: _Parameters.args, **parameters: _Parameters.kwargs) -> Clip:
        every: Any = {**(make.__kwdefaults__ or {}), **parameters}
        return copy.deepcopy(kept(*none, **every))

    return again


@dataclass(frozen=True)
class Grid:
    """The times at which a motion is put together: finer than its frames, which are among them."""

    seconds: float
    times: Array  #: (F,) s, evenly spaced from 0; a cycle's end is left out
    frames: NDArray[np.int64]  #: (n,) which of the times are frames
    cyclic: bool  #: whether the motion repeats, its end being its beginning moved along x


def grid(
    clip: str, seconds: float, frame_rate: float, *, cyclic: bool = False, multiple: int = 1
) -> Grid:
    """The grid of a clip of so many seconds, with a whole `multiple` of steps between its frames.

    Raises
    ------
    ConfigError
        the frame rate is not between 10 and 1000 frames/s.
    """
    check(clip, 10.0, 1000.0, frame_rate=frame_rate)
    steps = multiple * max(8, round(seconds * frame_rate / multiple))
    fine = math.ceil(_FINENESS * seconds / steps)
    times = np.linspace(0.0, seconds, steps * fine + 1)
    chosen = np.arange(0, steps * fine + 1, fine)
    return (
        Grid(seconds, times[:-1], chosen[:-1], True)
        if cyclic
        else Grid(seconds, times, chosen, False)
    )


def turns(yaw: ArrayLike, pitch: ArrayLike, roll: ArrayLike) -> Rotation:
    """Turns about z, then the turned y, then the turned x; degrees, (F,) or one for all."""
    angles = np.broadcast_arrays(*np.atleast_1d(yaw, pitch, roll))
    return Rotation.from_euler("ZYX", np.stack(angles, axis=1), degrees=True)


def about_y(angle: Array) -> Rotation:
    """Turns about y by (F,) rad."""
    return Rotation.from_rotvec(angle[:, None] * [0.0, 1.0, 0.0])


def product(one: Rotation, other: Rotation) -> Rotation:
    """``one * other`` to the same bits, (F,) or one for all: scipy takes five times as long for many."""
    if max(np.size(one.as_quat()), np.size(other.as_quat())) < _MANY:
        return one * other
    (a, b, c, d), (x, y, z, w) = one.as_quat().T, other.as_quat().T
    turned = np.stack(
        [
            d * x + w * a + (b * z - c * y),
            d * y + w * b + (c * x - a * z),
            d * z + w * c + (a * y - b * x),
            d * w - a * x - b * y - c * z,
        ],
        axis=-1,
    )
    return Rotation.from_quat(turned)


def trunk(pelvis: Rotation, thorax: Rotation, head: Rotation) -> Pose:
    """The pose of the trunk from its parts' rotations in one frame, the world if it is that."""
    return {
        "root": pelvis,
        "chest": product(pelvis.inv(), thorax),
        "neck": product(thorax.inv(), head),
    }


@dataclass(frozen=True)
class _Held:
    """A link as its joint's rotation and its parent's in the world turn it."""

    own: Rotation | None  #: relative to the parent; None where there is no joint
    above: Rotation | None  #: the parent's; None of the root
    turned: Rotation  #: world
    step: Array | float  #: (F, 3) m from the parent's origin
    centre: Array  #: (F, 3) m from its origin


#: By link, what was worked out last, of which all holds that is turned by the same rotations again.
Known: TypeAlias = dict[str, _Held]


def links(root: Array, pose: Pose, known: Known | None = None) -> tuple[Array, list[Rotation]]:
    """World places of all links' mass centres (L, F, 3) m and their rotations, in table order."""
    known = {} if known is None else known
    origins: dict[str, Array] = {}
    for row in BODIES:
        own, above = pose.get(row.name), known[row.parent].turned if row.parent else None
        held = known.get(row.name)
        if held is None or held.own is not own or held.above is not above:
            turned = own if above is None else above if own is None else product(above, own)
            assert turned is not None
            step = 0.0 if above is None else above.apply(row.offset)
            held = known[row.name] = _Held(own, above, turned, step, turned.apply(row.centre))
        origins[row.name] = origins[row.parent] + held.step if row.parent else root
    centres = [origins[row.name] + known[row.name].centre for row in BODIES]
    return np.stack(centres), [known[row.name].turned for row in BODIES]


MASSES = np.array([row.mass for row in BODIES])


def centre_of_mass(root: Array, pose: Pose, known: Known | None = None) -> Array:
    """(F, 3) m, world."""
    return np.einsum("l,lfk->fk", MASSES / MASSES.sum(), links(root, pose, known)[0])


def pitching(times: Array, root: Array, pose: Pose) -> tuple[Array, Array]:
    """Angular momentum (F,) kg m^2/s and inertia (F,) kg m^2 about the y axis through the centre of
    mass, of a motion in which all joints turn about y."""
    places, turned = links(root, pose)
    arms = places - np.einsum("l,lfk->fk", MASSES / MASSES.sum(), places)
    speeds = np.gradient(arms, times, axis=1)
    pitch = np.stack([np.unwrap(_pitch_of(each)) for each in turned])
    own = np.array([_inertia(row) for row in BODIES])[:, None]
    mass = MASSES[:, None]
    moment = mass * (arms[..., 2] * speeds[..., 0] - arms[..., 0] * speeds[..., 2])
    momentum = (moment + own * np.gradient(pitch, times, axis=1)).sum(axis=0)
    return momentum, (mass * (arms[..., 0] ** 2 + arms[..., 2] ** 2) + own).sum(axis=0)


def _pitch_of(rotation: Rotation) -> Array:
    """The turn about y, (F,) rad, of the rotated x axis in the xz plane."""
    x = rotation.apply([1.0, 0.0, 0.0])
    return np.arctan2(-x[:, 2], x[:, 0])


def _inertia(row: Link) -> float:
    """A link's moment of inertia about the y axis through its centre, kg m^2."""
    if row.shape == "box":
        return row.mass / 3.0 * (row.size[0] ** 2 + row.size[2] ** 2)
    radius, half = row.size if row.shape == "capsule" else (row.size[0], 0.0)
    # A cylinder between two half spheres, of volumes in this proportion.
    cylinder = row.mass * half / (half + 2.0 / 3.0 * radius)
    ends = row.mass - cylinder
    return cylinder * (radius**2 / 4.0 + half**2 / 3.0) + ends * (
        0.4 * radius**2 + 0.75 * half * radius + half**2
    )


def make_clip(
    name: str, grid: Grid, root: Array, pose: Pose, *, loop: bool = False, advance: float = 0.0
) -> Clip:
    """The clip of a motion on a grid; a cyclic one ends `advance` m ahead along x of where it began."""
    times, chosen = grid.times[grid.frames], grid.frames
    root = root[chosen]
    if grid.cyclic:
        times, chosen = np.append(times, grid.seconds), np.append(chosen, 0)
        root = np.vstack([root, root[:1] + np.array([advance, 0.0, 0.0])])
    quaternions = [pose[joint].as_quat(scalar_first=True)[chosen] for joint in _NAMES]
    return Clip(
        name=name,
        times=torch.from_numpy(times),
        root_position=torch.from_numpy(root),
        rotations=torch.from_numpy(np.stack(quaternions, axis=1)),
        joint_names=_NAMES,
        loop=loop or grid.cyclic,
        skeleton=Skeleton(_NAMES, _PARENTS, np.array([row.offset for row in _JOINTS])),
        source="generated",
        licence="Apache-2.0 (generated)",
    )


def only_key_poses(clip: Clip, times: Sequence[float]) -> Clip:
    """Nothing but the poses of `clip` at `times`, s, of which the first and the last are its ends.

    Whoever plays it interpolates between a handful of poses: feet slide and nothing is ballistic, as
    in an animation of few keys.
    """
    at = torch.tensor(times, dtype=torch.float64)
    position, rotation = sample(replace(clip, loop=False), at)
    return replace(clip, times=at, root_position=position, rotations=rotation)
