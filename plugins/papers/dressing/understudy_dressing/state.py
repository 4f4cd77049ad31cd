"""The state of person and sleeve together: touch, the limb in the opening, the task vector."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.task import Context, Fields, Shape
from understudy_cloth.mesh import face_areas
from understudy_dressing.body import Side, Vector, limb, sensors
from understudy_dressing.garment import GarmentScene
from understudy_dressing.person import PersonScene
from understudy_dressing.sleeve import geodesic
from understudy_tensors import rotations

#: N: a vertex with less force is not touched.
_TOUCH = 1e-6


def centre_and_normal(loop: Tensor) -> tuple[Tensor, Tensor]:
    """Centroid (N, 3) and unit normal (N, 3) of the plane that best fits a loop's vertices (N, L, 3): its
    area vector, so the vertices turn about it by the right hand."""
    centre = loop.mean(dim=1)
    from_centre = loop - centre.unsqueeze(1)
    area = torch.linalg.cross(from_centre, from_centre.roll(-1, dims=1)).sum(dim=1)
    return centre, torch.nn.functional.normalize(area, dim=1)


def passes(limb: Tensor, loop: Tensor) -> tuple[Tensor, Tensor]:
    """Equations 9 and 10: which bones of a limb go through a loop's polygon in its best-fit plane, along the
    normal, hand first.

    `limb` (N, K + 1, 3) are the places from the hand inwards, `loop` (N, L, 3). Returns (N, K) bool, and (N, K)
    m: how much of the limb is beyond, if this bone is the one.
    """
    centre, normal = centre_and_normal(loop)
    height = ((limb - centre.unsqueeze(1)) * normal.unsqueeze(1)).sum(-1)  # (N, K + 1)
    far, near = height[:, :-1], height[:, 1:]
    crosses = (far > 0) & (near <= 0)
    share = torch.where(crosses, far / (far - near).clamp(min=1e-9), torch.zeros_like(far))
    at = limb[:, :-1] + share.unsqueeze(-1) * (limb[:, 1:] - limb[:, :-1])  # (N, K, 3)
    to = loop.unsqueeze(1) - at.unsqueeze(2)  # (N, K, L, 3)
    n = normal[:, None, None]
    flat = to - (to * n).sum(-1, keepdim=True) * n
    following = flat.roll(-1, dims=2)
    sine = (torch.linalg.cross(flat, following) * n).sum(-1)
    around = torch.atan2(sine, (flat * following).sum(-1)).sum(-1)  # ±2π inside, 0 outside
    length = (limb[:, :-1] - limb[:, 1:]).norm(dim=-1)
    before = length.cumsum(1) - length
    return crosses & (around.abs() > math.pi), before + share * length


def progress(limb: Tensor, entrance: Tensor) -> tuple[Tensor, Tensor]:
    """Equations 9 to 11: whether a bone of the `limb` (N, K + 1, 3) m, from the fingertip on, goes through the loop
    `entrance` (N, L, 3) m, (N,), and which share of the limb is in, or minus the fingertip's distance to it, m, (N,)."""
    through, depth = passes(limb, entrance)
    length = (limb[:, :-1] - limb[:, 1:]).norm(dim=-1).sum(1)
    contained = through.any(dim=1)
    first = through.float().argmax(dim=1, keepdim=True)
    inside = depth.gather(1, first).squeeze(1) / length
    outside = -(limb[:, 0] - entrance.mean(dim=1)).norm(dim=1)
    return contained, torch.where(contained, inside, outside)


def pierces(limb: Tensor, faces: Tensor) -> Tensor:
    """(N,) whether a bone of the `limb` (N, K + 1, 3) m goes through one of the triangles `faces` (N, F, 3, 3) m. An arm
    that cloth was drawn over goes through none; one that was pushed through cloth does, for as long as it is through."""
    a = faces[:, :, 0]
    first, second = faces[:, :, 1] - a, faces[:, :, 2] - a
    normal = torch.linalg.cross(first, second)
    height = [((place - a) * normal).sum(-1) for place in limb.unsqueeze(2).unbind(1)]  # (N, F)
    found = torch.zeros(len(limb), dtype=torch.bool, device=limb.device)
    for k in range(limb.shape[1] - 1):
        way = (limb[:, k + 1] - limb[:, k]).unsqueeze(1)
        turned = torch.linalg.cross(limb[:, k].unsqueeze(1) - a, way.expand_as(a))
        slope = (way * normal).sum(-1)
        u, v = (turned * second).sum(-1) * -slope.sign(), (turned * first).sum(-1) * slope.sign()
        inside = (u >= 0) & (v >= 0) & (u + v <= slope.abs()) & (slope != 0)
        found |= (inside & (height[k] * height[k + 1] <= 0)).any(dim=1)
    return found


