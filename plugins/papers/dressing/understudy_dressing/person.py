"""The person in MuJoCo: pelvis fixed, 22 hinges driven by torques, no gravity; and a gripper that floats."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import combinations

import mujoco
import numpy as np
import torch
from torch import Tensor

from understudy.options import check_range
from understudy.task import Context
from understudy_dressing.body import FREE, GRIPPER, LINKS, SIDES, Hinge, Side, Vector
from understudy_dressing.cone import fitted
from understudy_mujoco.scene import MujocoScene

_UPPER_ARM = 0.30  #: m, from shoulder to elbow
#: Of a driven gripper (2018 code): N s/m and N m s; N and N m, of an action of 1.
_DRAG, _PULL = 1.0, 2.0
_SKIN, _STEEL = (0.85, 0.62, 0.45, 1.0), (0.45, 0.50, 0.56, 1.0)
#: Of these no two keep apart (2018 code), nor do links that a joint connects.
_NECK_AND_SHOULDERS = ("torso", "neck", "head", "left_clavicle", "right_clavicle")
#: m: a tapered capsule is made solid in pieces whose ends differ by no more.
_STEP = 0.015


def _solid(
    ra: float, a: Vector, rb: float, b: Vector
) -> list[tuple[float, list[float], list[float]]]:
    """(radius, from, to) in m of capsules around a tapered one, each as thick as its thicker end: MuJoCo has no tapered
    ones, and cloth has to find room between two links."""
    pieces = max(1, round(abs(ra - rb) / _STEP))
    begin, way, found = np.array(a), np.subtract(b, a), []
    for k in range(pieces):
        low, high = k / pieces, (k + 1) / pieces
        radius = max(ra + low * (rb - ra), ra + high * (rb - ra))
        found.append((radius, (begin + low * way).tolist(), (begin + high * way).tolist()))
    return found


class PersonScene(MujocoScene):
    """The person of the 2018 paper, 22 hinges, and a gripper of 1 kg that nothing holds back, or that forces drive."""

    recorded = ("qpos",)

    @dataclass(frozen=True)
    class Options:
        #: hinges that have no torque and no freedom but stay as they are; a prefix names several
        still: tuple[str, ...] = ()
        damping: float | None = 3.0  #: N m s, of all hinges; null is each one's own (gown: 3)
        #: whether the gripper turns, too, is damped, and has motors of its own after the hinges' (section 8.3)
        driven: bool = False
        #: whether links of which none joins the other keep apart (2018 code: they do); cloth between two that do not is torn
        self_collision: bool = False
        #: whether upper arms stay within a cone in place of swinging freely (section 8:
        #: a classifier, which was not published); elbow and twist keep the 2018 code's ranges
        cone: bool = False

        def __post_init__(self) -> None:
            check_range(self, "damping", least=0, most=1e5)
            names = [hinge.name for link in LINKS for hinge in link.hinges]
            for one in self.still:
                if not any(name.startswith(one) for name in names):
                    raise ValueError(
                        f"still names '{one}', with which no hinge begins. They are {', '.join(names)}."
                    )

    def __init__(self, options: Options, context: Context | None = None) -> None:
        self.options = options
        #: Those that move, in the order of ``qpos``.
        self.hinges = tuple(
            hinge for link in LINKS for hinge in link.hinges
            if not any(hinge.name.startswith(one) for one in options.still)
        )  # fmt: skip

    def spec(self) -> mujoco.MjSpec:
        spec = mujoco.MjSpec()
        spec.option.gravity = [0, 0, 0]
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        # limits of joints are all that is solved for; on a GPU all worlds wait for the one that needs most
        spec.option.iterations, spec.option.ls_iterations = 6, 8
        spec.compiler.degree = False
        spec.visual.headlight.ambient = [0.4, 0.4, 0.4]
        bodies = {}
        for link in LINKS:
            parent = bodies[link.parent] if link.parent else spec.worldbody
            body = bodies[link.name] = parent.add_body(name=link.name, pos=link.position)
            for hinge in link.hinges:
                if hinge in self.hinges:
                    self._add(spec, body, hinge)
            for ra, a, rb, b in link.shapes:
                body.add_geom(
                    type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[*a, *b], size=[(ra + rb) / 2, 0, 0],
                    mass=link.mass / len(link.shapes), contype=0, conaffinity=0, rgba=_SKIN,
                )  # fmt: skip
                if self.options.self_collision:
                    for radius, begin, end in _solid(ra, a, rb, b):
                        body.add_geom(
                            type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[*begin, *end], size=[radius, 0, 0],
                            mass=0.0, contype=1, conaffinity=1, condim=1, group=3,
                        )  # fmt: skip
            if not link.shapes:
                body.explicitinertial, body.mass = True, link.mass
                body.inertia = [1e-3] * 3
        if self.options.self_collision:
            for first, second in combinations(_NECK_AND_SHOULDERS, 2):
                spec.add_exclude(bodyname1=first, bodyname2=second)
        if self.options.cone:
            for side in SIDES:
                _add_cone(spec, side, bodies)
        gripper = spec.worldbody.add_body(name=GRIPPER)
        gripper.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.02, 0.05, 0.01], mass=1.0,
                         contype=0, conaffinity=0, rgba=_STEEL)  # fmt: skip
        kinds = (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE)
        for kind, of in zip(kinds[: 1 + self.options.driven], ("", "turn_"), strict=False):
            for axis in np.eye(3):
                name = f"{GRIPPER}_{of}{'xyz'[int(axis.argmax())]}"
                gripper.add_joint(
                    name=name, axis=axis, type=kind, damping=[_DRAG * self.options.driven, 0, 0],
                )  # fmt: skip
                if self.options.driven:
                    motor = spec.add_actuator(name=name, target=name)
                    motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
                    motor.gear[0] = _PULL
                    motor.ctrllimited, motor.ctrlrange = True, [-1, 1]
        if self.options.driven:  # as large as a hand: a steel box would turn at any touch
            gripper.explicitinertial, gripper.mass = True, 1.0
            gripper.inertia = [1e-2] * 3
        return spec

    def _add(self, spec: mujoco.MjSpec, body: mujoco.MjsBody, hinge: Hinge) -> None:
        damping = hinge.damping if self.options.damping is None else self.options.damping
        body.add_joint(
            name=hinge.name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=hinge.axis, damping=[damping, 0, 0],
            armature=1e-3, limited=hinge.high < FREE, range=[hinge.low, hinge.high],
        )  # fmt: skip
        motor = spec.add_actuator(name=hinge.name, target=hinge.name)
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        motor.gear[0] = hinge.torque
        motor.ctrllimited, motor.ctrlrange = True, [-1, 1]


def _add_cone(spec: mujoco.MjSpec, side: Side, bodies: Mapping[str, mujoco.MjsBody]) -> None:
    """A tendon from the elbow to both foci of the cone, no longer than the border lets it be."""
    cone, out = fitted(), np.array([1.0, 1.0 if side == "left" else -1.0, 1.0])
    arm, shoulder = bodies[f"{side}_upper_arm"], bodies[f"{side}_clavicle"]
    arm.add_site(name=f"{side}_cone_elbow", pos=[0, 0, -_UPPER_ARM])
    joint = next(link.position for link in LINKS if link.name == arm.name)
    tendon = spec.add_tendon(
        name=f"{side}_cone", limited=True, range=[0, _UPPER_ARM * cone.most], rgba=[0, 0, 0, 0]
    )
    names = [f"{side}_cone_{k}" for k in range(2)]
    for name, focus in zip(names, cone.foci, strict=True):
        shoulder.add_site(name=name, pos=(joint + _UPPER_ARM * out * focus).tolist())
    for name in (names[0], f"{side}_cone_elbow", names[1]):
        tendon.wrap_site(name)


def neutral_pose(person: PersonScene) -> Tensor:
    """(Q,) rad: all 0, elbows 0.21."""
    return torch.tensor([0.21 if hinge.name.endswith("elbow") else 0.0 for hinge in person.hinges])


def depth_in(person: PersonScene, pose: np.ndarray) -> Callable[..., np.ndarray]:
    """The function from points (P, 3), m, world frame, to how deep each is in the person in that pose (Q,) rad,
    (P,) m; negative outside. Given `near` m as well, it may say -inf of those that are farther from the person than that,
    which takes far less time where most are."""
    model = person.model
    data = mujoco.MjData(model)
    data.qpos[: len(pose)] = pose
    mujoco.mj_kinematics(model, data)
    shapes = []
    for link in LINKS:
        body = data.body(link.name)
        place, turn = body.xpos.copy(), body.xmat.reshape(3, 3).copy()
        for ra, a, rb, b in link.shapes:
            ends, radii = place + np.array([a, b]) @ turn.T, np.array([[ra], [rb]])
            box = (ends - radii).min(axis=0), (ends + radii).max(axis=0)
            shapes.append((box, place, turn, ra, np.array(a), rb - ra, np.subtract(b, a)))

    def depth(points: np.ndarray, near: float = np.inf) -> np.ndarray:
        deepest = np.full(len(points), -np.inf)
        around = points.min(axis=0) - near, points.max(axis=0) + near
        for (low, high), place, turn, radius, begin, wider, way in shapes:
            if (around[0] > high).any() or (around[1] < low).any():
                continue
            # all the points in its box, and near it
            rows = ((points >= low - near) & (points <= high + near)).all(axis=1).nonzero()[0]
            local = (points[rows] - place) @ turn - begin
            share = np.clip(local @ way / (way @ way), 0.0, 1.0)
            away = np.linalg.norm(local - share[:, None] * way, axis=1)
            deepest[rows] = np.maximum(deepest[rows], radius + share * wider - away)
        return deepest

    return depth
