"""Stretches in the air from which no controller can go on as the clip does.

In flight nothing but gravity acts: whoever begins there, with the clip's own state, flies along a
parabola and keeps its angular momentum, whatever its muscles do. Where that leads away from the clip
by more than a learner's bounds allow, episodes that begin there fail.
"""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from understudy_characters.character import Character
from understudy_doctor.findings import Finding, Places, Severity, intervals
from understudy_doctor.measurements import CONTACT_HEIGHT, Measurements
from understudy_motion.clip import Clip

ASTRAY, TURNED = 0.2, 0.7
"""m along an axis, rad: the bounds on centre of mass and root orientation of Ma et al. 2021."""
FLOATING = 0.75
"""Share of a stretch's frames in which the body hardly falls: then it floats, which is another finding."""
SHORTEST = 0.1
"""s: in a shorter flight nothing gets far; a runner's take about that."""


def check_flights(clip: Clip, measured: Measurements) -> Iterator[Finding]:
    """A finding for each flight with moments from which the clip cannot be continued."""
    high = measured.heights.min(1) - measured.ground > CONTACT_HEIGHT
    least = max(2, round(SHORTEST / measured.dt))
    places = Places(measured.clip)
    for first, last in intervals(high, least=least):
        if measured.supported[first : last + 1].mean() > FLOATING:
            continue
        away, turned = _astray(
            measured.character, measured.effort.qpos[first : last + 1], measured.dt
        )
        bad = np.flatnonzero((away > ASTRAY) | (turned > TURNED))
        if len(bad) == 0:
            continue
        worst, turn = float(away.max()), float(turned.max())
        yield places.finding(
            "flight", Severity.MINOR,
            "whoever begins here in the clip's own state lands up to "
            f"{worst:.2f} m and {turn:.1f} rad beside it, whatever the muscles do",
            (first + int(bad[0]), first + int(bad[-1])), max(worst / ASTRAY, turn / TURNED), "bounds",
            "Let initial states evolve (initial_states=spacetime/evolution), or begin before take-off.",
        )  # fmt: skip


def _astray(character: Character, qpos: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Of each frame of a flight `qpos` (F, nq): how far, m along an axis, and by how many rad about, a
    body that is let go in that frame's state gets from the rest of the flight, at most."""
    model, data = character.model, mujoco.MjData(character.model)
    count, root = len(qpos), character.root
    velocities = np.zeros((count - 1, model.nv))
    for row, before, after in zip(velocities, qpos[:-1], qpos[1:], strict=True):
        mujoco.mj_differentiatePos(model, row, dt, before, after)
    velocities = np.concatenate([velocities[:1], 0.5 * (velocities[1:] + velocities[:-1]), velocities[-1:]])  # fmt: skip
    places, speeds, spins = np.zeros((3, count, 3))
    inverses = np.zeros((count, 3, 3))
    bodies = sorted(character.carrier)
    for frame in range(count):
        data.qpos[:], data.qvel[:] = qpos[frame], velocities[frame]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_subtreeVel(model, data)
        places[frame], speeds[frame] = data.subtree_com[root], data.subtree_linvel[root]
        spins[frame] = data.subtree_angmom[root]
        inverses[frame] = np.linalg.inv(_inertia(model, data, bodies, places[frame]))
    gravity = np.asarray(model.opt.gravity)
    away, turned = np.zeros(count), np.zeros(count)
    for frame in range(count):
        time = dt * np.arange(count - frame)[:, None]
        free = places[frame] + speeds[frame] * time + 0.5 * gravity * time**2
        away[frame] = np.abs(free - places[frame:]).max()
        rates = np.einsum("fij,fj->fi", inverses[frame:], spins[frame] - spins[frame:])
        turned[frame] = np.linalg.norm(np.cumsum(rates * dt, axis=0), axis=1).max()
    return away, turned


def _inertia(
    model: mujoco.MjModel, data: mujoco.MjData, bodies: list[int], centre: np.ndarray
) -> np.ndarray:
    """(3, 3) kg m² of `bodies` as one, about `centre`, along world axes."""
    total = np.zeros((3, 3))
    for body in bodies:
        axes = data.ximat[body].reshape(3, 3)
        arm = data.xipos[body] - centre
        total += (axes * model.body_inertia[body]) @ axes.T
        total += model.body_mass[body] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return total
