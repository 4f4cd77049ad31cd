"""Holding a grip in simulation, before any training: what slips, and how deep fingers are in the tool."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import mujoco
import numpy as np

from understudy_hand.scene import HandScene
from understudy_hand.table import can_meet

__all__ = ["hold", "nearest_fingers", "placed"]

#: m: a part that is so far from where it was in the palm has fallen.
FALLEN = 0.03
#: m: farther apart is not told.
_NEAR = 0.05


@dataclass(frozen=True)
class Held:
    """P parts of a tool: two sticks, or tongs' two bars, the upper one first; one of a brush."""

    fell: float | None  #: s, when a part fell; None if none did
    drift: (
        np.ndarray
    )  #: (P,) m, of the parts in the palm's frame from `settle` to the end, or until one fell
    turn: np.ndarray  #: (P,) rad, of their axes
    depth: float  #: m: the deepest penetration of the tool after `settle`
    qpos: np.ndarray  #: (nq,) at the end
    links: frozenset[str]  #: that touched the tool at the end


def placed(
    scene: HandScene, arm: np.ndarray, pose: np.ndarray, upper: np.ndarray, lower: np.ndarray
) -> mujoco.MjData:
    """The scene with the arm at `arm` (7,) rad, the hand at `pose` (H,) rad, and the tool's parts (7,) where they
    are given in the palm's frame; computed forward. A tool of one part is where the lower one is."""
    model, data = scene.model, mujoco.MjData(scene.model)
    data.qpos[: model.nu] = [*arm, *pose]
    mujoco.mj_kinematics(model, data)
    palm, free = data.body("palm"), {model.joint(j).name for j in range(model.njnt)}
    for name, local in zip(reversed(scene.tool_bodies), (lower, upper), strict=False):
        if name not in free:  # it hangs on the other by a hinge
            turn = np.zeros(3)
            mujoco.mju_subQuat(turn, np.asarray(upper[3:], float), np.asarray(lower[3:], float))
            data.joint("opening").qpos = -turn[2]
            continue
        qpos = data.joint(name).qpos
        mujoco.mju_rotVecQuat(qpos[:3], np.asarray(local[:3], float), palm.xquat)
        qpos[:3] += palm.xpos
        mujoco.mju_mulQuat(qpos[3:], palm.xquat, np.asarray(local[3:], float))
    mujoco.mj_forward(model, data)
    return data


def hold(
    scene: HandScene,
    data: mujoco.MjData,
    targets: np.ndarray,
    seconds: float = 1.0,
    settle: float = 0.5,
) -> Held:
    """Simulate `data` for `seconds` under fixed `targets` (U,) rad. `data` is changed."""
    model = scene.model
    data.ctrl[:] = targets
    sticks = np.array([model.geom(name).id for name in scene.tool_bodies])
    palm, parts = model.body("palm").id, [model.body(name).id for name in scene.tool_bodies]
    now = first = _relative(data, palm, parts)
    since, depth, fell = None, 0.0, None
    while data.time < seconds:
        mujoco.mj_step(model, data)
        now = _relative(data, palm, parts)
        if since is None and data.time >= settle:
            since = now
        if since is not None and data.ncon:
            on = (data.contact.geom[:, :, None] == sticks).any(axis=(1, 2))
            depth = max(depth, -float(data.contact.dist[on].min(initial=0.0)))
        if not (np.linalg.norm(now[0] - first[0], axis=1) < FALLEN).all():  # NaN too
            fell = data.time
            break
    since = first if since is None else since
    turned = np.clip((now[1] * since[1]).sum(1), -1.0, 1.0)
    pairs = data.contact.geom[: data.ncon]
    touching = {int(g) for pair in pairs if np.isin(pair, sticks).any() for g in pair} - {*sticks}
    return Held(
        fell,
        np.linalg.norm(now[0] - since[0], axis=1),
        np.arccos(turned),
        depth,
        data.qpos.copy(),
        frozenset(model.geom(g).name for g in touching),
    )


def nearest_fingers(scene: HandScene, data: mujoco.MjData) -> tuple[float, tuple[str, str]]:
    """m, negative inside, and which: how near the two nearest links of different fingers are in `data`; infinite where none
    can meet."""
    model, nearest = scene.model, (np.inf, ("", ""))
    shown = [name for name in scene.links if model.body(name).geomnum[0]]
    for one, other in combinations(shown, 2):
        if can_meet(one, other):
            geoms = model.geom(one).id, model.geom(other).id
            nearest = min(
                nearest, (mujoco.mj_geomDistance(model, data, *geoms, _NEAR, None), (one, other))
            )
    return nearest


def _relative(data: mujoco.MjData, palm: int, parts: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Middles (P, 3) m and axes (P, 3) of the bodies `parts` in the frame of the body `palm`."""
    turn = data.xmat[palm].reshape(3, 3)
    axes = data.xmat[parts].reshape(-1, 3, 3)[:, :, 0]
    return (data.xpos[parts] - data.xpos[palm]) @ turn, axes @ turn
