"""MuJoCo's own renderer, or the sentence that says why there is none."""

import mujoco

from understudy_mujoco.opengl import no_opengl

__all__ = ["open_renderer"]


def open_renderer(
    model: mujoco.MjModel, width: int, height: int, max_geom: int = 10_000
) -> mujoco.Renderer:
    """For pictures of ``width`` times ``height`` pixels and ``max_geom`` shapes at most; to be closed.

    Raises:
        UnderstudyError: there is no OpenGL to draw with.
    """
    try:
        return mujoco.Renderer(model, height, width, max_geom=max_geom)
    except Exception as error:  # whatever the platform's OpenGL raises
        raise no_opengl(error) from error
