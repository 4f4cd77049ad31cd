"""Forces that hold a tool still, and joint targets that make them.

A pose alone holds nothing: targets must reach into the tool, by as much as the contacts are to bear.
Contact forces that balance the tool inside friction cones follow from a bounded least squares; by the
hinges' gains they become offsets of targets. N, m, rad.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.optimize import lsq_linear

from understudy_gripping.holding import holding
from understudy_gripping.styles import Style
from understudy_hand.scene import HandScene

#: Of the cones; less than the sticks' friction, so that something is left for movement.
FRICTION = 0.6
#: Edges by which a cone is approximated.
_EDGES = 8
#: How strongly forces are drawn to those that are wanted, and m of a lever as which torques count.
_DRAWN, _LEVER = 0.03, 0.05
_NEAR = 0.1


@dataclass(frozen=True)
class Balance:
    """Where the servos aim so that the grip holds, and with what forces."""

    targets: np.ndarray  #: (U,) rad, of all servos, the arm's too
    forces: dict[str, float]  #: N, along the normal, by link
    error: float  #: N, or N m over 5 cm: the largest that is left on the tool


def contacts(style: Style, scene: HandScene) -> dict[str, int]:
    """By link that shall touch: the tool's part, 1 the upper one."""
    fingers, supports = scene.measures.names, holding(scene.options.tool).supports
    tips = {f"{f}_distal": part for f, part in zip(fingers, style, strict=True) if part}
    return tips | {name: part for name, (part, _) in supports.items() if name in scene.links}


def balance(
    scene: HandScene, data: mujoco.MjData, style: Style, wanted: float = 3.0, least: float = 1.0
) -> Balance:
    """Targets that hold the tool in the pose of `data`, which is computed forward.

    *Limits:* statics of this one pose; friction cones are pyramids, and what cannot be
    balanced is left as the error.

    Parameters
    ----------
    wanted
        N, that each contact bears if nothing speaks for more or less.
    least
        N, that each bears in any case.
    """
    model = scene.model
    touching = contacts(style, scene)
    places, rows = np.zeros(6), []
    jacobian, torques = np.zeros((3, model.nv)), []
    parts = [model.body(name).id for name in scene.tool_bodies]
    # Of the tool's degrees of freedom: those that move it, by N, and those that turn it, by N at a lever.
    own = np.flatnonzero(np.isin(model.dof_bodyid, parts))
    turns = model.jnt_type[model.dof_jntid[own]] == mujoco.mjtJoint.mjJNT_HINGE
    turns |= own - model.jnt_dofadr[model.dof_jntid[own]] >= 3
    scale = np.where(turns, 1.0 / _LEVER, 1.0)
    for name, part in touching.items():
        geom, body = model.geom(name).id, parts[part - 1]
        other = model.geom(scene.tool_bodies[part - 1]).id
        mujoco.mj_geomDistance(model, data, geom, other, _NEAR, places)
        middle = 0.5 * (places[:3] + places[3:])
        normal = places[3:] - places[:3]  # from the finger into the tool
        normal /= np.linalg.norm(normal)
        mujoco.mj_jac(model, data, jacobian, None, middle, model.geom_bodyid[geom])
        on_finger = jacobian.copy()
        mujoco.mj_jac(model, data, jacobian, None, middle, body)
        for edge in _cone(normal):
            rows.append(scale * (jacobian.T @ edge)[own])
            torques.append(on_finger.T @ edge)
    columns = np.array(rows).T
    # What the tool weighs, and what its spring pushes with.
    weight = scale * (data.qfrc_bias - data.qfrc_passive)[own]
    drawn = np.full(columns.shape[1], wanted / _EDGES)
    solved = lsq_linear(
        np.vstack([columns, _DRAWN * np.eye(columns.shape[1])]),
        np.concatenate([weight, _DRAWN * drawn]),
        (least / _EDGES, np.inf),
    )
    error = np.abs(columns @ solved.x - weight).max()
    servos, most = model.nu, holding(scene.options.tool).most
    gains = model.actuator_gainprm[:, 0]
    offsets = (np.array(torques).T @ solved.x)[:servos] / gains
    targets = data.qpos[:servos] + np.clip(offsets, -most, most)
    along = solved.x.reshape(-1, _EDGES).sum(1)
    return Balance(targets, dict(zip(touching, map(float, along), strict=True)), float(error))


def _cone(normal: np.ndarray) -> np.ndarray:
    """(edges, 3), each with a normal part of 1."""
    across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    across /= np.linalg.norm(across)
    other = np.cross(normal, across)
    angles = np.arange(_EDGES) * 2.0 * np.pi / _EDGES
    return normal + FRICTION * (np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * other)
