"""Inverse kinematics of a figure that holds a tool (section 4.4, eq. 13 and 14).

Each frame solves

    min ‖q' − q‖  with  x_tool(q') = x̂_tool,  r_tool(q') = r̂_tool,  C_joint(q') ≥ 0

from the frame before, q. mink does it: a quadratic program a step, whose equality constraint is the tool's
pose and whose inequalities are the joints' ranges. `retarget`'s solver, which takes all frames at once,
weighs goals against one another and moves the root; here the pose has to be met exactly, from a figure
that stands, without its arm passing through the table.

Beside the paper's constraints there are two that keep the motion continuous and the arm out of things: no
joint turns faster than `speed` from one frame to the next, and the geoms `apart` do not touch.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import mink
import mujoco
import numpy as np

from understudy.options import check_range

#: Steps of a frame; those of the first one, which begins anywhere; and those that end both, exactly at the
#: tool though perhaps a little off eq. 13.
STEPS, FIRST_STEPS, LAST_STEPS = 15, 80, 5
#: m and rad: nearer to the tool's pose a frame is solved.
CLOSE = 1e-6
#: rad a step of any joint: no farther is the tool's pose nearly linear in the joints.
STRIDE = 0.3
#: m: what is nearer than that could touch after such a step.
DETECTED = 0.3
#: m a step by which what is nearer than the clearance parts.
AWAY = 5e-4
#: How firmly the tool is drawn to where it should be while it cannot be there: 1/m and 1/rad, against 1/rad
#: of the joints. A radian counts as 0.2 m.
PULL, TURN = 300.0, 60.0
#: What a turn of a joint then costs, of what it costs else.
LESS = 0.03
#: Beginnings that are tried where the first frame cannot be reached from the figure's own, and how far off
#: they are, rad.
TRIES, ASTRAY = 12, 0.7


@dataclass(frozen=True)
class Options:
    """How the joints follow."""

    speed: float = 10.0  #: rad/s, greatest speed of any joint from frame to frame
    #: What a turn of a joint costs in eq. 13: the same for all, or as much as the mass that it moves (root of
    #: its share), so that the arm moves rather than the trunk.
    cost: Literal["equal", "mass"] = "mass"
    #: s, in which joints that need not move return to where they were at first; 0 is eq. 13 alone.
    relax: float = 2.0
    clearance: float = 0.005  #: m, least distance between what is to stay apart

    def __post_init__(self) -> None:
        check_range(self, "speed", above=0)
        check_range(self, "relax", "clearance", least=0)


@dataclass(frozen=True)
class Motion:
    """T frames."""

    qpos: np.ndarray  #: (T, nq)
    position_error: np.ndarray  #: (T,) m, from the tool's place
    orientation_error: np.ndarray  #: (T,) rad, from the tool's orientation


def follow(
    model: mujoco.MjModel,
    body: str,
    positions: np.ndarray,
    orientations: np.ndarray,
    *,
    dt: float,
    start: np.ndarray,
    still: Sequence[int],
    apart: Sequence[tuple[Sequence[int], Sequence[int]]] = (),
    options: Options = Options(),
) -> Motion:
    """The motion whose `body` is at `positions` (T, 3) m with `orientations` (T, 4), every `dt` s.

    *Limits:* frame after frame, each from the one before, so that a joint at its range may
    lead to where later frames cannot be met.

    Parameters
    ----------
    start
        (nq,) the pose before the first frame, in which every joint is within its range.
    still
        degrees of freedom that do not move.
    apart
        pairs of groups of geoms that do not touch.

    Frames that cannot be met are as near as they can be; the errors say how near.
    """
    solver = _Solver(model, body, start, still, apart, options)
    targets = [
        mink.SE3.from_rotation_and_translation(mink.SO3(turn / np.linalg.norm(turn)), place)
        for place, turn in zip(positions, orientations, strict=True)
    ]
    poses, errors = [], []
    for frame, target in enumerate(targets):
        if frame == 0:
            solver.begin(target)
        else:
            solver.advance(target, dt)
        poses.append(solver.qpos)
        errors.append(solver.error(target))
    place, turn = np.array(errors).T
    return Motion(np.array(poses), place, turn)


class _Apart(mink.Limit):
    """Geoms keep `clearance` m apart: mink's limit of that kind, measured once a step for all tries, of all pairs at once."""

    def __init__(
        self,
        model: mujoco.MjModel,
        apart: Sequence[tuple[Sequence[int], Sequence[int]]],
        clearance: float,
    ) -> None:
        groups = [(list(group), list(others)) for group, others in apart]
        #: (K, 2) geoms: without those of one body or of a body and its parent, which always touch
        self.pairs = mink.CollisionAvoidanceLimit(model, groups).geom_id_pairs
        self._model, self._clearance = model, clearance
        moves = np.zeros((model.nbody, model.nv), bool)
        for body in range(1, model.nbody):
            first = model.body_dofadr[body]
            moves[body] = moves[model.body_parentid[body]]
            moves[body, first : first + model.body_dofnum[body]] = True
        bodies = model.geom_bodyid[np.array(self.pairs, int).reshape(-1, 2)]
        #: (K, 2, nv) which degrees of freedom move the geoms, and (K, 2) the first bodies of their trees
        self._moves, self._roots = moves[bodies], model.body_rootid[bodies]
        #: m a step by which what is nearer than the clearance parts
        self.away = 0.0
        self._towards, self._room = np.zeros((0, model.nv)), np.zeros(0)

    def measure(self, data: mujoco.MjData) -> None:
        """Where the geoms are now."""
        near, ends, far = [], [], []
        between = np.empty(6)
        for number, (one, other) in enumerate(self.pairs):
            away = mujoco.mj_geomDistance(self._model, data, one, other, DETECTED, between)
            if away < DETECTED - 1e-12:
                near.append(number)
                far.append(away)
                ends.append(between.copy())
        points, distances = np.array(ends).reshape(-1, 2, 3), np.array(far)
        normal = points[:, 1] - points[:, 0]
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        normal = np.where(length < 1e-15, (1.0, 0.0, 0.0), normal / np.maximum(length, 1e-15))
        # a point moves by v + ω × r of each degree of freedom, r from its tree's centre of mass
        arms = points - data.subtree_com[self._roots[near]]
        turn, move = data.cdof[:, :3].T, data.cdof[:, 3:].T
        along = normal[:, None] @ move + np.cross(arms, normal[:, None]) @ turn
        along = np.where(self._moves[near], along, 0.0)
        parting = np.where(distances >= 0, 1.0, -1.0)[:, None] * (along[:, 1] - along[:, 0])
        self._towards, self._room = -parting, 0.5 * np.maximum(distances - self._clearance, 0.0)

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        return mink.Constraint(self._towards, self._room / dt - self.away)


