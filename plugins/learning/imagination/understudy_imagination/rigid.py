# pyright: reportAttributeAccessIssue=false
"""Kinematics of a MuJoCo model in torch: B states at once, differentiable, MuJoCo's fields.

A state is ``qpos`` (B, nq) and ``qvel`` (B, nv). A *step* (B, nv) is a displacement as MuJoCo defines
it: positions of free joints move along the world's axes, rotations turn in their own frames.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import NamedTuple

import mujoco
import numpy as np
import torch
from torch import Tensor

from understudy.task import Shape
from understudy_tensors import rotations

_FREE, _BALL = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
_SLIDE, _HINGE = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
_PLANE, _SPHERE = int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_SPHERE)
_CAPSULE = int(mujoco.mjtGeom.mjGEOM_CAPSULE)


class _Slot(NamedTuple):
    """The k-th joint of every body that has so many, in the order of the levels."""

    joints: Tensor  #: (nb,) rows of the joints' quaternions and angular velocities
    #: (nb,) rows of the slides' axes times displacements; None: there are none
    slide: Tensor | None
    anchor: Tensor | None  #: (nb, 3) m, in the body; None: all are at the bodies' origins


class Rigid:
    """The bodies of `model`, on one device, float32."""

    def __init__(self, model: mujoco.MjModel, device: torch.device) -> None:
        self.nq, self.nv, self.nu = model.nq, model.nv, model.nu
        self._device = device
        kinds, at, dof = model.jnt_type, model.jnt_qposadr, model.jnt_dofadr
        free, ball, hinge, slide = (
            np.flatnonzero(kinds == k) for k in (_FREE, _BALL, _HINGE, _SLIDE)
        )
        self.frees = len(free)
        scalar = np.concatenate([hinge, slide])
        three, four = np.arange(3), np.arange(4)
        #: Of quaternions, those of free joints first: addresses in qpos (Q, 4) and qvel (Q, 3).
        quaternions = np.concatenate([at[free, None] + 3 + four, at[ball, None] + four])
        turns = np.concatenate([dof[free, None] + 3 + three, dof[ball, None] + three])
        lines = np.concatenate([(at[free, None] + three).ravel(), at[scalar]])
        line_dofs = np.concatenate([(dof[free, None] + three).ravel(), dof[scalar]])
        self._quaternions, self._turns = self._rows(quaternions.ravel()), self._rows(turns.ravel())
        self._lines, self._line_dofs = self._rows(lines), self._rows(line_dofs)
        self._to_qpos = self._rows(np.argsort(np.concatenate([lines, quaternions.ravel()])))
        self._to_qvel = self._rows(np.argsort(np.concatenate([line_dofs, turns.ravel()])))
        self._scalars = slice(3 * len(free), None)  # of the lines
        self._zeros = self._numbers(model.qpos0[at[scalar]])
        self._unturned = self._numbers(np.eye(4)[0])
        self._axes = self._numbers(model.jnt_axis[scalar])
        self._hinges = len(hinge)
        #: Columns of :meth:`lengths` and :meth:`shape`.
        self.lengths_size = len(scalar) + 3 * len(ball)
        #: Whether it matters where the root stands: something stands around it that is no floor.
        self.placed = any(
            model.body_weldid[body] == 0 and kind != _PLANE and (contacts or affinity)
            for body, kind, contacts, affinity in zip(
                model.geom_bodyid, model.geom_type, model.geom_contype, model.geom_conaffinity,
                strict=True,
            )
        )  # fmt: skip
        self.shape_size = (4 + 5 * self.placed + 9 * (len(free) - 1)) if len(free) else 0
        self._tree(model, free, ball, hinge, slide)
        self._things(model)

    def _rows(self, values: np.ndarray | Sequence[int]) -> Tensor:
        return torch.as_tensor(np.asarray(values), dtype=torch.long, device=self._device)

    def _numbers(self, values: np.ndarray) -> Tensor:
        return torch.as_tensor(np.array(values), dtype=torch.float32, device=self._device)

    def _tree(
        self,
        model: mujoco.MjModel,
        free: np.ndarray,
        ball: np.ndarray,
        hinge: np.ndarray,
        slide: np.ndarray,
    ) -> None:
        """Bodies by their depth below the world, and their joints by turns."""
        parents = model.body_parentid
        depth = np.zeros(model.nbody, dtype=int)
        for body in range(1, model.nbody):
            depth[body] = depth[parents[body]] + 1
        at = [np.flatnonzero(depth == level).tolist() for level in range(depth.max() + 1)]
        order = [body for bodies in at[1:] for body in bodies]
        place = {body: row for row, body in enumerate(order)}
        self._levels = []  # of each, its rows, and within the level above those of its parents
        for above, bodies in itertools.pairwise(at):
            rows = slice(place[bodies[0]], place[bodies[-1]] + 1)
            own = [above.index(int(parents[b])) for b in bodies]
            self._levels.append((rows, self._rows(own)))
        # The world comes last; with it bodies are in MuJoCo's order again.
        self._bodies = self._rows([len(order), *(place[b] for b in range(1, model.nbody))])
        loose = model.body_jntnum.astype(bool) & np.isin(
            np.arange(model.nbody), model.jnt_bodyid[free]
        )
        quat, pos = model.body_quat.copy(), model.body_pos.copy()
        quat[loose], pos[loose] = (1.0, 0.0, 0.0, 0.0), 0.0
        self._rests, self._offsets = self._numbers(quat[order]), self._numbers(pos[order])
        self._rested = bool(np.allclose(quat[order], (1.0, 0.0, 0.0, 0.0)))
        self._loose = self._rows([place[model.jnt_bodyid[j]] for j in free])
        #: Rows of quaternions: free, ball, hinges, and one of no turn; of slides one of none at last.
        row = {j: k for k, j in enumerate([*free, *ball, *hinge])}
        glide = {j: k for k, j in enumerate(slide)}
        self._slots = []
        for k in range(int(model.body_jntnum.max())):
            joints = [model.body_jntadr[b] + k if model.body_jntnum[b] > k else -1 for b in order]
            slides = [glide.get(j, len(glide)) for j in joints]
            anchors = [
                model.jnt_pos[j] if j >= 0 and j not in free else np.zeros(3) for j in joints
            ]
            self._slots.append(
                _Slot(
                    self._rows([row.get(j, len(row)) for j in joints]),
                    self._rows(slides) if min(slides) < len(glide) else None,
                    self._numbers(np.array(anchors)) if np.any(anchors) else None,
                )
            )

    def _things(self, model: mujoco.MjModel) -> None:
        """Masses, geoms, sites, actuators, and where bodies may touch what is around them."""
        below = np.eye(model.nbody)
        for body in range(model.nbody - 1, 0, -1):
            below[model.body_parentid[body]] += below[body]
        masses = below * model.body_mass
        self._shares = self._numbers(masses / np.maximum(masses.sum(1, keepdims=True), 1e-12))
        self._centres = self._numbers(model.body_ipos)
        self._roots = self._rows(model.body_rootid)
        self._geoms = self._carried(model.geom_bodyid, model.geom_pos, model.geom_quat)
        self._sites = self._carried(model.site_bodyid, model.site_pos, model.site_quat)
        self._touching(model)
        self._actuators(model)

    def _actuators(self, model: mujoco.MjModel) -> None:
        """Which of the lengths each servo is driven by, and its gear."""
        joints = model.actuator_trnid[:, 0]
        servos, columns = np.zeros(model.nu), np.zeros(model.nu, dtype=int)
        balls, hinges, slides = (
            np.flatnonzero(model.jnt_type == kind).tolist() for kind in (_BALL, _HINGE, _SLIDE)
        )
        scalar = hinges + slides  # the order of `lengths`
        for actuator in range(model.nu):
            joint, gear = int(joints[actuator]), model.actuator_gear[actuator, :3]
            direct = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
            if not direct or model.actuator_biasprm[actuator, 1] == 0.0:
                continue
            if joint in scalar:
                servos[actuator], columns[actuator] = gear[0], scalar.index(joint)
            elif joint in balls and np.count_nonzero(gear) == 1:
                axis = int(np.flatnonzero(gear)[0])
                servos[actuator] = gear[axis]
                columns[actuator] = len(scalar) + 3 * balls.index(joint) + axis
        self._servos, self._columns = self._numbers(servos), self._rows(columns)

    def _carried(
        self, bodies: np.ndarray, places: np.ndarray, turns: np.ndarray
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Bodies (K,), and of what they carry places (K, 3) and rotations (K, 3, 3) in them."""
        matrices = rotations.to_matrix(self._numbers(turns))
        return self._rows(bodies), self._numbers(places), matrices

    def _touching(self, model: mujoco.MjModel) -> None:
        """Points of geoms that collide: centres of spheres, ends of capsules, corners of others."""
        bodies, points, radii = [], [], []
        for geom in range(model.ngeom):
            body = int(model.geom_bodyid[geom])
            if model.body_weldid[body] == 0 or not (
                model.geom_contype[geom] or model.geom_conaffinity[geom]
            ):
                continue
            kind, size = int(model.geom_type[geom]), model.geom_size[geom]
            if kind == _SPHERE:
                own, radius = np.zeros((1, 3)), size[0]
            elif kind == _CAPSULE:
                own, radius = np.array([[0.0, 0.0, -size[1]], [0.0, 0.0, size[1]]]), size[0]
            else:
                middle, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
                signs = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3, indexing="ij"), -1).reshape(-1, 3)
                own, radius = middle + signs * half, 0.0
            matrix = np.zeros(9)
            mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
            points.append(own @ matrix.reshape(3, 3).T + model.geom_pos[geom])
            bodies += [body] * len(own)
            radii += [radius] * len(own)
        self.touching = len(bodies)  #: how many points there are
        self._touch_bodies = self._rows(bodies)
        self._touch_points = self._numbers(np.concatenate(points) if points else np.zeros((0, 3)))
        self._touch_radii = self._numbers(np.array(radii))

    def moved(self, qpos: Tensor, step: Tensor) -> Tensor:
        """``qpos`` (B, nq) after a `step` (B, nv), as ``mj_integratePos``."""
        turn = step.index_select(1, self._turns).unflatten(1, (-1, 3))
        turned = rotations.multiply(self._rotations(qpos), rotations.from_exponential_map(turn))
        lines = qpos.index_select(1, self._lines) + step.index_select(1, self._line_dofs)
        parts = torch.cat([lines, rotations.normalize(turned).flatten(1)], dim=1)
        return parts.index_select(1, self._to_qpos)

    def difference(self, before: Tensor, after: Tensor) -> Tensor:
        """The step (B, nv) from `before` to `after`, each (B, nq), as ``mj_differentiatePos``."""
        first, second = self._rotations(before), self._rotations(after)
        turns = rotations.to_exponential_map(rotations.multiply(rotations.conjugate(first), second))
        lines = after.index_select(1, self._lines) - before.index_select(1, self._lines)
        return torch.cat([lines, turns.flatten(1)], dim=1).index_select(1, self._to_qvel)

    def _rotations(self, qpos: Tensor) -> Tensor:
        """(B, Q, 4)"""
        return qpos.index_select(1, self._quaternions).unflatten(1, (-1, 4))

    def root(self, qpos: Tensor) -> Tensor:
        """(B, 4): the rotation of the first free joint; none where there is no such joint."""
        if not self.frees:
            return self._unturned.expand(len(qpos), 4)
        return self._rotations(qpos)[:, 0]

    def in_root(self, qpos: Tensor, speed: Tensor, *, back: bool = False) -> Tensor:
        """`speed` (B, nv), the linear velocities of free joints seen from the root instead of from the
        world, or `back`."""
        if not self.frees:
            return speed
        turn = rotations.rotate if back else rotations.inverse_rotate
        lines = speed.index_select(1, self._line_dofs)
        linear = lines[:, : 3 * self.frees].unflatten(1, (-1, 3))
        linear = turn(self.root(qpos).unsqueeze(1), linear).flatten(1)
        turns = speed.index_select(1, self._turns)
        return torch.cat([linear, lines[:, self._scalars], turns], 1).index_select(1, self._to_qvel)

    def lengths(self, qpos: Tensor) -> Tensor:
        """(B, …): angles of hinges, displacements of slides, exponential maps of balls."""
        balls = rotations.to_exponential_map(self._rotations(qpos)[:, self.frees :])
        return torch.cat([qpos.index_select(1, self._lines)[:, self._scalars], balls.flatten(1)], 1)

    def deflection(self, control: Tensor, lengths: Tensor) -> Tensor:
        """(B, U): how far each servo's target is from where it is; of other actuators the control."""
        if not lengths.shape[1]:
            return control
        return control - self._servos * lengths.index_select(1, self._columns)

    def shape(self, qpos: Tensor) -> Tensor:
        """(B, …): where free joints are. Of the root its height and up, where it is ``placed`` its
        position and x axis too; of others, seen from it, position and two axes."""
        if not self.frees:
            return qpos[:, :0]
        every = self._rotations(qpos)[:, : self.frees]
        places = qpos.index_select(1, self._lines)[:, : 3 * self.frees].unflatten(1, (-1, 3))
        root = every[:, 0]
        found = [places[:, 0, 2:], rotations.to_matrix(root)[:, 2]]
        if self.placed:
            found += [places[:, 0, :2], rotations.to_matrix(root)[:, :, 0]]
        if self.frees > 1:
            inverse = rotations.conjugate(root).unsqueeze(1)
            away = rotations.rotate(inverse, places[:, 1:] - places[:, :1])
            axes = rotations.tangent_normal(rotations.multiply(inverse, every[:, 1:]))
            found += [away.flatten(1), axes.flatten(1)]
        return torch.cat(found, dim=1)

    def posed(self, qpos: Tensor, qvel: Tensor) -> Posed:
        return Posed(self, qpos, qvel)

    def locally(self, qpos: Tensor, qvel: Tensor) -> tuple[Tensor, Tensor]:
        """(B, nb, 3, 6): of each body, from its parent: rotation, position, angular and linear velocity;
        and (B, nb, 4) the rotation again."""
        count = len(qpos)
        scalars = qpos.index_select(1, self._lines)[:, self._scalars] - self._zeros
        rates = qvel.index_select(1, self._line_dofs)[:, self._scalars]
        hinge = rotations.from_axis_angle(self._axes[: self._hinges], scalars[:, : self._hinges])
        still = self._unturned.expand(count, 1, 4)
        turns = torch.cat([rotations.normalize(self._rotations(qpos)), hinge, still], dim=1)
        spins = torch.cat(
            [
                qvel.index_select(1, self._turns).unflatten(1, (-1, 3)),
                self._axes[: self._hinges] * rates[:, : self._hinges, None],
                still[..., 1:],
            ],
            dim=1,
        )
        place, speed = self._offsets.expand(count, -1, 3), torch.zeros_like(self._offsets)
        speed = speed.expand(count, -1, 3)
        if self.frees:
            free = qpos.index_select(1, self._lines)[:, : 3 * self.frees].unflatten(1, (-1, 3))
            place = place.index_copy(1, self._loose, free)
            free = qvel.index_select(1, self._line_dofs)[:, : 3 * self.frees].unflatten(1, (-1, 3))
            speed = speed.index_copy(1, self._loose, free)
        turn, spin, straight = self._rests.expand(count, -1, 4), None, self._rested
        for slot in self._slots:
            if slot.slide is not None:
                axes, none = self._axes[self._hinges :], still[..., 1:]
                along = torch.cat([axes * scalars[:, self._hinges :, None], none], dim=1)
                rate = torch.cat([axes * rates[:, self._hinges :, None], none], dim=1)
                moved = rotations.rotate(turn, along.index_select(1, slot.slide))
                speed = speed + rotations.rotate(turn, rate.index_select(1, slot.slide))
                if spin is not None:
                    speed = speed + torch.linalg.cross(spin, moved)
                place = place + moved
            anchor = slot.anchor
            lever = rotations.rotate(turn, anchor) if anchor is not None else None
            own = turns.index_select(1, slot.joints)
            turn = own if straight else rotations.multiply(turn, own)
            straight = False
            added = rotations.rotate(turn, spins.index_select(1, slot.joints))
            if lever is not None:
                if spin is not None:
                    speed = speed + torch.linalg.cross(spin, lever)
                place = place + lever
            spin = added if spin is None else spin + added
            if anchor is not None:
                back = -rotations.rotate(turn, anchor)
                place, speed = place + back, speed + torch.linalg.cross(spin, back)
        spin = torch.zeros_like(speed) if spin is None else spin
        vectors = torch.stack([place, spin, speed], dim=-1)
        return torch.cat([rotations.to_matrix(turn), vectors], dim=-1), turn

    def worldly(self, local: Tensor) -> Tensor:
        """(B, nbody, 3, 6): as :meth:`locally` (B, nb, 3, 6), from the world; of all bodies."""
        above = local[:, self._levels[0][0]]
        levels = [above]
        for rows, parents in self._levels[1:]:
            parent = above.index_select(1, parents)
            own = parent[..., :3] @ local[:, rows]
            lever = own[..., 3]
            speed = own[..., 5] + torch.linalg.cross(parent[..., 4], lever, dim=-1)
            moved = torch.stack([lever, own[..., 4], speed], dim=-1) + parent[..., 3:]
            above = torch.cat([own[..., :3], moved], dim=-1)
            levels.append(above)
        world = torch.eye(3, 6, device=local.device).expand(len(local), 1, 3, 6)
        return torch.cat([*levels, world], dim=1).index_select(1, self._bodies)

    def turned(self, turns: Tensor) -> Tensor:
        """(B, nbody, 4): the rotations of all bodies, of those from their parents (B, nb, 4)."""
        above = turns[:, self._levels[0][0]]
        levels = [above]
        for rows, parents in self._levels[1:]:
            above = rotations.multiply(above.index_select(1, parents), turns[:, rows])
            levels.append(above)
        world = self._unturned.expand(len(turns), 1, 4)
        return torch.cat([*levels, world], dim=1).index_select(1, self._bodies)

    @property
    def fields(self) -> Mapping[str, Shape]:
        """What :meth:`Posed.field` gives, as the simulator's fields of these names."""
        bodies, geoms, sites = len(self._bodies), len(self._geoms[0]), len(self._sites[0])
        return {
            "qpos": (self.nq,), "qvel": (self.nv,), "xpos": (bodies, 3), "xmat": (bodies, 9),
            "xipos": (bodies, 3), "cvel": (bodies, 6), "subtree_com": (bodies, 3),
            "xquat": (bodies, 4), "geom_xpos": (geoms, 3), "geom_xmat": (geoms, 9),
            "site_xpos": (sites, 3), "site_xmat": (sites, 9),
        }  # fmt: skip

    def touch(self, bodies: Tensor, chosen: Tensor) -> tuple[Tensor, Tensor]:
        """Heights (B, K) m of the lowest of the `chosen` (K,) points' balls, and their velocities
        (B, K, 3) m/s, world; of `bodies` (B, nbody, 3, 6)."""
        of = bodies.index_select(1, self._touch_bodies.index_select(0, chosen))
        lever = (of[..., :3] @ self._touch_points.index_select(0, chosen).unsqueeze(-1)).squeeze(-1)
        radius = self._touch_radii.index_select(0, chosen)
        down = torch.nn.functional.pad(radius.unsqueeze(-1), (2, 0))
        lever = lever - down
        speed = of[..., 5] + torch.linalg.cross(of[..., 4], lever, dim=-1)
        return of[..., 2, 3] + lever[..., 2], speed


