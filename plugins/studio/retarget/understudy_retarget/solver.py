"""Inverse kinematics of all frames at once: damped least squares within the hinges' ranges.

Levenberg-Marquardt (Nocedal and Wright, "Numerical Optimization", 2006, section 10.3), each frame
with its own damping; a hinge at a limit that its gradient presses against is held there (projected
Newton, Bertsekas 1982). The normal matrix is found without the Jacobian: weighted points are point
masses, so it is the joint-space inertia matrix, which the composite-rigid-body algorithm gives
(Featherstone, "Rigid Body Dynamics Algorithms", 2008, chapter 6).

Frames do not see one another: what is smooth in the goals and in the first guess is smooth in the
solution.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.records.runs import cores
from understudy_characters.kinematics import Kinematics, Poses
from understudy_tensors import rotations

CHUNK = 512
"""Frames solved together: few enough for a processor's cache, enough to hide Python's cost."""

MAX_ITERATIONS = 60
CLOSE = 1e-3
"""rad and m: a step shorter than that is the last one. Convergence is quadratic where the goals can be met,
linear where they cannot."""

LARGEST_STEP = 0.5
"""rad and m per degree of freedom."""

_FIRST_DAMPING, _MOST_DAMPING = 1e-4, 1e2
_LEAST_DAMPING = 1e-12
"""Of what no goal asks for, more than rounding takes away from it."""


@dataclass(frozen=True)
class PointGoals:
    """Where P points are wanted."""

    joints: Tensor  #: (P,) the joint that carries the point
    offsets: Tensor  #: (P, 3) m, in the joint's frame
    goals: Tensor  #: (F, P, 3) m, world
    weights: Tensor  #: (P,)


@dataclass(frozen=True)
class RotationGoals:
    """Which rotations M joints are to have."""

    joints: Tensor  #: (M,)
    goals: Tensor  #: (F, M, 4), world
    weights: Tensor  #: (M,) m/rad: how much of a point's error a turn is worth


def solve(kinematics: Kinematics, qpos: Tensor, points: PointGoals, turns: RotationGoals) -> Tensor:
    """``qpos`` (F, nq) that comes nearest to the goals, found from the guess ``qpos`` (F, nq).

    *Limits:* each frame for itself, and to a local minimum near its guess. Limbs may pass
    through the body and the floor.
    """
    problem = _Problem(kinematics, points, turns)
    chunks = torch.arange(len(qpos)).split(CHUNK)
    workers = min(len(chunks), cores())
    # A thread for each chunk: operations this small lose more by being split than they gain.
    with ThreadPoolExecutor(workers, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        return torch.cat(list(pool.map(lambda frames: problem.solve(qpos[frames], frames), chunks)))


class _Problem:
    def __init__(self, kinematics: Kinematics, points: PointGoals, turns: RotationGoals) -> None:
        self._kinematics, self._points, self._turns = kinematics, points, turns
        hangs_on = kinematics.hangs_on
        masses, stiffness = points.weights.square(), turns.weights.square()
        # Of the tree that hangs on each joint: (J, P) and (J, M) what belongs to it, and sums.
        self._carried = hangs_on[points.joints].T * masses
        self._turned = hangs_on[turns.joints].T * stiffness
        owners = torch.cat((torch.zeros(3, dtype=torch.long), kinematics.owners))
        self._owners = owners
        self._mass = self._carried.sum(1)[owners, None]
        self._stiffness = self._turned.sum(1)[owners, None]
        # (D, D): the row's joint hangs on the column's, or is it
        below = hangs_on[owners][:, owners]
        self._below = below.to(torch.float64)
        self._strictly_below = (below & ~below.T).to(torch.float64)

    def solve(self, qpos: Tensor, frames: Tensor) -> Tensor:
        """The solution of some `frames` (F,), from the guess ``qpos`` (F, nq)."""
        kinematics = self._kinematics
        result = kinematics.within_ranges(qpos)
        damping = torch.full((len(qpos),), _FIRST_DAMPING, dtype=torch.float64)
        active = torch.arange(len(qpos))
        poses = kinematics.forward(result)
        place, turn, cost = self._errors(poses, frames)
        for _ in range(MAX_ITERATIONS):
            step = self._step(result[active], poses, place, turn, damping[active])
            tried = kinematics.moved(result[active], poses, step)
            there = kinematics.forward(tried)
            place_there, turn_there, cost_there = self._errors(there, frames[active])
            better = cost_there <= cost
            result[active[better]] = tried[better]
            damping[active] *= torch.where(better, 0.3, 8.0)
            damping.clamp_(min=_LEAST_DAMPING)
            unfinished = step.abs().amax(-1) > CLOSE
            unfinished = torch.where(better, unfinished, damping[active] < _MOST_DAMPING)
            if not unfinished.any():
                break

            stayed = ~better[unfinished]
            going_on = (*vars(poses).values(), place, turn, cost)
            reached = (*vars(there).values(), place_there, turn_there, cost_there)
            kept = [value[unfinished] for value in reached]
            for value, old in zip(kept, going_on, strict=True):
                value[stayed] = old[unfinished][stayed]
            poses, (place, turn, cost) = Poses(*kept[:4]), kept[4:]
            active = active[unfinished]
        return result

    def _errors(self, poses: Poses, frames: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Goals minus what is, (F, P, 3) m and (F, M, 3) rad, and the cost (F,)."""
        points, turns = self._points, self._turns
        place = points.goals[frames] - self._places(poses)
        is_turned = rotations.conjugate(poses.rotations[:, turns.joints])
        turn = rotations.to_exponential_map(rotations.multiply(turns.goals[frames], is_turned))
        cost = place.square().sum(-1) @ points.weights.square()
        return place, turn, cost + turn.square().sum(-1) @ turns.weights.square()

    def _places(self, poses: Poses) -> Tensor:
        joints = self._points.joints
        turned = rotations.rotate(poses.rotations[:, joints], self._points.offsets)
        return poses.positions[:, joints] + turned

    def _step(
        self, qpos: Tensor, poses: Poses, place: Tensor, turn: Tensor, damping: Tensor
    ) -> Tensor:
        root = poses.positions[:, :1]
        points = self._places(poses) - root
        axes, linear = self._motions(poses)
        # Moments of the weighted points below each degree of freedom, about the root.
        first = (self._carried @ points)[:, self._owners]
        products = (points[..., :, None] * points[..., None, :]).flatten(2)
        second = (self._carried @ products).unflatten(2, (3, 3))
        trace = second.diagonal(dim1=2, dim2=3).sum(-1)[..., None, None]
        inertia = trace * torch.eye(3, dtype=torch.float64) - second
        about = (inertia[:, self._owners] @ axes[..., None])[..., 0]
        torque = about + torch.linalg.cross(first, linear) + self._stiffness * axes
        force = self._mass * linear + torch.linalg.cross(axes, first)
        motions = torch.cat((axes, linear), dim=2)
        products = torch.cat((torque, force), dim=2) @ motions.transpose(1, 2)
        normal = products * self._below
        normal += (products * self._strictly_below).transpose(1, 2)

        pull = self._carried @ place
        wrench = self._carried @ torch.linalg.cross(points, place) + self._turned @ turn
        wrench = torch.cat((wrench, pull), dim=2)[:, self._owners]
        gradient = (motions * wrench).sum(-1)
        free = self._free(qpos, gradient)
        normal *= free[:, :, None] * free[:, None, :]
        normal.diagonal(dim1=1, dim2=2).add_(damping[:, None] + (1.0 - free))
        factor = torch.linalg.cholesky(normal)
        step = torch.cholesky_solve((free * gradient)[..., None], factor)[..., 0]
        return step.clamp(-LARGEST_STEP, LARGEST_STEP)

    def _motions(self, poses: Poses) -> tuple[Tensor, Tensor]:
        """Of each degree of freedom the angular velocity and that of the point at the root, (F, D, 3)."""
        arms = poses.positions[:, :1] - poses.pivots
        linear = torch.linalg.cross(poses.axes, arms)
        along = torch.eye(3, dtype=torch.float64).expand(len(arms), 3, 3)
        return (
            torch.cat((torch.zeros_like(along), poses.axes), dim=1),
            torch.cat((along, linear), dim=1),
        )

    def _free(self, qpos: Tensor, gradient: Tensor) -> Tensor:
        """(F, D): 0 for hinges that are at a limit and pressed against it, else 1."""
        kinematics = self._kinematics
        angles, push = qpos[:, kinematics.hinge_addresses], gradient[:, kinematics.hinge_columns]
        low, high = kinematics.hinge_ranges.unbind(-1)
        held = ((angles <= low) & (push < 0.0)) | ((angles >= high) & (push > 0.0))
        free = torch.ones_like(gradient)
        free[:, kinematics.hinge_columns] = (~held).to(gradient.dtype)
        return free
