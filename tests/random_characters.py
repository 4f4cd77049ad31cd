"""Random characters in random poses."""

from __future__ import annotations

import mujoco
import numpy as np
import torch
from scipy.spatial.transform import Rotation

SHAPES = ("sphere", "capsule", "cylinder", "box", "ellipsoid")


def random_model(seed: int, apart: float = 0.0) -> mujoco.MjModel:
    """A tree of eight bodies, anyhow oriented: balls, welds, and one to three hinges at an anchor, or up
    to `apart` m from it along each axis."""
    rng = np.random.default_rng(seed)
    spec = mujoco.MjSpec()
    bodies = [spec.worldbody.add_body(name="trunk", pos=[0, 0, 2], quat=_unit(rng, 4))]
    bodies[0].add_freejoint()
    bodies[0].add_geom(size=[0.1, 0, 0])
    for index in range(8):
        parent = bodies[rng.integers(len(bodies))]
        body = parent.add_body(name=f"b{index}", pos=rng.uniform(-0.3, 0.3, 3), quat=_unit(rng, 4))
        body.add_geom(
            type=getattr(mujoco.mjtGeom, f"mjGEOM_{rng.choice(SHAPES).upper()}"),
            size=rng.uniform(0.02, 0.15, 3), pos=rng.uniform(-0.2, 0.2, 3), quat=_unit(rng, 4),
        )  # fmt: skip
        kind, anchor = rng.integers(5), rng.uniform(-0.2, 0.2, 3)
        if kind == 4:
            body.add_joint(type=mujoco.mjtJoint.mjJNT_BALL, pos=anchor)
        frame = Rotation.from_quat(_unit(rng, 4)).as_matrix()
        for axis in frame[: kind % 4]:
            place = anchor + (rng.uniform(-apart, apart, 3) if apart else 0.0)
            hinge = body.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, pos=place, axis=axis)
            if rng.random() < 0.5:
                low = rng.uniform(-3.0, 0.0)
                hinge.limited, hinge.range = True, [low, low + rng.uniform(0.2, 3.0)]
        bodies.append(body)
    spec.compiler.degree = False
    return spec.compile()


def _unit(rng: np.random.Generator, size: int) -> np.ndarray:
    vector = rng.normal(size=size)
    return vector / np.linalg.norm(vector)


def random_poses(model: mujoco.MjModel, seed: int, count: int = 5) -> torch.Tensor:
    rng = np.random.default_rng(seed)
    qpos = np.tile(model.qpos0, (count, 1))
    for joint in range(model.njnt):
        address, kind = model.jnt_qposadr[joint], model.jnt_type[joint]
        if kind == mujoco.mjtJoint.mjJNT_HINGE:
            limits = model.jnt_range[joint] if model.jnt_limited[joint] else (-3.0, 3.0)
            qpos[:, address] = rng.uniform(*limits, count)
            continue
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            qpos[:, address : address + 3] = rng.uniform(-2, 2, (count, 3))
            address += 3
        quaternions = rng.normal(size=(count, 4))
        qpos[:, address : address + 4] = quaternions / np.linalg.norm(quaternions, axis=1)[:, None]
    return torch.from_numpy(qpos)
