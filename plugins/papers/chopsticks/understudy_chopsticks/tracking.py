"""Where the sticks are, how far from the plan, and what that is worth (thesis, section 5.4.2).

N worlds, F fingers that touch a stick; everything in the palm's frame, m, rad. The upper stick comes first.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from understudy.options import check_range
from understudy.task import Context, Fields, Shape
from understudy.task.terms import ranges
from understudy_chopsticks.plan import gripping
from understudy_gripping.holding import holding
from understudy_hand.tools import GRIPPERS
from understudy_tensors import rotations
from understudy_tensors.limits import ANGLE, limits
from understudy_tensors.segments import at, place_on_segment


class Tracking(Fields):
    """The sticks, or the P parts of another tool, in the palm's frame, and errors.

    - ``stick_state`` (P, 13): position, rotation, linear and angular velocity
    - ``stick_distance`` (P,) m, of the middles from the planned ones; ``stick_turn`` (P,) rad, between the
      sticks' axes and the planned ones; ``stick_rotation`` (P,) rad, the same with the spin about the axis
    - ``angle`` () rad, between the sticks as the plan means it: about the lower one's z axis
    - ``angle_error`` () rad, of that, without sign
    - ``tip_distance`` (F,) m, of fingertips from their places on the sticks; where several grips share the job, of
      all fingers that touch in any, 0 of one that does not in its own
    """

    reads = (
        "xpos", "xquat", "cvel", "subtree_com", "geom_xpos", "geom_xmat", "planned_upper",
        "planned_lower", "planned_angle",
    )  # fmt: skip
    provides: Mapping[str, Shape] = {
        "stick_state": (2, 13),
        "stick_distance": (2,),
        "stick_turn": (2,),
        "stick_rotation": (2,),
        "angle": (),
        "angle_error": (),
        "tip_distance": (0,),
    }

    def __init__(self, options: None, context: Context) -> None:
        made = gripping(context, "fields 'chopsticks/tracking'")
        model, device = made.scene.model, context.device
        own = holding(made.scene.options.tool)
        bodies = [model.body(name).id for name in ("palm", *made.scene.tool_bodies)]
        self._bodies = torch.tensor(bodies, device=device)
        self._roots = torch.tensor(model.body_rootid[bodies], dtype=torch.long, device=device)
        tips = [model.geom(f"{finger}_distal").id for finger in made.touching]
        self._tips = torch.tensor(tips, device=device)
        self._half = torch.tensor(model.geom_size[tips, 1], dtype=torch.float32, device=device)
        self._radii = torch.tensor(model.geom_size[tips, 0], dtype=torch.float32, device=device)
        #: By world: the stick that a finger touches, its place on it, and 0 for one that touches none.
        sticks, goals, touches = [], [], []
        for grip in made.grips:
            places = dict(zip(grip.touching, grip.places, strict=True))
            rows = [made.scene.measures.names.index(name) for name in made.touching]
            side = [own.sides(grip.style)[row] for row in rows]
            along = [(places.get(name, 0.0), 0.0, 0.0) for name in made.touching]
            sticks.append([max(grip.style[row] - 1, 0) for row in rows])
            goals.append((np.array(along) + own.thickness * np.array(side)).tolist())
            touches.append([float(name in places) for name in made.touching])
        self._sticks = made.of_worlds(sticks).long()
        self._goals = made.of_worlds(goals)
        self._touches = made.of_worlds(touches)
        self._x = torch.tensor([1.0, 0.0, 0.0], device=device)
        #: Where the lower part is in the grip, and along what it may be held further (section 5.7.2).
        self._lower = made.lower
        self._along = rotations.rotate(made.lower[:, 3:], self._x.expand(len(made.lower), 3))
        self._parts = parts = made.parts
        gripper = GRIPPERS.get(made.scene.options.tool)
        self._zero = 0.0 if gripper is None else gripper.zero
        of_parts = {f"stick_{name}": (parts,) for name in ("distance", "turn", "rotation")}
        self.provides = {
            **self.provides, "stick_state": (parts, 13), **of_parts, "tip_distance": (len(tips),),
        }  # fmt: skip

    def compute(
        self,
        xpos: Tensor,
        xquat: Tensor,
        cvel: Tensor,
        subtree_com: Tensor,
        geom_xpos: Tensor,
        geom_xmat: Tensor,
        planned_upper: Tensor,
        planned_lower: Tensor,
        planned_angle: Tensor,
    ) -> dict[str, Tensor]:
        places, turns = xpos.index_select(1, self._bodies), xquat.index_select(1, self._bodies)
        moving = cvel.index_select(1, self._bodies).view(len(xpos), 1 + self._parts, 6)
        spin = moving[..., :3]  # world axes; MuJoCo gives velocities at the tree's centre of mass
        arms = places - subtree_com.index_select(1, self._roots)
        speed = moving[..., 3:] + torch.linalg.cross(spin, arms, dim=-1)
        palm, away = turns[:, :1], places[:, 1:] - places[:, :1]
        carried = speed[:, :1] + torch.linalg.cross(spin[:, :1].expand_as(away), away, dim=-1)
        position = rotations.inverse_rotate(palm, away)
        rotation = rotations.multiply(rotations.conjugate(palm), turns[:, 1:])
        state = [
            position,
            rotations.canonical(rotation),
            rotations.inverse_rotate(palm, speed[:, 1:] - carried),
            rotations.inverse_rotate(palm, spin[:, 1:] - spin[:, :1]),
        ]
        planned = torch.stack([planned_upper, planned_lower][-self._parts :], dim=1)
        axes = rotations.rotate(rotation, self._x)
        wanted = rotations.rotate(planned[..., 3:], self._x)
        upper = rotations.inverse_rotate(rotation[:, -1], axes[:, 0])
        angle = torch.atan2(upper[:, 1], upper[:, 0])
        if self._zero:
            angle = angle - self._zero
        touched = self._sticks.expand(len(xpos), -1)[..., None]
        # What is held further along has the fingers at other places on it.
        further = ((planned_lower[:, :3] - self._lower[:, :3]) * self._along).sum(1)
        places_on = self._goals - further[:, None, None] * self._x
        goals = places[:, 1:].gather(1, touched.expand(-1, -1, 3)) + rotations.rotate(
            turns[:, 1:].gather(1, touched.expand(-1, -1, 4)), places_on
        )
        return {
            "stick_state": torch.cat(state, dim=-1),
            "stick_distance": torch.linalg.vector_norm(position - planned[..., :3], dim=-1),
            "stick_turn": _between(axes, wanted),
            "stick_rotation": rotations.angle_between(rotation, planned[..., 3:]),
            "angle": angle,
            "angle_error": (angle - planned_angle).abs(),
            "tip_distance": self._from_tips(goals, geom_xpos, geom_xmat),
        }

    def _from_tips(self, goals: Tensor, geom_xpos: Tensor, geom_xmat: Tensor) -> Tensor:
        middle = geom_xpos.index_select(1, self._tips)
        matrix = geom_xmat.index_select(1, self._tips).view(*middle.shape, 3)
        reach = self._half[:, None] * matrix[..., 2]
        ends = torch.stack([middle - reach, middle + reach], dim=-2)
        nearest = at(ends, place_on_segment(goals, ends))
        away = torch.linalg.vector_norm(nearest - goals, dim=-1) - self._radii
        return away.clamp(min=0.0) * self._touches


def _between(one: Tensor, other: Tensor) -> Tensor:
    """(…) rad between unit vectors (…, 3), exact for small angles too."""
    cross = torch.linalg.vector_norm(torch.linalg.cross(one, other, dim=-1), dim=-1)
    return torch.atan2(cross, (one * other).sum(-1))


# ------------------------------------------------------------------ eqs. 5.2, 5.3, 5.5, each as exp


@ranges(0.0, 1.0)
class Hand:
    """exp of eq. 5.2: arm and hand as planned, exp(-w ‖q - q̃‖)."""

    @dataclass(frozen=True)
    class Options:
        scale: float = 10.0  #: w, 1/rad, from 0: factor of the pose's error (eq. 5.2)

        def __post_init__(self) -> None:
            check_range(self, "scale", least=0)

    def __init__(self, options: Options, context: Context) -> None:
        self._scale, self._count = options.scale, gripping(context, "reward").scene.hinges

    def __call__(self, qpos: Tensor, planned_pose: Tensor) -> Tensor:
        error = torch.linalg.vector_norm(qpos[:, : self._count] - planned_pose, dim=1)
        return torch.exp(-self._scale * error)


@limits(distance=(0, 1e6), turn=(0, 1e6))
@ranges(0.0, 1.0)
def sticks(
    stick_distance: Tensor,
    stick_turn: Tensor,
    stick_rotation: Tensor,
    *,
    distance: float = 40.0,  #: 1/m, factor of the middles' distances (eq. 5.3)
    turn: float = 10.0,  #: 1/rad, factor of the angles Θ (eq. 5.3)
    #: Whether Θ counts a stick's turn about its own axis, as the thesis' angle between quaternions does.
    spin: bool = False,
) -> Tensor:
    """exp of eq. 5.3: both sticks as planned, exp(-40 Σ ‖p - p̃‖ - 10 Σ Θ)."""
    angle = stick_rotation if spin else stick_turn
    return torch.exp(-distance * stick_distance.sum(1) - turn * angle.sum(1))


@limits(scale=(0, 1e6))
@ranges(0.0, 1.0)
def contact(
    tip_distance: Tensor,
    *,
    scale: float = 10.0,  #: 1/m, factor of the tips' distances from their places (eq. 5.5)
) -> Tensor:
    """exp of eq. 5.5: fingertips at their places on the sticks, exp(-10 Σ d)."""
    return torch.exp(-scale * tip_distance.sum(1))


@limits(distance=(0, 1e3))
def dropped(
    stick_distance: Tensor,
    *,
    #: m, greatest distance of a stick from its plan; the thesis names no early ending, this one is
    #: chosen
    distance: float = 0.03,
) -> Tensor:
    """A stick is far from where it is planned; it has fallen, or will."""
    return (stick_distance > distance).any(dim=1)


@limits(turn=ANGLE)
def turned(
    stick_turn: Tensor,
    *,
    #: rad, greatest turn of a stick from its plan; the thesis names no early ending, this one is
    #: chosen
    turn: float = 0.1,
) -> Tensor:
    """A stick is turned far from its plan."""
    return (stick_turn > turn).any(dim=1)


@limits(distance=(0, 1e3))
def contact_lost(
    tip_distance: Tensor,
    *,
    #: m, greatest sum of the tips' distances; the release's, where exp(-20 Σ d) is 0.5
    distance: float = 0.035,
) -> Tensor:
    """Fingertips have left their places on the sticks."""
    return tip_distance.sum(1) > distance
