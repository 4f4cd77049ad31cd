"""An articulated figure: an MJCF model, seen as a tree of rotating joints on a free root.

A :class:`Clip` of a character has one joint for each body that can move against its parent, named
after the body. In the *zero pose* (``qpos0``) every joint's frame is parallel to the root's, so all
rotations are then the identity; offsets are those of the zero pose. Several hinges of one body are
one joint, at the place of the first one. A body without joints belongs to the body that it is welded to.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from shlex import quote
from typing import Any

import mujoco
import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from understudy.errors import ConfigError, FileError, suggestion
from understudy.setup.registry import Registry
from understudy.task import Context
from understudy_characters.angle_units import check_radians
from understudy_characters.joint import Joint
from understudy_motion.clip import Clip, Skeleton, angle_names, sample
from understudy_motion.limits import MAX_JOINTS
from understudy_mujoco.scene import MjcfFile
from understudy_tensors import rotations

__all__ = ["Character", "character_spec", "load_character"]

_FREE, _BALL, _SLIDE, _HINGE = (
    int(mujoco.mjtJoint.mjJNT_FREE),
    int(mujoco.mjtJoint.mjJNT_BALL),
    int(mujoco.mjtJoint.mjJNT_SLIDE),
    int(mujoco.mjtJoint.mjJNT_HINGE),
)
_LARGEST = 100.0
"""m that a figure's joints are apart at most."""
#: Of names that can only be those of a model's file, in lower case.
_SUFFIXES = (".xml", ".mjcf", ".urdf")


def load_character(named: str, registry: Registry) -> Character:
    """The registered character of this name, or the one of this MJCF file.

    Raises
    ------
    ConfigError
        no such name; or the model is no character (see :class:`Character`).
    FileError
        the file does not load.
    """
    name, spec = character_spec(named, registry)
    try:
        return Character(name, spec.compile(), named)
    except (ValueError, mujoco.FatalError) as error:
        reason = str(error).strip().splitlines()[0]
        raise FileError(f"The model {named} does not compile: {reason}") from error


def character_spec(
    named: str, registry: Registry, context: Context | None = None
) -> tuple[str, mujoco.MjSpec]:
    """Name and model specification of the registered character, or of this MJCF file, which is read
    through the `context` of the task that it is for.

    Raises
    ------
    ConfigError
        no such name.
    FileError
        the file does not load.
    """
    if named in registry.names("character"):
        return named, registry.find("character", named).call()
    known = registry.names("character")
    # A kept model's own file may be gone: it is told from a misspelt name by its spelling then.
    path = Path(named)
    if (
        path.is_file()
        or path.suffix.lower() in _SUFFIXES
        or (context and f"mjcf {path}" in context.inputs.kept)
    ):
        file = MjcfFile(MjcfFile.Options(named), context)
        spec = file.spec()
        _free_root(spec, path.stem)
        if not file.attaches:  # whose angles may be in units of their own
            _warn_of_angles(spec, path.stem)
        _warn_of_servos(spec, path.stem)
        return path.stem, spec
    raise ConfigError(
        f"There is no character '{named}'.{suggestion(named, known)} Or give the path of an MJCF or "
        "URDF file."
    )


