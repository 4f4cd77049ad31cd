"""A recorded motion in a room, as the room's camera sees it: over its photograph, or among its boxes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image

from understudy.errors import FileError
from understudy_characters.rooms import Camera
from understudy_characters.scene import CharacterScene
from understudy_mujoco.drawing import open_renderer

__all__ = ["add_camera", "draw"]

#: Of the states that there are, one in so many is drawn.
_EVERY = 2
#: m above the floor from which a plan is drawn, and its width in degrees.
_ABOVE, _FIELD = 9.0, 45.0
#: Half of the box in which shadows are worked out, in units of what a figure alone needs (3 m).
_SHADOWED = 4.0


def draw(
    scene: CharacterScene, track: np.ndarray, camera: Camera, *, plan: bool = False
) -> Iterator[np.ndarray]:
    """Frames (H, W, 3) uint8 of the motion `track` (T, nq) as the scene's camera sees it: over its photo,
    hidden where furniture stands before it, or in the room of boxes; or from above."""
    spec = scene.shown()
    width, height = camera.size
    spec.visual.global_.offwidth = max(width, spec.visual.global_.offwidth)
    spec.visual.global_.offheight = max(height, spec.visual.global_.offheight)
    # All of the room: where that box ends, floor and walls have specks.
    spec.visual.map.shadowclip, spec.visual.quality.shadowsize = _SHADOWED, 4096
    if plan:
        spec.worldbody.add_camera(name="photo", pos=[0, 0, _ABOVE], fovy=_FIELD)
    else:
        add_camera(spec, camera)
    model = spec.compile()
    data = mujoco.MjData(model)
    photo = None if plan or camera.photo is None else _photo(camera.photo, width, height)
    figure = np.isin(model.geom_bodyid, list(scene.character.carrier))
    renderer = open_renderer(model, width, height)
    try:
        for qpos in track[::_EVERY]:
            data.qpos[:] = qpos
            mujoco.mj_kinematics(model, data)
            mujoco.mj_camlight(model, data)
            renderer.update_scene(data, "photo")
            frame = renderer.render()
            if photo is not None:
                renderer.enable_segmentation_rendering()
                seen = renderer.render()
                renderer.disable_segmentation_rendering()
                geoms = seen[..., 1] == int(mujoco.mjtObj.mjOBJ_GEOM)
                mask = geoms & figure[np.clip(seen[..., 0], 0, model.ngeom - 1)]
                frame = np.where(mask[..., None], frame, photo)
            yield frame
    finally:
        renderer.close()


def add_camera(spec: mujoco.MjSpec, camera: Camera) -> None:
    """Add the camera ``photo``, which sees in the pixel that its focal lengths and centre say."""
    eye = spec.worldbody.add_camera(name="photo", pos=camera.position)
    axes = camera.rotation @ np.diag([1.0, -1.0, -1.0])  # y up, looking along -z
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, axes.flatten())
    size = np.array(camera.size)
    eye.quat, eye.resolution, eye.sensor_size = quat, size, 1e-3 * size
    # from the centre to the left and up
    eye.focal_pixel, eye.principal_pixel = camera.focal, 0.5 * size - camera.centre


def _photo(path: Path, width: int, height: int) -> np.ndarray:
    """The photograph (H, W, 3), its nearest pixels."""
    try:
        image = np.asarray(Image.open(path).convert("RGB"))
        rows = np.arange(height) * len(image) // height
        columns = np.arange(width) * image.shape[1] // width
        return image[rows][:, columns].astype(np.uint8)
    except Exception as error:  # whatever the reader of that format raises
        raise FileError(f"The photo {path} cannot be read: {error}") from error
