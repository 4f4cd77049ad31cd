"""A model written otherwise: the same bodies, hinges and geoms, with another zero pose, other frames, another size."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

_SHAPES = {2: "sphere", 3: "capsule", 6: "box"}


def remodelled(
    text: str,
    zero: Mapping[str, float] | None = None,
    frames: Mapping[str, Rotation] | None = None,
    rename: Callable[[str], str] = str,
    size: float = 1.0,
    bare: Iterable[str] = (),
    geoms: str = "",
) -> str:
    """The MJCF `text` of a robot of spheres, capsules and boxes, with the zero pose in which its hinges are at the angles
    `zero`, in rad, its bodies' frames turned by `frames`, and `size` times as large. Bodies that are `bare` have
    `geoms` in place of their own."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    for name, angle in (zero or {}).items():
        data.qpos[model.joint(name).qposadr[0]] = angle
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    names = [model.body(body).name for body in range(model.nbody)]
    turns = [
        Rotation.from_matrix(matrix.reshape(3, 3)) * (frames or {}).get(name, Rotation.identity())
        for name, matrix in zip(names, data.xmat, strict=True)
    ]

    def numbers(values: np.ndarray) -> str:
        return " ".join(f"{value:.9f}" for value in values)

    def placed(body: int, point: np.ndarray, turn: Rotation) -> str:
        local = turns[body].inv().apply(size * (point - data.xpos[body]))
        quat = (turns[body].inv() * turn).as_quat(scalar_first=True)
        return f'pos="{numbers(local)}" quat="{numbers(quat)}"'

    def hinge(body: int, joint: int) -> str:
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            return "<freejoint/>"
        axis = turns[body].inv().apply(data.xaxis[joint])
        place = turns[body].inv().apply(size * (data.xanchor[joint] - data.xpos[body]))
        ends = numbers(model.jnt_range[joint] - data.qpos[model.jnt_qposadr[joint]])
        ends = f'range="{ends}"' if model.jnt_limited[joint] else ""
        return (
            f'<joint name="{model.joint(joint).name}" axis="{numbers(axis)}" pos="{numbers(place)}" {ends} '
            'damping=".2" armature=".01"/>'
        )

    def shape(body: int, geom: int) -> str:
        turn = Rotation.from_matrix(data.geom_xmat[geom].reshape(3, 3))
        kind = _SHAPES[int(model.geom_type[geom])]
        return (
            f'<geom type="{kind}" size="{numbers(size * model.geom_size[geom])}" density="1000" '
            f"{placed(body, data.geom_xpos[geom], turn)}/>"
        )

    def written(body: int) -> str:
        first, count = model.body_jntadr[body], model.body_jntnum[body]
        own = [
            *(hinge(body, joint) for joint in range(first, first + count)),
            *(shape(body, geom) for geom in range(model.ngeom) if model.geom_bodyid[geom] == body),
        ]
        if names[body] in bare:
            own = [
                *own[:count],
                '<inertial pos="0 0 0" mass="1" diaginertia=".01 .01 .01"/>',
                geoms,
            ]
        below = [written(b) for b in range(1, model.nbody) if model.body_parentid[b] == body]
        place = placed(int(model.body_parentid[body]), data.xpos[body], turns[body])
        return f'<body name="{rename(names[body])}" {place}>{"".join(own + below)}</body>'

    bodies = "".join(written(b) for b in range(1, model.nbody) if model.body_parentid[b] == 0)
    return f'<mujoco><compiler angle="radian"/><worldbody>{bodies}</worldbody></mujoco>'
