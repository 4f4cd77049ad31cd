"""What a motion asks of a character's muscles and of the ground: inverse dynamics.

The accelerations of a captured motion are mostly noise above some frequency, so motions are low-pass
filtered first, as in gait analysis. The ground pushes at the points in contact, within friction, and
takes as much of what the root needs as it can; the rest is what nothing explains.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np
import torch
from scipy.optimize import nnls

from understudy_characters.character import Character
from understudy_motion.clip import Clip
from understudy_motion.editing import smooth

CUTOFF = 8.0
"""Hz. Winter (2009, ch. 3) filters walking at 6 Hz and running at up to 10."""
FRICTION = 1.0
"""Of the feet on the floor."""

LEVER = 0.3
"""m: a moment of a weight at this lever counts as much as a force of a weight. About a foot's length:
what the centre of pressure can do."""

_EDGES = 4  # of the pyramid that stands in for the friction cone
_EVEN_SPREAD = 1e-4  # weight of small forces against an exact explanation


@dataclass(frozen=True)
class Effort:
    """What a motion asks for, per frame, before the ground's share."""

    forces: np.ndarray  #: (F, nv) N and N m, in MuJoCo's generalised coordinates
    lift: np.ndarray  #: (F,) upward force that the centre of mass needs, in weights
    weight: float  #: N
    axes: np.ndarray  #: (F, nv, 6) what each coordinate turns and moves, MuJoCo's ``cdof`` …
    origin: np.ndarray  #: (F, 3) m, world: … about this point


def effort(character: Character, clip: Clip) -> Effort:
    """Inverse dynamics of `clip`, which has the character's joints and evenly spaced frames."""
    model = character.model
    calm = smooth(clip, CUTOFF)
    h = clip.duration / (clip.num_frames - 1)
    qpos = character.qpos(calm).numpy()
    before, after = qpos[:-1], qpos[1:]
    if clip.loop:  # one more step on either side, across the seam
        around = character.qpos(calm, calm.times[[0, -1]] + torch.tensor([-h, h])).numpy()
        before = np.concatenate([around[:1], qpos])
        after = np.concatenate([qpos, around[1:]])
    steps = np.zeros((len(before), model.nv))
    for row, first, second in zip(steps, before, after, strict=True):
        mujoco.mj_differentiatePos(model, row, h, first, second)
    if not clip.loop:
        steps = np.concatenate([steps[:1], steps, steps[-1:]])
    qvel, qacc = 0.5 * (steps[1:] + steps[:-1]), np.diff(steps, axis=0) / h
    if not clip.loop and len(qacc) > 2:
        qacc[0], qacc[-1] = qacc[1], qacc[-2]  # of the ends nothing is known
    data = mujoco.MjData(model)
    flags = model.opt.disableflags
    model.opt.disableflags = flags | int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    tree = int(model.body_rootid[character.root])
    forces, axes = np.zeros((len(qpos), model.nv)), np.zeros((len(qpos), model.nv, 6))
    origin = np.zeros((len(qpos), 3))
    place, speed, change = data.qpos, data.qvel, data.qacc
    needed, turning, middle = data.qfrc_inverse, data.cdof, data.subtree_com[tree]
    try:
        for frame in range(len(qpos)):
            place[:], speed[:], change[:] = qpos[frame], qvel[frame], qacc[frame]
            mujoco.mj_inverse(model, data)
            forces[frame], axes[frame], origin[frame] = needed, turning, middle
    finally:
        model.opt.disableflags = flags
    weight = float(model.body_subtreemass[character.root]) * float(
        np.linalg.norm(model.opt.gravity)
    )
    at = int(model.body_dofadr[character.root])
    return Effort(forces, forces[:, at + 2] / weight, weight, axes, origin)


@dataclass(frozen=True)
class Support:
    """How the ground carries a motion, and what is left for the muscles."""

    unexplained: np.ndarray  #: (F,) in weights: what acts on the root though nothing can push there
    torque: np.ndarray  #: (F, J) N m: of each joint's axes, the one nearest to its limit
    share: np.ndarray  #: (F, J) of the limit of that axis; NaN where there is none


