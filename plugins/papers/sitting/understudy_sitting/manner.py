"""How the figure sits down, beside whether it sits: whether it drops, where it lands, and whether its feet stay.

Success counts every figure that sits; one that jumps onto the edge and pulls its feet up sits, too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.options import check_range
from understudy.task import Context, Fields, Memory, Shape
from understudy_characters.scene import CharacterScene
from understudy_sitting.actuation import units
from understudy_sitting.chair import FEET, Chair, Soles
from understudy_sitting.state import chair_of
from understudy_tensors import rotations
from understudy_tensors.limits import limits

_GRAVITY = 9.81  #: m/s²


class Feet(Fields):
    """Feet on the floor, of tasks without a chair.

    ``feet_speed`` (N, 2) m/s of left and right ankle along the floor, ``feet_down`` (N, 2) 1 where that foot touches it.
    """

    reads = ("xpos", "cvel", "subtree_com", *(f"sensor_{foot}" for foot in FEET))
    provides: Mapping[str, Shape] = {"feet_speed": (2,), "feet_down": (2,)}

    def __init__(self, options: None, context: Context) -> None:
        who = "fields 'sitting/feet'"
        scene = context.need_scene(CharacterScene, who)
        self._root = scene.layout.root_body
        soles = context.need_section("soles", Soles, who).options
        links = [scene.model.body(name).id for name in soles.feet]
        self._links = torch.tensor(links, device=context.device)

    def compute(
        self, xpos: Tensor, cvel: Tensor, subtree_com: Tensor, **touching: Tensor
    ) -> dict[str, Tensor]:
        weight = subtree_com[:, self._root]
        speed = _velocities(xpos[:, self._links], cvel[:, self._links], weight)[..., :2].norm(
            dim=-1
        )
        return {"feet_speed": speed, "feet_down": _down(touching)}


def _velocities(places: Tensor, moves: Tensor, weight: Tensor) -> Tensor:
    """(N, K, 3) m/s at `places` (N, K, 3), of `moves` (N, K, 6), angular and linear at the figure's `weight` (N, 3)."""
    angular, linear = moves.split(3, dim=-1)
    return linear + torch.linalg.cross(angular, places - weight[:, None])


def _down(touching: Mapping[str, Tensor]) -> Tensor:
    """(N, 2): 1 where left and right foot touch the floor."""
    return (torch.cat([touching[f"sensor_{foot}"] for foot in FEET], dim=1) > 0).float()


class Manner(Fields):
    """Pelvis and feet in the world, by floor and seat.

    ``weight_height`` (N,) m of the figure's centre of mass. ``pelvis_height`` (N,) m, ``pelvis_fall`` (N,) m/s, downwards; ``seat_depth`` (N,) m of the pelvis behind the
    seat's front edge, negative before it. ``feet_speed`` (N, 2) m/s of left and right ankle along the floor,
    ``feet_down`` (N, 2) 1 where that foot touches it, ``feet_standing`` (N,) their mean.
    """

    reads = ("xpos", "cvel", "subtree_com", "seat_position", "chair_rotation",
             *(f"sensor_{foot}" for foot in FEET))  # fmt: skip
    provides: Mapping[str, Shape] = {
        "pelvis_height": (),
        "pelvis_fall": (),
        "seat_depth": (),
        "feet_speed": (2,),
        "feet_down": (2,),
        "feet_standing": (),
        "weight_height": (),
    }

    def __init__(self, options: None, context: Context) -> None:
        who = "fields 'sitting/manner'"
        scene = context.need_scene(CharacterScene, who)
        model, self._root = scene.model, scene.layout.root_body
        chair = context.need_section("chair", Chair, who).options
        soles = context.need_section("soles", Soles, who).options
        links = [model.body(name).id for name in (chair.pelvis, *soles.feet)]
        self._links = torch.tensor(links, device=context.device)
        self._half_depth = float(model.geom_size[chair_of(model)[1], 0])

    def compute(
        self,
        xpos: Tensor,
        cvel: Tensor,
        subtree_com: Tensor,
        seat_position: Tensor,
        chair_rotation: Tensor,
        **touching: Tensor,
    ) -> dict[str, Tensor]:
        places = xpos[:, self._links]  # (N, 3, 3)
        velocities = _velocities(places, cvel[:, self._links], subtree_com[:, self._root])
        ahead = rotations.to_matrix(chair_rotation)[:, :2, 0]
        depth = self._half_depth - ((places[:, 0] - seat_position)[:, :2] * ahead).sum(1)
        down = _down(touching)
        speed = velocities[:, 1:, :2].norm(dim=-1)
        return {
            "pelvis_height": places[:, 0, 2],
            "pelvis_fall": -velocities[:, 0, 2],
            "seat_depth": depth,
            "feet_speed": speed,
            "feet_down": down,
            "feet_standing": down.mean(1),
            "weight_height": subtree_com[:, self._root, 2],
        }