#: Bodies' numbers (K,), and a point in the frame of each (K, 3), m.
Places = tuple[Tensor, Tensor]


def places_on(
    model: mujoco.MjModel, named: Sequence[tuple[str, Vector]], device: torch.device
) -> Places:
    """Points, m, of the bodies of these names."""
    ids = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) for name, _ in named]
    points = torch.tensor([point for _, point in named], dtype=torch.float32)
    return torch.tensor(ids, device=device), points.to(device)


def in_world(places: Places, xpos: Tensor, xquat: Tensor) -> Tensor:
    """(N, K, 3) m: where they are while the bodies are at `xpos` (N, B, 3) m, turned by `xquat` (N, B, 4)."""
    bodies, points = places
    turned = rotations.rotate(xquat[:, bodies], points.expand(len(xpos), -1, -1))
    return xpos[:, bodies] + turned


def _nearest(points: Tensor, sites: Tensor) -> Tensor:
    """(N, P) of the sites (N, S, 3) the one nearest to each point (N, P, 3), all in metres. By differences:
    ``torch.cdist`` without products, which round, took 15 ms of an H100 for 512 sleeves and 22 sites."""
    squared = torch.zeros((), device=points.device)
    for k in range(3):
        squared = squared + (points[:, :, k, None] - sites[:, None, :, k]).square()
    return squared.argmin(dim=2)


def sleeve_for(garment: GarmentScene, side: Side, who: str) -> Mapping[str, np.ndarray]:
    """The loops of the sleeve that the arm of `side` goes into.

    Raises
    ------
    ConfigError
        the garment is held by its other sleeve.
    """
    if garment.held not in (None, side):
        raise ConfigError(
            f"{who} is of the {side} arm, and the garment is held by its {garment.held} sleeve: set side={garment.held} there, or "
            f"scenes.cloth.side={side}."
        )
    return garment.sleeve(side)


def refuse_other_side(
    context: Context, kind: type, side: Side, who: str, option: str = "side"
) -> None:
    """Refuse `who`, a part of the arm of `side`, where all fields with options of the `kind` have the other arm as their `option`."""
    theirs = [one for one in context.chosen.get("fields", ()) if isinstance(one.options, kind)]
    if theirs and side not in [getattr(one.options, option) for one in theirs]:
        other, where = getattr(theirs[0].options, option), f"{theirs[0].where}.{option}"
        raise ConfigError(
            f"{who} is of the {side} arm, and {where}={other}: set both to {side}, or both to {other}."
        )


class LimbProgress(Fields):
    """``limb_progress`` () is the same as ``progress`` of :class:`SleeveState`, computed by itself: memories that read it in every
    control period need no more, and touch costs ten times as much."""

    @dataclass(frozen=True)
    class Options:
        side: Side = "right"  #: the arm that goes in

    reads = ("xpos", "xquat", "cloth_position")

    def __init__(self, options: Options, context: Context) -> None:
        who = "fields 'dressing/limb_progress'"
        garment = context.need_scene(GarmentScene, who)
        model = context.need_scene(PersonScene, who).spec().compile()
        refuse_other_side(context, SleeveState.Options, options.side, who)
        self._limb = places_on(model, limb(options.side), context.device)
        entrance = sleeve_for(garment, options.side, who)["entrance"]
        self._entrance = torch.from_numpy(entrance.copy()).to(context.device)
        self.provides = {"limb_progress": ()}

    def compute(self, xpos: Tensor, xquat: Tensor, cloth_position: Tensor) -> Mapping[str, Tensor]:
        bones = in_world(self._limb, xpos, xquat)
        return {"limb_progress": progress(bones, cloth_position[:, self._entrance])[1]}