def _warn_of_angles(spec: mujoco.MjSpec, name: str) -> None:
    """Warn if the ranges of hinges look like the other unit of angles: MJCF's default is degrees."""
    ends = sorted(
        float(np.abs(joint.range).max())
        for joint in spec.joints
        if joint.type == mujoco.mjtJoint.mjJNT_HINGE and np.any(joint.range)
    )
    if len(ends) < 2:
        return
    if spec.compiler.degree and ends[-1] <= 2.0 * math.pi:
        warnings.warn(
            f"Model '{name}' lets none of its hinges turn by more than {ends[-1]:.3g} degrees. If its ranges are in radians, "
            'it must say <compiler angle="radian"/>.',
            stacklevel=2,
        )
    elif not spec.compiler.degree and ends[len(ends) // 2] > 4.0 * math.pi:
        warnings.warn(
            f"Model '{name}' lets most of its hinges turn by {ends[len(ends) // 2]:.3g} radians, so by any number of turns. "
            'If its ranges are in degrees, take <compiler angle="radian"/> out.',
            stacklevel=2,
        )


def _warn_of_servos(spec: mujoco.MjSpec, name: str) -> None:
    """Warn if the targets of position servos of hinges look like degrees: a ``ctrlrange`` is in radians, whatever
    ``<compiler angle>`` says."""
    hinges = {joint.name for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_HINGE}
    ends = sorted(
        float(np.abs(servo.ctrlrange).max() / abs(servo.gear[0] or 1.0))
        for servo in spec.actuators
        if servo.target in hinges
        and servo.trntype == mujoco.mjtTrn.mjTRN_JOINT
        and servo.biastype == mujoco.mjtBias.mjBIAS_AFFINE
        and servo.biasprm[1] < 0  # pulled to a target, and not merely damped
        and servo.ctrllimited != mujoco.mjtLimited.mjLIMITED_FALSE
        and np.any(servo.ctrlrange)
    )
    if ends and (middle := ends[len(ends) // 2]) > 4.0 * math.pi:
        warnings.warn(
            f"Model '{name}' lets most of its servos' targets be {middle:.3g} radians from zero. If these are degrees, write each "
            f"ctrlrange in radians, as {math.radians(middle):.3g}: <compiler angle> does not change it.",
            stacklevel=2,
        )


def _free_root(spec: mujoco.MjSpec, name: str) -> None:
    """Give a freejoint to a model that has none and whose only jointed tree stands on a body without joints."""
    trees = [
        body
        for body in spec.worldbody.bodies
        if body.joints or body.find_all(mujoco.mjtObj.mjOBJ_JOINT)
    ]
    if any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in spec.joints):
        return
    if len(trees) != 1 or trees[0].joints:
        return
    root = trees[0]
    for key in spec.keys:  # whose poses are of the joints that there were
        if len(key.qpos):
            key.qpos = [*root.pos, *root.quat, *key.qpos]
        if len(key.qvel):
            key.qvel = [*np.zeros(6), *key.qvel]
    root.add_freejoint()
    warnings.warn(
        f"Model '{name}' has no freejoint, so its root {root.name or 'body'} stood fixed in the world; here it is free.",
        stacklevel=2,
    )


class Character:
    """A model with a free root, whose other bodies hang on ball joints or on up to three hinges.

    F frames, J joints (the root first, parents before children), nq as in MuJoCo. Of several free bodies, the root is
    the first one with the most joints below it; the others are things.

    Hinges of one body at different points also move it a little. ``qpos`` and all that is computed from
    it have that; a clip, whose joints only turn, has not.

    Raises
    ------
    ConfigError
        gravity that is not along -z, no free root, more joints than a clip may have, joints more than 100 m apart, a root without joints, a slide joint, a ball beside hinges, more than
        three hinges of one body, or one with a reference angle.
    """

    def __init__(self, name: str, model: mujoco.MjModel, named: str | None = None) -> None:
        #: ``named`` is what commands take for it: a registered name, or the path of its file.
        self.name, self.model, self.named = name, model, named or name
        self.data = mujoco.MjData(model)
        free = [j for j in range(model.njnt) if model.jnt_type[j] == _FREE]
        if not free:
            raise ConfigError(
                f"Model '{name}' is no character: none of its bodies has a freejoint. Give it to the "
                "one that carries all others."
            )
        x, y, z = model.opt.gravity
        if z > 0.0 or math.hypot(x, y) > 0.01 * abs(z):
            raise ConfigError(
                f"Model '{name}' stands in another frame: its gravity is ({x:g}, {y:g}, {z:g}) m/s², and here z is up. "
                "Turn the model, and let gravity be along -z."
            )
        carried = np.bincount(model.body_rootid[model.jnt_bodyid], minlength=model.nbody)
        root = max(free, key=lambda j: carried[model.jnt_bodyid[j]])
        self.root = int(model.jnt_bodyid[root])
        self.root_address = int(model.jnt_qposadr[root])
        moving = int(((model.body_rootid == self.root) & (model.body_jntnum > 0)).sum())
        if moving > MAX_JOINTS:
            raise ConfigError(
                f"Model '{name}' is no character: {moving} of its bodies move, and a clip has at most {MAX_JOINTS} joints. "
                "Take out the joints of those that need not move."
            )
        self.joints = tuple(self._joints())
        self.joint_names = tuple(joint.name for joint in self.joints)
        self._at_rest()
        size = float(np.ptp(self.rest_positions, axis=0).max())
        if size > _LARGEST:
            raise ConfigError(
                f"Model '{name}' is no character: its joints are up to {size:.4g} m apart. Lengths of a model are metres; "
                "if its unit is the millimetre, divide all of them by 1000."
            )

    def _joints(self) -> list[Joint]:
        model = self.model
        found = [
            Joint(self._body_name(self.root), self.root, -1, (self.root_address,),
                  np.zeros((0, 3)), np.zeros((0, 2)), np.zeros((0, 3)))
        ]  # fmt: skip
        row = {self.root: 0}  # of each body of the figure, the joint that carries it
        for body in range(self.root + 1, model.nbody):
            parent = int(model.body_parentid[body])
            if parent not in row:
                continue
            first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
            if count == 0:
                row[body] = row[parent]
                continue
            ids = list(range(first, first + count))
            types = {int(model.jnt_type[j]) for j in ids}
            place = f"Model '{self.name}' is no character: body '{self._body_name(body)}' has"
            if slide := next((j for j in ids if model.jnt_type[j] == _SLIDE), 0):  # 0 is the root
                raise ConfigError(
                    f"{place} the joint '{model.joint(slide).name}', along which it slides, and a clip's joints only "
                    "turn. Take the joint out of the model, so that the body stays where it is; in a URDF, make "
                    'it type="fixed".'
                )
            if types not in ({_BALL}, {_HINGE}) or (types == {_BALL} and count > 1):
                raise ConfigError(f"{place} joints other than one ball or some hinges.")
            if count > 3:
                raise ConfigError(
                    f"{place} more than three hinges; split them among several bodies."
                )
            hinge = types == {_HINGE}
            if hinge and model.qpos0[model.jnt_qposadr[ids]].any():
                raise ConfigError(
                    f"{place} a hinge whose reference angle (ref) is not 0. Let ref be 0, and turn the body so in the model."
                )
            limited = np.array([bool(model.jnt_limited[j]) for j in ids])
            found.append(
                Joint(
                    self._body_name(body),
                    body,
                    row[parent],
                    tuple(int(model.jnt_qposadr[j]) for j in ids),
                    model.jnt_axis[ids].copy() if hinge else np.zeros((0, 3)),
                    np.where(limited[:, None], model.jnt_range[ids], [-np.inf, np.inf])
                    if hinge
                    else np.zeros((0, 2)),
                    model.jnt_pos[ids] - model.jnt_pos[first] if hinge else np.zeros((0, 3)),
                )
            )
            row[body] = len(found) - 1
        #: By body id of the figure: the row of the joint that carries it.
        self.carrier = row
        return found

    @cached_property
    def company(self) -> dict[str, int]:
        """What else moves on joints in the model, such as another robot: by its first body, how many joints it has."""
        model, found = self.model, dict[str, int]()
        for joint in range(model.njnt):
            first = int(model.body_rootid[model.jnt_bodyid[joint]])
            if model.jnt_type[joint] != _FREE and first != model.body_rootid[self.root]:
                found[self._body_name(first)] = found.get(self._body_name(first), 0) + 1
        return found

    def _body_name(self, body: int) -> str:
        return self.model.body(body).name or _free(f"body{body}", self._names_of_bodies)

    @cached_property
    def _names_of_bodies(self) -> frozenset[str]:
        return frozenset(self.model.body(body).name for body in range(self.model.nbody))

    def _at_rest(self) -> None:
        """Find where the joints are in the zero pose, in the root's frame."""
        model, data = self.model, self.data
        data.qpos[:] = model.qpos0
        mujoco.mj_kinematics(model, data)
        root = data.xmat[self.root].reshape(3, 3)
        bodies = [joint.body for joint in self.joints]
        anchors = np.array(
            [np.zeros(3)] + [model.jnt_pos[model.body_jntadr[b]] for b in bodies[1:]]
        )
        matrices = data.xmat[bodies].reshape(-1, 3, 3)
        #: (J, 3) m: joint origins in the zero pose, in the root's frame.
        world = data.xpos[bodies] + np.einsum("jab,jb->ja", matrices, anchors)
        self.rest_positions = (world - data.xpos[self.root]) @ root
        #: (J,) rotations of the bodies in the zero pose, in the root's frame.
        self.rest_rotations = Rotation.from_matrix(root.T @ matrices)
        parents = np.array([joint.parent for joint in self.joints])
        offsets = self.rest_positions - self.rest_positions[parents]
        offsets[0] = 0.0
        self.skeleton = Skeleton(
            self.joint_names, tuple(int(p) for p in parents), offsets, self._tips(parents)
        )
        self._anchors = anchors

    def _tips(self, parents: np.ndarray) -> dict[str, np.ndarray]:
        """For joints without children: the farthest point of what they carry, along its main axis."""
        tips = {}
        for row, joint in enumerate(self.joints):
            if row in parents:
                continue
            centres = [
                g.centre - self.rest_positions[row] for g in self.geoms if g.joint == row
            ] + [
                self._in_root(self.data.xpos[body]) - self.rest_positions[row]
                for body, carrier in self.carrier.items()
                if carrier == row and body != joint.body
            ]
            if centres:
                tips[joint.name] = max(centres, key=lambda c: float(np.linalg.norm(c)))
        return tips

    def _in_root(self, point: np.ndarray) -> np.ndarray:
        root = self.data.xmat[self.root].reshape(3, 3)
        return (point - self.data.xpos[self.root]) @ root

    @property
    def zero_pose(self) -> mujoco.MjData:
        """The model's data in the zero pose."""
        data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, data)
        return data

    @cached_property
    def length(self) -> float:
        """m: the figure's size in the zero pose, between the surfaces, or joints of which nothing collides, that are
        farthest apart."""
        geoms = [(g.centre, self.model.geom_rbound[g.id]) for g in self.geoms]
        geoms += [(place, 0.0) for place in self.rest_positions]
        return max(
            (float(np.linalg.norm(a - b)) + r + s for a, r in geoms for b, s in geoms), default=1.0
        )

    @cached_property
    def shown(self) -> tuple[Geom, ...]:
        """All geoms of the figure, in the zero pose."""
        model, data = self.model, mujoco.MjData(self.model)
        mujoco.mj_kinematics(model, data)
        bodies = [int(body) for body in model.geom_bodyid]
        return tuple(
            Geom(geom, self.carrier[body], self._in_root(data.geom_xpos[geom]))
            for geom, body in enumerate(bodies)
            if body in self.carrier
        )

    @cached_property
    def geoms(self) -> tuple[Geom, ...]:
        """The geoms that collide, by their masks; if none does, those that are named in a pair, or else all."""
        model = self.model
        paired = {*model.pair_geom1.tolist(), *model.pair_geom2.tolist()}
        colliding = tuple(
            g for g in self.shown if model.geom_contype[g.id] or model.geom_conaffinity[g.id]
        )
        return colliding or tuple(g for g in self.shown if g.id in paired) or self.shown

    # ------------------------------------------------------------------ clip and qpos

    def qpos(self, clip: Clip, times: Tensor | None = None) -> Tensor:
        """``qpos`` (F, nq) float64 of `clip` at `times` (F,) s (at its own frames if None), mapped by
        joint name. A rotation that a joint's hinges cannot make becomes the nearest one that they can.

        Raises
        ------
        FileError
            the clip lacks a joint of the character.
        """
        clip = self.posed(clip)
        if times is None:
            position, rotation = clip.root_position, clip.rotations
        else:
            position, rotation = sample(clip, times)
        result = torch.tensor(self.model.qpos0, dtype=torch.float64).repeat(len(position), 1)
        at = self.root_address
        for row, joint in enumerate(self.joints):
            if row == 0:  # whatever a clip calls its root
                result[:, at : at + 3], result[:, at + 3 : at + 7] = position, rotation[:, 0]
                continue
            if joint.name not in clip.joint_names:
                raise FileError(
                    f"Clip {clip.source} has no joint '{joint.name}', which {self.name} needs."
                    f"{suggestion(joint.name, clip.joint_names)} A clip of another skeleton is "
                    f"retargeted first: {self.retargeting(clip)}."
                )
            rest, local = self._rests[row], rotation[:, clip.joint_names.index(joint.name)]
            turned = local + 0.0  # so that no zero is negative, as of a product
            if rest is not None:
                turned = rotations.multiply(
                    rotations.multiply(rotations.conjugate(rest), local), rest
                )
            if len(joint.axes) == 0:
                start = joint.addresses[0]
                result[:, start : start + 4] = turned
            else:
                result[:, list(joint.addresses)] = joint.angles(turned)
        return result

    def retargeting(self, clip: Clip) -> str:
        """The command that makes `clip` fit."""
        source = clip.source if Path(clip.source).is_file() else clip.name
        return f"understudy motion retarget {quote(source)} {quote(self.named)} OUT.npz"

    @cached_property
    def hinges(self) -> dict[str, int]:
        """By name, in the model's order: the ``qpos`` address of each hinge of the figure."""
        own = {
            address for joint in self.joints[1:] if len(joint.axes) for address in joint.addresses
        }
        ids = [j for j in range(self.model.njnt) if int(self.model.jnt_qposadr[j]) in own]
        names = {self.model.joint(j).name for j in range(self.model.njnt)}
        return {
            self.model.joint(j).name or _free(f"joint{j}", names): int(self.model.jnt_qposadr[j])
            for j in ids
        }

    def posed(self, clip: Clip) -> Clip:
        """`clip` itself; or, if it has a robot's angles instead of joints (:mod:`understudy_motion.readers.angles`), the
        clip of this character with these angles.

        Raises
        ------
        FileError
            the angles are not those of the character's hinges, or may be in degrees as well as in radians.
        """
        names = angle_names(clip)
        if names is None:
            return clip
        addresses = _addresses(names, self.hinges)
        if addresses is None:
            raise FileError(
                f"Clip {clip.source} has {len(names)} angles of a robot, and {self.name} has "
                f"{len(self.hinges)} hinges{'' if names[0] == '1' else ', or others'}: give the robot's own "
                f"model. Its hinges are {', '.join(self.hinges) or 'none'}."
            )
        qpos = torch.tensor(self.model.qpos0, dtype=torch.float64).repeat(clip.num_frames, 1)
        at = self.root_address
        qpos[:, at : at + 3], qpos[:, at + 3 : at + 7] = clip.root_position, clip.rotations[:, 0]
        axis = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)
        turned = rotations.twist_angle(clip.rotations[:, 1:], axis).numpy()
        angles = np.unwrap(turned, axis=0)
        if clip.assumed:
            check_radians(self.name, self.model, self.clearance, clip, qpos, addresses, angles)
        qpos[:, addresses] = torch.from_numpy(angles)
        about = {
            key: getattr(clip, key) for key in ("source", "licence", "sha256", "url", "attribution")
        }
        return self.clip(qpos, clip.times, name=clip.name, loop=clip.loop, **about)

    def clip(
        self, qpos: Tensor, times: Tensor, *, name: str, loop: bool = False, **about: Any
    ) -> Clip:
        """The clip of ``qpos`` (F, nq) at `times` (F,) s; `about` holds source, licence, sha256."""
        qpos = qpos.to(torch.float64).cpu()
        at = self.root_address
        found = [rotations.normalize(qpos[:, at + 3 : at + 7])]
        for row, joint in enumerate(self.joints[1:], 1):
            if len(joint.axes) == 0:
                start = joint.addresses[0]
                turned = rotations.normalize(qpos[:, start : start + 4])
            else:
                turned = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
                for axis, address in zip(joint.axes, joint.addresses, strict=True):
                    hinge = rotations.from_axis_angle(torch.from_numpy(axis), qpos[:, address])
                    turned = rotations.multiply(turned, hinge)
            rest = self._rests[row]
            found.append(
                turned.expand(len(qpos), 4) + 0.0
                if rest is None
                else rotations.multiply(rotations.multiply(rest, turned), rotations.conjugate(rest))
            )
        return Clip(
            name=name,
            times=times,
            root_position=qpos[:, at : at + 3],
            rotations=torch.stack(found, dim=1),
            joint_names=self.joint_names,
            loop=loop,
            skeleton=self.skeleton,
            **about,
        )

    @cached_property
    def _rests(self) -> list[Tensor | None]:
        """For each joint its row of :attr:`rest_rotations`; None if that is the identity."""
        found = torch.from_numpy(self.rest_rotations.as_quat(scalar_first=True))
        still = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
        return [None if torch.equal(rest, still) else rest for rest in found]

    # ------------------------------------------------------------------ geometry

    def clearance(self, qpos: Tensor) -> Tensor:
        """(F, J) m: the height above z = 0 of the lowest point of what each joint carries; infinite if it carries nothing."""
        ids = [geom.id for geom in self.geoms]
        model, data = self.model, self.data
        places, axes = np.empty((len(qpos), model.ngeom, 3)), np.empty((len(qpos), model.ngeom, 9))
        pose, place, turn = data.qpos, data.geom_xpos, data.geom_xmat
        for frame, row in enumerate(qpos.numpy()):
            pose[:] = row
            mujoco.mj_kinematics(model, data)
            places[frame], axes[frame] = place, turn
        heights, matrices = places[:, ids, 2], axes[:, ids, 6:]
        lowest = np.full((len(qpos), len(self.joints)), np.inf)
        for column, geom in enumerate(self.geoms):
            below = heights[:, column] - self._reach(geom.id, matrices[:, column])
            lowest[:, geom.joint] = np.minimum(lowest[:, geom.joint], below)
        return torch.from_numpy(lowest)

    def _reach(self, geom: int, up: np.ndarray) -> np.ndarray:
        """How far geom `geom` reaches down from its centre; `up` (F, 3) is the world's z in its frame."""
        kind, size = int(self.model.geom_type[geom]), self.model.geom_size[geom]
        along, across = np.abs(up[:, 2]), np.sqrt(np.clip(1.0 - up[:, 2] ** 2, 0.0, None))
        types = mujoco.mjtGeom
        if kind == types.mjGEOM_SPHERE:
            return np.full(len(up), size[0])
        if kind == types.mjGEOM_CAPSULE:
            return size[0] + size[1] * along
        if kind == types.mjGEOM_CYLINDER:
            return size[1] * along + size[0] * across
        if kind == types.mjGEOM_BOX:
            return np.abs(up) @ size
        if kind == types.mjGEOM_ELLIPSOID:
            return np.sqrt((up**2) @ (size**2))
        if kind == types.mjGEOM_MESH:
            return -(up @ self.mesh(geom)[0].T).min(axis=1)
        return np.zeros(len(up))

    def mesh(self, geom: int) -> tuple[np.ndarray, np.ndarray]:
        """Vertices (V, 3) m in the geom's frame, and faces (T, 3), of a mesh geom."""
        model, mesh = self.model, int(self.model.geom_dataid[geom])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        start, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
        return (
            model.mesh_vert[first : first + count].astype(float),
            model.mesh_face[start : start + faces],
        )