class Posed:
    """What MuJoCo computes of B states, when first asked for."""

    def __init__(self, rigid: Rigid, qpos: Tensor, qvel: Tensor) -> None:
        self.rigid, self.qpos, self.qvel = rigid, qpos, qvel

    @cached_property
    def _local(self) -> tuple[Tensor, Tensor]:
        return self.rigid.locally(self.qpos, self.qvel)

    @cached_property
    def bodies(self) -> Tensor:
        """(B, nbody, 3, 6): rotation, position, angular and linear velocity of each body's frame."""
        return self.rigid.worldly(self._local[0])

    @cached_property
    def turn(self) -> Tensor:
        """(B, 3, 3): the root's axes, in columns."""
        return rotations.to_matrix(self.rigid.root(self.qpos))

    def field(self, name: str) -> Tensor:
        """The field of that name of :attr:`Rigid.fields`."""
        if name in ("qpos", "qvel"):
            return self.qpos if name == "qpos" else self.qvel
        rigid, bodies = self.rigid, self.bodies
        if name == "xpos":
            return bodies[..., 3]
        if name == "xmat":
            return bodies[..., :3].flatten(2)
        if name == "xipos":
            return _points(bodies, rigid._centres)
        if name == "xquat":
            return rigid.turned(self._local[1])
        if name in ("geom_xpos", "geom_xmat", "site_xpos", "site_xmat"):
            of, places, turns = rigid._geoms if name.startswith("geom") else rigid._sites
            carriers = bodies.index_select(1, of)
            if name.endswith("xpos"):
                return _points(carriers, places)
            return (carriers[..., :3] @ turns).flatten(2)
        com = rigid._shares @ _points(bodies, rigid._centres)
        if name == "subtree_com":
            return com
        lever = com.index_select(1, rigid._roots) - bodies[..., 3]
        speed = bodies[..., 5] + torch.linalg.cross(bodies[..., 4], lever, dim=-1)
        return torch.cat([bodies[..., 4], speed], dim=-1)


def _points(bodies: Tensor, points: Tensor) -> Tensor:
    """(B, K, 3) m, world: `points` (K, 3) of `bodies` (B, K, 3, 6)."""
    return (bodies[..., :3] @ points.unsqueeze(-1)).squeeze(-1) + bodies[..., 3]
