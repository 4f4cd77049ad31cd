"""How many contacts and constraint rows to hold for each world: the most that a model can make."""

from __future__ import annotations

import mujoco
import numpy as np


def contact_capacity(model: mujoco.MjModel) -> int:
    """The most contacts that geoms of `model` can make with planes, plus room for others.

    A plane touches a sphere in 1 point, a capsule in 2, anything else in at most 4. Pairs of other
    geoms that may collide get one contact each, up to 64: they cannot all touch at once.
    """
    points = {int(mujoco.mjtGeom.mjGEOM_SPHERE): 1, int(mujoco.mjtGeom.mjGEOM_CAPSULE): 2}
    plane = int(mujoco.mjtGeom.mjGEOM_PLANE)
    with_planes = others = 0
    for a in range(model.ngeom):
        for b in range(a + 1, model.ngeom):
            if model.body_weldid[model.geom_bodyid[a]] == model.body_weldid[model.geom_bodyid[b]]:
                continue
            if not (
                model.geom_contype[a] & model.geom_conaffinity[b]
                or model.geom_contype[b] & model.geom_conaffinity[a]
            ):
                continue
            types = (int(model.geom_type[a]), int(model.geom_type[b]))
            if plane in types:
                with_planes += points.get(max(types), 4)
            else:
                others += 1
    # Of predefined pairs, whatever their masks say.
    for a, b in zip(model.pair_geom1, model.pair_geom2, strict=True):
        types = (int(model.geom_type[a]), int(model.geom_type[b]))
        with_planes += points.get(max(types), 4) if plane in types else 1
    return max(1, with_planes + min(others, 64))


def constraint_capacity(model: mujoco.MjModel, contacts: int) -> int:
    """The most rows that `contacts` of `model` make, with limits, friction losses and equalities.

    A contact of d dimensions has d rows in an elliptic cone, and 2 (d - 1) edges of a pyramid, or 1
    without friction.
    """
    dimensions = max(1, *model.geom_condim.tolist(), *model.pair_dim.tolist())
    rows = dimensions
    if model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL:
        rows = max(1, 2 * (dimensions - 1))
    limits = int(model.jnt_limited.sum()) + 2 * int(model.tendon_limited.sum())
    losses = np.count_nonzero(model.dof_frictionloss) + np.count_nonzero(model.tendon_frictionloss)
    equalities = 6 * model.neq  # a weld's; no other has more
    return rows * contacts + limits + int(losses) + equalities  # Warp takes no number of numpy's
