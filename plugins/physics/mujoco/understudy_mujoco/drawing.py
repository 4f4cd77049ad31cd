"""MuJoCo's own renderer, or the sentence that says why there is none; and motions that it draws."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import mujoco
import numpy as np

from understudy_mujoco.opengl import no_opengl

__all__ = ["HORIZON", "draw_motion", "gradient_sky", "open_renderer"]

#: Of the sky where it meets the floor.
HORIZON = (0.93, 0.95, 0.98)


def gradient_sky(spec: mujoco.MjSpec, name: str = "sky") -> None:
    """A bright sky, its texture of that `name`, which no other texture of the model may have."""
    spec.add_texture(
        name=name,
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=HORIZON,
        rgb2=[0.62, 0.7, 0.8],
        width=256,
        height=1536,
    )


def open_renderer(
    model: mujoco.MjModel, width: int, height: int, max_geom: int = 10_000
) -> mujoco.Renderer:
    """For pictures of ``width`` times ``height`` pixels and ``max_geom`` shapes at most; to be closed.

    Raises
    ------
    UnderstudyError
        there is no OpenGL to draw with.
    """
    try:
        return mujoco.Renderer(model, height, width, max_geom=max_geom)
    except Exception as error:  # whatever the platform's OpenGL raises
        raise no_opengl(error) from error


def draw_motion(
    model: mujoco.MjModel,
    motion: np.ndarray,
    size: tuple[int, int],
    camera: mujoco.MjvCamera,
    aim: Callable[[int, mujoco.MjData], None],
    more: Callable[[int, mujoco.MjData, mujoco.MjvScene], None] = lambda frame, data, scene: None,
) -> Iterator[np.ndarray]:
    """The pictures of a motion, (H, W, 3) uint8 each.

    Parameters
    ----------
    motion
        (T, nq), the model's ``qpos`` in each frame
    size
        width and height in pixels
    camera
        what sees it, once `aim` has moved it
    aim, more
        are told the frame's number and where everything is: one points the camera, the other adds shapes to
        the picture

    Raises
    ------
    UnderstudyError
        if there is no OpenGL to draw with.
    """
    data = mujoco.MjData(model)
    renderer = open_renderer(model, *size)
    try:
        for frame, qpos in enumerate(motion):
            data.qpos[:] = qpos
            mujoco.mj_kinematics(model, data)
            mujoco.mj_camlight(model, data)
            aim(frame, data)
            renderer.update_scene(data, camera)
            more(frame, data, renderer.scene)
            yield renderer.render()
    finally:
        renderer.close()
