"""How far a shirt's subtasks are: the hand at the hem, the arm under it, the collar, the sleeves' ends."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from understudy.options import check_range
from understudy.task import Context, Fields, Shape
from understudy_dressing.body import SIDES, TIP, Side, Vector, limb, sensors
from understudy_dressing.person import PersonScene, neutral_pose
from understudy_dressing.shirt import ShirtScene
from understudy_dressing.state import (
    Places,
    SleeveState,
    in_world,
    passes,
    pierces,
    places_on,
    refuse_other_side,
)

#: m: the target of a grip is so far outside of the patch's middle (2018 code).
_OUTSIDE = 0.03
#: From the base of the neck, hand last in the order of limbs: what the collar has to hold.
_NECK: tuple[tuple[str, Vector], ...] = (
    ("head", (0, 0, 0.275)), ("head", (0, 0, 0)), ("neck", (0, 0, 0)), ("torso", (0, 0, 0.2)),
)  # fmt: skip


def under_hem(
    arm: Tensor, triangle: Tensor, touched: Tensor, needed: bool
) -> tuple[Tensor, Tensor]:
    """Equation 19 of the joints `arm` (N, J, 3) m, from the fingertip on, and a `triangle` (N, 3, 3) m that turns so that
    its normal is up: 1 while the arm goes through it from below, −1 from above, else minus the fingertip's distance from
    its middle, m, (N,); and whether it goes through from below, (N,). If a touch from inside is `needed`, through from
    below without one, `touched` (N,), is −1 (2018 code, of the second arm)."""
    below = passes(arm, triangle)[0].any(dim=1)
    above = passes(arm, triangle.flip(1))[0].any(dim=1)
    away = (arm[:, 0] - triangle.mean(dim=1)).norm(dim=1)
    counts = torch.where(touched, 1.0, -1.0) if needed else 1.0
    return torch.where(below, counts, torch.where(above, -1.0, -away)), below


def grip_target(cloth: Tensor, patch: Tensor, around: Tensor) -> Tensor:
    """(N, 3) m: where a hand grips a hem of `cloth` (N, V, 3) m: so far outside of the middle of its vertices `patch` (P,), along
    the normal of the faces `around` (F, 3) them, which have them as corners."""
    a, b, c = (cloth[:, around[:, k]] for k in range(3))
    normal = torch.linalg.cross(b - a, c - a).sum(dim=1)
    normal = torch.nn.functional.normalize(normal, dim=1)
    return cloth[:, patch].mean(dim=1) + _OUTSIDE * normal


class ShirtState(Fields):
    """What subtasks of section 8.1 are about, each field of one number (N,) unless its shape is given.

    =========================  ==================================================================
    field                      what
    =========================  ==================================================================
    ``hand``                   (3,) m, the fingertip that is to grip
    ``grip_target``            (3,) m, 3 cm outside of the patch on the hem that it is to grip
    ``grip_distance``          m, between the two: equation 18
    ``gripped``                1 where that is less than `near`
    ``tuck``                   equation 19 as the 2018 code has it: 1 while the arm goes through the triangle of
                               gripping hand and shoulders from below, −1 while it does from above, or from below
                               without what `inside` asks, else minus the fingertip's distance from its middle, m
    ``behind``                 m, by which the fingertip of the arm that goes in is behind the torso's middle, 0 before it
    ``tip_sign``               of the fingertip: 1 where it is touched from inside, −1 from outside, 0 from neither
    ``tucked``                 1 while the arm does from below, its fingertip is touched from inside, and it pierces nothing
    ``dressed``                1 where `progress` is at least `enough` and the arm pierces nothing
    ``pierced``                1 while a bone of the arm that goes in goes through the cloth itself
    ``collar_lost``            1 where the collar holds neither neck nor head
    ``backwards``              1 while the arm goes into the sleeve by its end
    ``pose_distance``          rad, of the pose from the neutral one
    ``rested``                 1 where that is less than `rest`
    =========================  ==================================================================
    """

    @dataclass(frozen=True)
    class Options:
        side: Side = "left"  #: the arm that goes in (the paper's first)
        hand: Side = "right"  #: the hand that is to grip, or grips
        #: m, distance from the grip's target within which the hand has arrived (2018 code)
        near: float = 0.05
        #: progress from which on the arm is in its sleeve (2018 code: 0.6 of the first sleeve, 0.5
        #: of the second)
        enough: float = 0.6
        #: rad, distance from the neutral pose within which the person rests (2018 code)
        rest: float = 0.5
        #: whether an arm is under the hem only while its fingertip is touched from inside (2018 code: of the second
        #: arm); without it an arm that goes around the hem counts, too
        inside: bool = True

        def __post_init__(self) -> None:
            check_range(self, "near", most=1e3)
            check_range(self, "near", "rest", above=0)
            check_range(self, "enough", above=0, most=1)

    reads = ("xpos", "xquat", "qpos", "cloth_position", "progress", "sensor_sign")

    def __init__(self, options: Options, context: Context) -> None:
        self.options, device = options, context.device
        who = "fields 'dressing/shirt_state'"
        shirt = context.need_scene(ShirtScene, who)
        refuse_other_side(context, SleeveState.Options, options.side, who)
        person = context.need_scene(PersonScene, who)
        model = person.spec().compile()

        def numbers(found: np.ndarray) -> Tensor:
            return torch.from_numpy(np.ascontiguousarray(found)).to(device)

        def places(*named: tuple[str, Vector]) -> Places:
            return places_on(model, named, device)

        self._hand, self._limb = places((f"{options.hand}_hand", TIP)), places(*limb(options.side))
        self._neck = places(*_NECK)
        self._torso = places(("torso", (0, 0, 0)), ("torso", (1, 0, 0)))
        self._shoulders = places(*((f"{side}_upper_arm", (0, 0, 0)) for side in SIDES))
        self._patch, self._around = (numbers(found) for found in shirt.hem(options.hand))
        self._collar = numbers(shirt.collar)
        self._faces = numbers(shirt.faces)
        self._end = numbers(shirt.sleeve(options.side)["end"][::-1])
        felt = sensors()
        self._tip = max(i for i, one in enumerate(felt) if one[0] == f"{options.side}_hand")
        self._pose = neutral_pose(person).to(device)
        vector: Shape = (3,)
        one: Shape = ()
        names = ("grip_distance", "gripped", "tuck", "behind", "tip_sign", "tucked", "dressed", "pierced",
                 "collar_lost", "backwards", "pose_distance", "rested")  # fmt: skip
        self.provides = {"hand": vector, "grip_target": vector, **dict.fromkeys(names, one)}

    def compute(
        self, xpos: Tensor, xquat: Tensor, qpos: Tensor, cloth_position: Tensor, progress: Tensor,
        sensor_sign: Tensor,
    ) -> Mapping[str, Tensor]:  # fmt: skip
        def world(places: Places) -> Tensor:
            return in_world(places, xpos, xquat)

        hand, bones = world(self._hand)[:, 0], world(self._limb)
        target = grip_target(cloth_position, self._patch, self._around)
        distance = (hand - target).norm(dim=1)

        # forwards and up along its normal: from outside to between the body and what is held before it
        triangle = torch.cat([hand.unsqueeze(1), world(self._shoulders)], dim=1)
        torso = world(self._torso)
        before = ((bones[:, 0] - torso[:, 0]) * (torso[:, 1] - torso[:, 0])).sum(dim=1)
        sign = sensor_sign[:, self._tip]
        inside = sign > 0
        # fingertip to elbow: beyond, the arm ends in a corner of the triangle
        tuck, below = under_hem(bones[:, :4], triangle, inside, self.options.inside)

        pierced = pierces(bones, cloth_position[:, self._faces])
        lost = ~passes(world(self._neck), cloth_position[:, self._collar])[0].any(dim=1)
        backwards = passes(bones, cloth_position[:, self._end])[0].any(dim=1)
        off = (qpos[:, : len(self._pose)] - self._pose).norm(dim=1)
        return {
            "hand": hand,
            "grip_target": target,
            "grip_distance": distance,
            "gripped": (distance < self.options.near).float(),
            "tuck": tuck,
            "behind": (-before).clamp(min=0.0),
            "tip_sign": sign,
            "tucked": (below & inside & ~pierced).float(),
            "dressed": ((progress >= self.options.enough) & ~pierced).float(),
            "pierced": pierced.float(),
            "collar_lost": lost.float(),
            "backwards": backwards.float(),
            "pose_distance": off,
            "rested": (off < self.options.rest).float(),
        }
