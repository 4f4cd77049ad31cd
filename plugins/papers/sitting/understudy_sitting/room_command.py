"""``understudy sitting room``: a finished controller sits down in a room that was seen in a picture."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image

from understudy.command.command import Command
from understudy.errors import FileError
from understudy.records import runs
from understudy.setup.building import build_environment
from understudy.setup.composition import compose_raw, replaced
from understudy_characters.scene import CharacterScene
from understudy_mujoco.drawing import open_renderer
from understudy_report.video import write_video
from understudy_sitting.examples import watch
from understudy_sitting.room import EXAMPLE, Camera, Room, chair_sizes, read_scene
from understudy_sitting.trials import SEATED

#: Frames per second of the video; physics gives 60 states.
_RATE, _EVERY = 30, 2
#: m above the floor from which a plan is drawn, and its width in degrees.
_ABOVE, _FIELD = 9.0, 45.0
#: Half of the box in which shadows are worked out, in units of what a figure alone needs (3 m).
_SHADOWED = 4.0


class SitInRoom(Command):
    """Writes a video of the controller RUN sitting down on a chair of a scene of boxes."""

    example = "understudy sitting room sitting/meta"

    takes_overrides = True

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        add("run", help="a finished run's folder")
        add("video", type=Path, metavar="OUT", help="such as room.mp4")
        add("--scene", type=Path, default=EXAMPLE, help="a JSON of boxes and a camera")
        add("--chair", type=int, default=0, help="which of its chairs, from 0")
        add("--plan", action="store_true", help="draw it from above")
        add("--trials", type=int, default=64, help="of which a success is shown, if there is one")

    def writes(self, options: argparse.Namespace) -> Iterator[Path | None]:
        yield options.video

    def run(self, options: argparse.Namespace) -> int:
        scene = read_scene(options.scene)
        if not 0 <= options.chair < len(scene.chairs):
            raise FileError(f"{options.scene} has {len(scene.chairs)} chairs, from 0.")
        run = runs.open_run(options.run)
        sizes = chair_sizes(scene.chairs[options.chair])
        furnished = [
            f"chair={{{','.join(f'{name}:{size}' for name, size in sizes.items())}}}",
            f"+room={{file:'{options.scene}',chair:{options.chair}}}",
            "initial_states.zone=1",
        ]
        placed = run.words(furnished)
        config = compose_raw(replaced(placed, options.overrides))
        experiment = run.experiment(config=config)
        built = build_environment(
            experiment, num_worlds=max(1, options.trials), evaluating=True,
            episode_seconds=experiment.root.evaluation.seconds,
        )  # fmt: skip
        try:
            watched = watch(built, run, experiment, "room")
        finally:
            built.environment.close()
        share = float(watched.success.float().mean())
        track = watched.track(int(watched.seated.argmax()))["qpos"]
        room = built.context.need_section("room", Room, "understudy sitting room")
        frames = draw(built.scene, track, room.camera, plan=options.plan)
        write_video(options.video, frames, _RATE)
        print(
            f"{share:.0%} of {len(watched.seated)} trials sat for {SEATED:g} s; video: {options.video}"
        )
        return 0


def draw(
    scene: object, track: np.ndarray, camera: Camera, *, plan: bool = False
) -> Iterator[np.ndarray]:
    """Frames (H, W, 3) uint8 of the motion `track` (T, nq) as the scene's camera sees it: over its photo,
    hidden where furniture stands before it, or in the room of boxes; or from above."""
    assert isinstance(scene, CharacterScene)
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
