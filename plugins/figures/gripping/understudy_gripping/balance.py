"""Forces that hold a tool still, and joint targets that make them.

A pose alone holds nothing: targets must reach into the sticks, by as much as the contacts are to bear.
Contact forces that balance the sticks inside friction cones follow from a bounded least squares; by the
hinges' gains they become offsets of targets. N, m, rad.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.optimize import lsq_linear

from understudy_gripping.pose import SUPPORTS
from understudy_gripping.styles import Style
from understudy_hand.scene import HandScene

#: Of the cones; less than the sticks' friction, so that something is left for movement.
FRICTION = 0.6
#: Edges by which a cone is approximated.
_EDGES = 8
#: How strongly forces are drawn to those that are wanted, and m of a lever as which torques count.
_DRAWN, _LEVER = 0.03, 0.05
#: rad: how far a target may be from the pose.
_MOST = 0.6
_NEAR = 0.1


@dataclass(frozen=True)
class Balance:
    """Where the servos aim so that the grip holds, and with what forces."""

    targets: np.ndarray  #: (U,) rad, of all servos, the arm's too
    forces: dict[str, float]  #: N, along the normal, by link
    error: float  #: N, or N m over 5 cm: the largest that is left on a stick


def contacts(style: Style, scene: HandScene) -> dict[str, int]:
    """By link that shall touch: the stick, 1 the upper one."""
    fingers = scene.measures.names
    tips = {f"{f}_distal": stick for f, stick in zip(fingers, style, strict=True) if stick}
    return tips | {name: stick for name, (stick, _) in SUPPORTS.items() if name in scene.links}


def balance(
    scene: HandScene, data: mujoco.MjData, style: Style, wanted: float = 3.0, least: float = 1.0
) -> Balance:
    """Targets that hold the sticks in the pose of `data`, which is computed forward.

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
    sticks = [model.body(name).id for name in scene.tool_bodies]
    for name, stick in touching.items():
        geom, body = model.geom(name).id, sticks[stick - 1]
        other = model.geom(scene.tool_bodies[stick - 1]).id
        mujoco.mj_geomDistance(model, data, geom, other, _NEAR, places)
        middle = 0.5 * (places[:3] + places[3:])
        normal = places[3:] - places[:3]  # from the finger into the stick
        normal /= np.linalg.norm(normal)
        mujoco.mj_jac(model, data, jacobian, None, middle, model.geom_bodyid[geom])
        for edge in _cone(normal):
            wrench = np.zeros((2, 6))
            wrench[stick - 1] = [*edge, *np.cross(middle - data.xpos[body], edge) / _LEVER]
            rows.append(wrench.ravel())
            torques.append(jacobian.T @ edge)
    columns = np.array(rows).T
    weight = np.zeros((2, 6))
    weight[:, 2] = -model.opt.gravity[2] * model.body_mass[sticks]
    drawn = np.full(columns.shape[1], wanted / _EDGES)
    solved = lsq_linear(
        np.vstack([columns, _DRAWN * np.eye(columns.shape[1])]),
        np.concatenate([weight.ravel(), _DRAWN * drawn]),
        (least / _EDGES, np.inf),
    )
    error = np.abs(columns @ solved.x - weight.ravel()).max()
    servos = model.nu
    gains = model.actuator_gainprm[:, 0]
    offsets = (np.array(torques).T @ solved.x)[:servos] / gains
    targets = data.qpos[:servos] + np.clip(offsets, -_MOST, _MOST)
    along = solved.x.reshape(-1, _EDGES).sum(1)
    return Balance(targets, dict(zip(touching, map(float, along), strict=True)), float(error))


def _cone(normal: np.ndarray) -> np.ndarray:
    """(edges, 3), each with a normal part of 1."""
    across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    across /= np.linalg.norm(across)
    other = np.cross(normal, across)
    angles = np.arange(_EDGES) * 2.0 * np.pi / _EDGES
    return normal + FRICTION * (np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * other)