def support(
    character: Character,
    asked: Effort,
    owners: np.ndarray,
    points: np.ndarray,
    bearing: np.ndarray,
) -> Support:
    """Share the root's wrench out over the points in contact, and find the joints' torques.

    The forces are the least ones (nearly) that explain the wrench, each within the friction pyramid,
    by non-negative least squares; moments count by the lever :data:`LEVER`.

    Parameters
    ----------
    character
        F frames of it were asked for.
    asked
        what they need.
    owners
        (P,) rows of the joints that carry the points.
    points
        (F, P, 3) m, world.
    bearing
        (F, P) bool, the points in contact.
    """
    at = int(character.model.body_dofadr[character.root])
    root = slice(at, at + 6)
    scale = np.repeat([1.0, 1.0 / LEVER], 3) / asked.weight
    edges = asked.weight * _pyramid()
    forces = asked.forces.copy()
    frames, rows = np.nonzero(bearing)
    arms = points[frames, rows] - asked.origin[frames]
    # (C, 6, 3), of C points in contact
    turns, moves = np.split(asked.axes[frames, root], 2, axis=2)
    # (C, 6, edges), a weight along each
    pushes = (moves + np.cross(turns, arms[:, None])) @ edges.T
    shares = np.zeros((len(frames), len(edges)))
    ends = np.searchsorted(frames, np.arange(len(forces) + 1))
    for frame in np.unique(frames):
        here = slice(ends[frame], ends[frame + 1])
        columns = (pushes[here] * scale[:, None]).swapaxes(0, 1).reshape(6, -1)
        count = columns.shape[1]
        system = np.vstack([columns, _EVEN_SPREAD * np.eye(count)])
        wanted = np.concatenate([forces[frame, root] * scale, np.zeros(count)])
        shares[here] = nnls(system, wanted)[0].reshape(-1, len(edges))
    # By joint, all forces as one at the origin; each coordinate feels those of the joints beyond it.
    pushed = shares @ edges
    total = np.zeros((len(forces), len(character.joints), 6))
    np.add.at(total, (frames, owners[rows]), np.hstack([np.cross(arms, pushed), pushed]))
    felt = np.einsum("fjk,jd->fdk", total, _beyond(character))
    forces -= (asked.axes * felt).sum(2)
    unexplained = np.linalg.norm(forces[:, root] * scale, axis=1)
    return Support(unexplained, *_torques(character, forces))


def _beyond(character: Character) -> np.ndarray:
    """(J, nv): 1 where a joint hangs on a coordinate, itself included."""
    model = character.model
    result = np.zeros((len(character.joints), model.nv))
    for row, joint in enumerate(character.joints):
        dof = int(model.body_dofadr[joint.body] + model.body_dofnum[joint.body]) - 1
        while dof >= 0:
            result[row, dof] = 1.0
            dof = int(model.dof_parentid[dof])
    return result


def _pyramid() -> np.ndarray:
    """(E, 3): the edges of the friction pyramid, a unit upward each."""
    angles = np.arange(_EDGES) * (2.0 * math.pi / _EDGES)
    sides = FRICTION * np.column_stack([np.cos(angles), np.sin(angles)])
    return np.column_stack([sides, np.ones(_EDGES)])


def _torques(character: Character, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of the generalised `forces` (F, nv): torques (F, J) and their share of the limits."""
    model = character.model
    limits = _limits(model)
    torque = np.zeros((len(forces), len(character.joints)))
    share = np.full(torque.shape, np.nan)
    for row, joint in enumerate(character.joints[1:], 1):
        first, count = int(model.body_dofadr[joint.body]), int(model.body_dofnum[joint.body])
        own = np.abs(forces[:, first : first + count])
        ratio = own / limits[first : first + count]
        worst = ratio.argmax(1) if np.isfinite(limits[first]) else own.argmax(1)
        torque[:, row] = own[np.arange(len(own)), worst]
        if np.isfinite(limits[first : first + count]).all():
            share[:, row] = ratio.max(1)
    return torque, share


def _limits(model: mujoco.MjModel) -> np.ndarray:
    """(nv,) N m: the most that the actuators can do about each axis; infinite where none is limited."""
    limits = np.zeros(model.nv)
    for actuator in range(model.nu):
        if model.actuator_trntype[actuator] != mujoco.mjtTrn.mjTRN_JOINT:
            continue
        joint = int(model.actuator_trnid[actuator, 0])
        first = int(model.jnt_dofadr[joint])
        count = 3 if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_BALL else 1
        limited = bool(model.actuator_forcelimited[actuator])
        most = np.abs(model.actuator_forcerange[actuator]).max() if limited else np.inf
        gear = np.abs(model.actuator_gear[actuator, :count])
        limits[first : first + count] += np.where(gear > 0, gear * most, 0.0)
    return np.where(limits > 0, limits, np.inf)