class SleeveState(Fields):
    """Sections 6.2 to 7.1 for a sleeve. S sensors; forces are the cloth's on the person, mean of the last step.

    =========================  ==================================================================
    field                      shape
    =========================  ==================================================================
    ``sensor_force``           (S, 3) N, world frame, equation 4: each contact goes to the nearest sensor
    ``sensor_sign``            (S,) equation 5: 1 touched from inside, −1 from outside, 0 not
    ``fingertip``              (3,) m
    ``fingertip_offset``       (3,) m, from the shoulder
    ``feature``                (3,) m, the centroid of the sleeve's middle loop
    ``task_vector``            (3,) unit, equation 7
    ``contained``              () 1 while a bone goes through the entrance, hand first; equation 9
    ``progress``               () equation 11: share of the limb that is in, or minus the fingertip's
                               distance to the entrance, m
    ``touched_geodesic``       () of the touched vertex that is nearest to the loop along the cloth, as a
                               share of the farthest; 1 where the fingertip touches nothing
    ``touching``               () 1 while the fingertip touches
    ``area_ratio``             () equation 12: the largest of any triangle, over its area at rest
    =========================  ==================================================================
    """

    @dataclass(frozen=True)
    class Options:
        side: Side = "right"  #: the arm that goes in; the gown's track ends at the right shoulder

    reads = ("xpos", "xquat", "cloth_position", "contact_force", "contact_side")

    def __init__(self, options: Options, context: Context) -> None:
        who = "fields 'dressing/sleeve_state'"
        garment = context.need_scene(GarmentScene, who)
        person = context.need_scene(PersonScene, who)
        device = context.device
        model = person.spec().compile()

        felt = sensors()
        self._sensors = places_on(model, felt, device)
        self._limb = places_on(model, limb(options.side), device)
        self._number = torch.arange(len(felt), device=device).unsqueeze(1)
        self._tip = max(i for i, one in enumerate(felt) if one[0] == f"{options.side}_hand")
        loops = sleeve_for(garment, options.side, who)
        self._loops = {
            name: torch.from_numpy(loop.copy()).to(device) for name, loop in loops.items()
        }
        self._faces = torch.tensor(garment.faces, device=device)
        area = 2.0 * face_areas(garment.corners)
        self._area = torch.tensor(area, dtype=torch.float32, device=device)
        along = geodesic(garment.laid_out, garment.faces, loops["middle"])
        self._distance = torch.tensor(along.distance, dtype=torch.float32, device=device)
        self._towards = torch.tensor(along.towards, device=device)
        vector: Shape = (3,)
        self.provides = {
            "sensor_force": (len(felt), 3), "sensor_sign": (len(felt),), "fingertip": vector,
            "fingertip_offset": vector, "feature": vector, "task_vector": vector, "contained": (),
            "progress": (), "touched_geodesic": (), "touching": (), "area_ratio": (),
        }  # fmt: skip

    def _areas(self, positions: Tensor) -> Tensor:
        """(N, F) m², twice the triangles'."""
        a, b, c = (positions[:, self._faces[:, k]] for k in range(3))
        return torch.linalg.cross(b - a, c - a).norm(dim=-1)

    def compute(
        self, xpos: Tensor, xquat: Tensor, cloth_position: Tensor, contact_force: Tensor, contact_side: Tensor
    ) -> Mapping[str, Tensor]:  # fmt: skip
        felt = in_world(self._sensors, xpos, xquat)
        bones = in_world(self._limb, xpos, xquat)
        touched = contact_force.norm(dim=-1) > _TOUCH
        nearest = _nearest(cloth_position, felt)
        # products, not scatter_add, whose order differs from run to run on a GPU
        to = (nearest.unsqueeze(1) == self._number).float()  # (N, S, V)
        force = to @ -contact_force
        side = torch.where(touched, contact_side, 0.0)
        sign = (to @ side.unsqueeze(-1)).squeeze(-1).sign()

        tip = bones[:, 0]
        contained, advance = progress(bones, cloth_position[:, self._loops["entrance"]])

        feature, normal = centre_and_normal(cloth_position[:, self._loops["middle"]])
        by_tip = touched & (nearest == self._tip)
        inner = (contact_side > 0).long()  # pushed outwards: touched from inside
        distance = torch.where(inner == 1, self._distance[1], self._distance[0])
        least, vertex = torch.where(by_tip, distance, 2.0).min(dim=1)
        touching = least < 1.5
        vertex = vertex.unsqueeze(1)
        then = torch.where(inner == 1, self._towards[1], self._towards[0]).gather(1, vertex)

        def at(index: Tensor) -> Tensor:
            return cloth_position.gather(1, index.unsqueeze(-1).expand(-1, -1, 3)).squeeze(1)

        along = torch.where(touching.unsqueeze(1), at(then) - at(vertex), feature - tip)
        vector = torch.where(
            contained.unsqueeze(1), normal, torch.nn.functional.normalize(along, dim=1)
        )
        return {
            "sensor_force": force,
            "sensor_sign": sign,
            "fingertip": tip,
            "fingertip_offset": tip - bones[:, 4],
            "feature": feature,
            "task_vector": vector,
            "contained": contained.float(),
            "progress": advance,
            "touched_geodesic": torch.where(touching, least, 1.0),
            "touching": touching.float(),
            "area_ratio": (self._areas(cloth_position) / self._area).amax(dim=1),
        }