class _Bounds(mink.Limit):
    """Every degree of freedom stays within `most` rad of the pose `around`."""

    def __init__(self, model: mujoco.MjModel, around: np.ndarray, most: float) -> None:
        self._model, self._around, self._most = model, around, most

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        away = np.empty(self._model.nv)
        mujoco.mj_differentiatePos(self._model, away, 1.0, self._around, configuration.q)
        each = np.eye(self._model.nv)
        room = np.concatenate([self._most - away, self._most + away])
        return mink.Constraint(np.concatenate([each, -each]), np.maximum(room, 0.0))


def _carrying(model: mujoco.MjModel, body: str) -> np.ndarray:
    """The degrees of freedom that move the body and have mass to move."""
    chain = [model.body(body).id]
    while chain[-1]:
        chain.append(int(model.body_parentid[chain[-1]]))
    moved = model.body_subtreemass[model.dof_bodyid] > 0
    return np.flatnonzero(np.isin(model.dof_bodyid, chain) & moved)


class _Solver:
    def __init__(
        self,
        model: mujoco.MjModel,
        body: str,
        start: np.ndarray,
        still: Sequence[int],
        apart: Sequence[tuple[Sequence[int], Sequence[int]]],
        options: Options,
    ) -> None:
        self._model, self._body = model, body
        self._start, self._options = start.copy(), options
        self._configuration = mink.Configuration(model, start)
        self._hold = mink.FrameTask(body, "body", PULL, TURN, lm_damping=0.01)
        self._fixed = list(still)
        self._still = mink.DofFreezingTask(model, dof_indices=self._fixed)
        self._avoid = _Apart(model, apart, options.clearance)
        self._limits = [mink.ConfigurationLimit(model, gain=1.0), self._avoid]
        #: (nv,) what a turn of each degree of freedom costs in eq. 13
        self._cost = np.ones(model.nv)
        if options.cost == "mass":
            moved = model.body_subtreemass[model.dof_bodyid]
            least = moved[_carrying(model, body)].min(initial=moved.max())
            self._cost = np.sqrt(np.maximum(moved, least) / least)
        #: what draws to the poses of one step, by their order and weights: making it takes as long as its use
        self._drawing: dict[tuple[int, float, float], mink.PostureTask] = {}
        hinges = (model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE) & (model.jnt_limited == 1)
        self._hinges, self._ranges = model.jnt_qposadr[hinges], model.jnt_range[hinges].T

    @property
    def qpos(self) -> np.ndarray:
        return self._configuration.q.copy()

    def error(self, target: mink.SE3) -> tuple[float, float]:
        """m and rad from the tool's pose."""
        here = self._configuration.get_transform_frame_to_world(self._body, "body")
        turned = (here.rotation().inverse() @ target.rotation()).log()
        away = here.translation() - target.translation()
        return float(np.linalg.norm(away)), float(np.linalg.norm(turned))

    def begin(self, target: mink.SE3) -> None:
        """The first pose: from the start, or else from where chance leads."""
        generator = np.random.default_rng(0)
        found: list[tuple[float, float, np.ndarray]] = []
        for attempt in range(TRIES):
            guess = self._start.copy()
            if attempt:
                away = ASTRAY * generator.standard_normal(self._model.nv)
                away[self._fixed] = 0.0
                mujoco.mj_integratePos(self._model, guess, away, 1.0)
                guess = self._inside(guess)
            self._configuration.update(guess)
            if attempt and self._touching():  # which no step would mend
                continue
            for _ in range(FIRST_STEPS):
                if self._step(target, [(self._start, 1.0)]) < CLOSE:
                    break
            self._settle(target)
            place, turn = self.error(target)
            away = np.empty(self._model.nv)
            mujoco.mj_differentiatePos(self._model, away, 1.0, self._start, self._configuration.q)
            missed = PULL * place + TURN * turn if max(place, turn) > 1e-4 else 0.0
            found.append((missed, float(np.linalg.norm(away)), self.qpos))
            if missed == 0.0:
                break
        self._configuration.update(min(found, key=lambda f: f[:2])[2])

    def _touching(self) -> bool:
        data = self._configuration.data
        return any(
            mujoco.mj_geomDistance(self._model, data, a, b, 0.1, np.zeros(6)) < 0.0
            for a, b in self._avoid.pairs
        )

    def advance(self, target: mink.SE3, dt: float) -> None:
        """The next pose, `dt` s later."""
        before, relax = self.qpos, self._options.relax
        near = [(before, 1.0)]
        if relax:
            near.append((self._start, float(np.sqrt(dt / relax))))
        around = _Bounds(self._model, before, self._options.speed * dt)
        for _ in range(STEPS):
            if self._step(target, near, around) < CLOSE and max(self.error(target)) < CLOSE:
                return
        self._settle(target, around)

    def _settle(self, target: mink.SE3, *around: _Bounds) -> None:
        """Go to the nearest pose from here."""
        for _ in range(LAST_STEPS):
            if max(self.error(target)) < CLOSE:
                return
            self._step(target, [(self.qpos, 1.0)], *around)

    def _step(
        self, target: mink.SE3, near: Sequence[tuple[np.ndarray, float]], *around: _Bounds
    ) -> float:
        """One quadratic program; returns the greatest turn, rad."""
        self._hold.set_target(target)
        self._avoid.measure(self._configuration.data)
        limits = [*self._limits, *around, _Bounds(self._model, self.qpos, STRIDE)]
        drawn = [*self._postures(near, LESS), self._hold]
        step = np.zeros(self._model.nv)
        # Eq. 14; where that has no solution so near, as near as can be, and at last without parting.
        for tasks, constraints, away in (
            (self._postures(near), [self._hold, self._still], AWAY),
            (drawn, [self._still], AWAY),
            (drawn, [self._still], 0.0),
        ):
            self._avoid.away = away
            with contextlib.suppress(mink.NoSolutionFound):
                step = mink.solve_ik(
                    self._configuration,
                    tasks,
                    1.0,
                    "daqp",
                    limits=limits,
                    constraints=constraints,
                )
                break
        self._configuration.integrate_inplace(step, 1.0)
        self._configuration.update(self._inside(self.qpos))  # which rounding may have left
        return float(np.abs(step).max())

    def _inside(self, qpos: np.ndarray) -> np.ndarray:
        """``qpos`` (nq,) with hinges beyond their ranges at the ends of these."""
        result = qpos.copy()
        result[self._hinges] = np.clip(result[self._hinges], *self._ranges)
        return result

    def _postures(
        self, near: Sequence[tuple[np.ndarray, float]], share: float = 1.0
    ) -> list[mink.Task]:
        """What draws the joints to the poses `near`, each with its weight."""
        tasks: list[mink.Task] = []
        for number, (pose, weight) in enumerate(near):
            key = number, share, weight
            if key not in self._drawing:
                self._drawing[key] = mink.PostureTask(self._model, share * weight * self._cost)
            self._drawing[key].set_target(pose)
            tasks.append(self._drawing[key])
        return tasks