def _free(name: str, taken: Collection[str]) -> str:
    """`name`, or a longer one that is not `taken`."""
    while name in taken:
        name += "_"
    return name


_AFFIXES = re.compile(r"[\W_]*(?:joint|dof|pos(?:ition)?|angle|q)$")
"""What programs put behind a hinge's name."""
_NUMBERED = re.compile(r"(.*?)([0-9]+)")


def _addresses(names: Sequence[str], hinges: Mapping[str, int]) -> list[int] | None:
    """The ``qpos`` addresses of hinges that a table calls so: by their names, else by these without capitals, signs,
    a namespace and what programs put behind them, else, of names that count the hinges, in their order; None if they
    are not these `hinges`."""
    if set(names) == set(hinges):
        return [hinges[name] for name in names]
    if len(names) != len(hinges):
        return None
    plain = {_plain(name): address for name, address in hinges.items()}
    if len(plain) == len(names) and {_plain(name) for name in names} == set(plain):
        return [plain[_plain(name)] for name in names]
    counted = [found.groups() for found in map(_NUMBERED.fullmatch, names) if found]
    if len(counted) == len(names) and len({stem for stem, _ in counted}) == 1:
        numbers = [int(number) for _, number in counted]
        if numbers[0] in (0, 1) and numbers == list(range(numbers[0], numbers[0] + len(numbers))):
            return list(hinges.values())
    return None


def _plain(name: str) -> str:
    word = re.split("[/:]", name)[-1].casefold()
    while _AFFIXES.search(word) and (less := _AFFIXES.sub("", word)):
        word = less
    return re.sub(r"[\W_]", "", word)


@dataclass(frozen=True)
class Geom:
    """A geom of the figure: its id, the row of the joint that carries it, and its centre (3,) m in
    the zero pose, in the root's frame."""

    id: int
    joint: int
    centre: np.ndarray