class Descent(Memory):
    """What sitting down was like so far, of every control period.

    ``fastest_fall`` (N,) m/s: the pelvis' fastest downwards, anywhere. ``landing_fall`` (N,) m/s and
    ``landing_depth`` (N,) m: as it first touched the seat, the speed that of one control period before, since contact
    has stopped it after; ``landed`` (N,) 1 from then on, before all three are 0. ``slid`` (N,) m: the way of feet
    along the floor while they touch it, their mean. ``squatted`` (N,) s with the pelvis lower than ``low`` and not on the seat. ``dropped`` (N,) s in which floor and chair bear
    less than half of the weight: its centre of mass accelerates downwards by more than g/2.
    """

    reads = (
        "weight_height",
        "pelvis_height",
        "pelvis_fall",
        "seat_depth",
        "seat_contact",
        "feet_speed",
        "feet_down",
    )
    keeps: Mapping[str, Shape] = {
        "fastest_fall": (),
        "last_fall": (),
        "landing_fall": (),
        "landing_depth": (),
        "landed": (),
        "slid": (),
        "squatted": (),
        "last_height": (),
        "last_rise": (),
        "dropped": (),
    }

    @dataclass(frozen=True)
    class Options:
        #: m above the floor: a pelvis that is lower, and off the seat, squats; it stands at 0.88 m
        low: float = 0.72

        def __post_init__(self) -> None:
            check_range(self, "low", above=0, most=1e3)

    def __init__(self, options: Options, context: Context) -> None:
        self._low, self._dt = options.low, context.control_dt

    def begin(self, pelvis_fall: Tensor, weight_height: Tensor, **now: Tensor) -> dict[str, Tensor]:
        begun = dict.fromkeys(self.keeps, torch.zeros_like(pelvis_fall))
        # No speed of the whole is known: where it falls from the first period on, that one does not count.
        return {**begun, "last_fall": pelvis_fall, "last_height": weight_height,
                "last_rise": torch.full_like(pelvis_fall, -1e6)}  # fmt: skip

    def advance(
        self,
        kept: Mapping[str, Tensor],
        weight_height: Tensor,
        pelvis_height: Tensor,
        pelvis_fall: Tensor,
        seat_depth: Tensor,
        seat_contact: Tensor,
        feet_speed: Tensor,
        feet_down: Tensor,
    ) -> dict[str, Tensor]:
        touches = seat_contact != 0
        first = touches & (kept["landed"] == 0)
        squats = ((pelvis_height < self._low) & ~touches).float()
        rise = (weight_height - kept["last_height"]) / self._dt
        drops = (rise - kept["last_rise"] < -0.5 * _GRAVITY * self._dt).float()
        return {
            "fastest_fall": kept["fastest_fall"].maximum(pelvis_fall),
            "last_fall": pelvis_fall,
            "landing_fall": torch.where(first, kept["last_fall"], kept["landing_fall"]),
            "landing_depth": torch.where(first, seat_depth, kept["landing_depth"]),
            "landed": kept["landed"].maximum(touches.float()),
            "slid": kept["slid"] + self._dt * (feet_speed * feet_down).mean(1),
            "squatted": kept["squatted"] + self._dt * squats,
            "last_height": weight_height,
            "last_rise": rise,
            "dropped": kept["dropped"] + self._dt * drops,
        }


@limits(scale=(0, 1e6))
def planted(
    feet_speed: Tensor,
    feet_down: Tensor,
    *,
    scale: float = 30.0,  #: s²/m², factor of the foot's squared speed
) -> Tensor:
    """Mean over the feet of exp(-scale v²), v its speed along the floor in m/s; 0 of a foot that does not touch it."""
    return (feet_down * torch.exp(-scale * feet_speed.square())).mean(1)


@limits(most=(0, 1e3), scale=(0, 1e6))
def unhurried(
    pelvis_fall: Tensor,
    *,
    most: float = 0.6,  #: m/s, greatest speed downwards that costs nothing
    scale: float = 10.0,  #: s²/m², factor of the square of the speed above that
) -> Tensor:
    """exp(-scale max(0, v - most)²), v the pelvis' speed downwards."""
    return torch.exp(-scale * (pelvis_fall - most).clamp(min=0.0).square())


class Servos:
    """exp(-alpha m), m the mean square over the servos by which the action differs from the clip's own targets, in the
    units of ``sitting/around_clip``. It is of use where these targets alone already move the figure as the clip does."""

    @dataclass(frozen=True)
    class Options:
        alpha: float = 2.0  #: factor of the mean squared difference, in units of the action
        least: float = 0.15  #: rad, least unit of the action, as in ``sitting/around_clip``

        def __post_init__(self) -> None:
            check_range(self, "least", most=100)
            check_range(self, "alpha", "least", above=0)

    def __init__(self, options: Options, context: Context) -> None:
        self._alpha = options.alpha
        self._middle, self._unit = units(context, options.least)

    def __call__(self, action: Tensor, previous_reference_joint_targets: Tensor) -> Tensor:
        wanted = (previous_reference_joint_targets - self._middle) / self._unit
        return torch.exp(-self._alpha * (action - wanted).square().mean(dim=1))


def spent(value: Tensor, before: Tensor) -> Tensor:
    """Minus what a sum that only grows, such as ``slid``, grew by in the decision; ``before`` is its ``previous_``."""
    return before - value
