"""The arena: what is to be jumped over, and the mat behind it (thesis, section 4.6.1).

The obstacle stands across the x axis and is infinitely long: it is where 0 <= x <= width and
z <= height. Height and width grow linearly with the difficulty; the mat begins behind it. A bar is
a thin wall, so that nothing passes beneath it. The obstacle is nothing to bump into: whether a body
touches it is computed (:mod:`understudy_jumping.attempt`), and ends the attempt. The mat is solid.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

import mujoco
import numpy as np
from torch import Tensor

from understudy.options import check_range
from understudy.task import Context
from understudy_characters.staging import make_solid
from understudy_characters.surroundings import Surroundings

Number = TypeVar("Number", float, Tensor)

#: The mat's body; ``mocap_pos/mat`` is where the middle of its surface is.
MAT = "mat"
_EARTH = 9.81
"""m/s²"""
_HIGHEST, _WIDEST = 4.0, 12.0
"""m over which anybody jumps where gravity is the earth's, with room to spare: the records are 2.45 and 8.95."""
_LOW_MAT = 0.1
"""m that a mat may have whatever the obstacle."""
_OBSTACLE, _GAP, _THICK = "obstacle", 0.02, 0.8


@dataclass(frozen=True)
class ArenaOptions:
    """The obstacle and the mat behind it."""

    #: m, height of the obstacle at difficulty 0 and 1 (table 4.1)
    height: tuple[float, float] = (0.5, 2.0)
    #: m, width of the obstacle along the jump, at difficulty 0 and 1
    width: tuple[float, float] = (0.02, 0.02)
    #: Difficulties at which ρ, by which control rate and offsets are scheduled, is 0 and 1.
    schedule: tuple[float, float] = (0.0, 1 / 3)
    length: float = 8.0  #: m, size of obstacle and mat across the jump
    mat: float = 5.0  #: m, how far the mat reaches
    #: m: how much lower than the obstacle the mat is, within ``mat_height``.
    drop: float = 0.7
    mat_height: tuple[float, float] = (0.1, 0.75)  #: m, least and greatest height of the mat
    softness: float = 0.04  #: s, in which the mat stops what falls on it
    gravity: float = 9.81  #: m/s², downwards, above 0

    def __post_init__(self) -> None:
        check_range(self, "height", "width", "length", "mat", "drop", "mat_height", most=1e3)
        check_range(self, "gravity", most=1e4)
        check_range(self, "length", "mat", least=0.5)
        check_range(self, "drop", "softness", "gravity", above=0)
        for name in ("height", "width", "schedule", "mat_height"):
            low, high = getattr(self, name)
            if low < 0 and name != "schedule":  # difficulties: ρ may be above 0 from the start
                raise ValueError(f"{name}={low, high} is not possible: give 0 or more.")
            if low > high:
                raise ValueError(f"{name}={low, high} is not possible: the first is the lower one.")
        for name, most in (("height", _HIGHEST), ("width", _WIDEST)):
            most *= _EARTH / self.gravity
            if (high := getattr(self, name)[1]) > most:
                raise ValueError(
                    f"{name}={getattr(self, name)} is not possible: nobody gets over {high:g} m at gravity={self.gravity:g}; "
                    f"give at most {most:.3g}."
                )
        if self.mat_height[0] > max(self.height[0], _LOW_MAT):
            raise ValueError(
                f"mat_height={self.mat_height} is not possible: the mat would be higher than the obstacle, which begins at height="
                f"{self.height[0]:g}."
            )
        if self.schedule[0] == self.schedule[1]:
            raise ValueError(f"schedule={self.schedule} is not possible: they must differ.")


class Arena(Surroundings):
    """The obstacle and the mat."""

    recorded = ("obstacle_height", "obstacle_width", "mat_height")

    def __init__(self, options: ArenaOptions, *_: object) -> None:
        self.options = options

    def height(self, difficulty: Number) -> Number:
        """m"""
        low, high = self.options.height
        return low + (high - low) * difficulty

    def width(self, difficulty: Number) -> Number:
        """m"""
        low, high = self.options.width
        return low + (high - low) * difficulty

    def rho(self, difficulty: Tensor) -> Tensor:
        """ρ in [0, 1]: 2 z - 1 in high jumps, z in obstacle jumps, of the height or width z in m."""
        low, high = self.options.schedule
        return ((difficulty - low) / (high - low)).clamp(0.0, 1.0)

    def mat_height(self, height: Tensor) -> Tensor:
        """m"""
        return (height - self.options.drop).clamp(*self.options.mat_height)

    def mat_x(self, width: Number) -> Number:
        """m: where the mat's middle is; it begins shortly behind the obstacle."""
        return width + _GAP + 0.5 * self.options.mat

    def on_mat(self, x: Tensor, y: Tensor, width: Tensor) -> Tensor:
        """(N, …) bool: whether points above the ground are above the mat; `width` is broadcast."""
        begin = width + _GAP
        return (x > begin) & (x < begin + self.options.mat) & (y.abs() < 0.5 * self.options.length)

    def add(self, spec: mujoco.MjSpec) -> None:
        options = self.options
        spec.option.gravity = [0.0, 0.0, -options.gravity]
        mat = spec.worldbody.add_body(
            name=MAT, mocap=True, pos=[self.mat_x(options.width[0]), 0, 0]
        )
        surface = mat.add_geom(
            name=MAT,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[0.5 * options.mat, 0.5 * options.length, 0.5 * _THICK],
            pos=[0.0, 0.0, -0.5 * _THICK],
            rgba=[0.28, 0.42, 0.66, 1.0],
            solref=[options.softness, 1.0],
        )
        make_solid(surface)
        obstacle = spec.worldbody.add_body(name=_OBSTACLE)
        obstacle.add_geom(
            name=_OBSTACLE,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[0.5, 0.5 * options.length, 0.5],
            contype=0,
            conaffinity=0,
            rgba=[0.85, 0.3, 0.25, 0.55],
        )

    def place(
        self, model: mujoco.MjModel, data: mujoco.MjData, recorded: Mapping[str, np.ndarray]
    ) -> None:
        height, width, mat = (float(recorded[name]) for name in self.recorded)
        size = 0.5 * width, 0.5 * self.options.length, 0.5 * height
        model.geom_size[model.geom(_OBSTACLE).id] = size
        model.body_pos[model.body(_OBSTACLE).id] = 0.5 * width, 0.0, 0.5 * height
        data.mocap_pos[model.body(MAT).mocapid] = self.mat_x(width), 0.0, mat


def arena_of(context: Context, who: str) -> Arena:
    """The task's arena; an error names `who` needs it."""
    return context.need_section("arena", Arena, who)
