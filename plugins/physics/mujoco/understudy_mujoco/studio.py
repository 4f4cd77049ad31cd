"""Pictures of moving figures on an endless floor, drawn fast without a graphics card.

MuJoCo draws the figures alone, at twice the size. Floor, soft shadows, haze and sky are painted with
NumPy: drawn by OpenGL in software they, and multisampling, take nine tenths of the time. Frames are
independent of one another, so several threads draw them, each with an OpenGL context of its own.

T frames, H × W pixels; world frame, m.
"""

from __future__ import annotations

import copy
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import mujoco
import numpy as np

from understudy.records.runs import cores
from understudy_mujoco.opengl import no_opengl
from understudy_mujoco.scenery import Camera, Scenery
from understudy_mujoco.shadows import FigureShadow, Patch, StillShadow, Top

__all__ = ["LEARNED", "REFERENCE", "Figure", "draw"]

RGBA = tuple[float, float, float, float]

#: The learned motion and its reference, in videos, stick figures, charts and on the motion page.
LEARNED: RGBA = (0.145, 0.388, 0.922, 1.0)
REFERENCE: RGBA = (0.96, 0.62, 0.25, 1.0)

#: The figures are drawn at so many times the size, and their edges averaged.
_FINER = 2
#: Faces of what is round.
_AROUND, _ALONG = 20, 12
#: How dark the middle of a shadow is.
_SHADE = 0.5
#: m: how high a body is that is not to be seen; what is nearer to the eye is beside the picture.
_AWAY, _NEAR = -1000.0, 0.1
#: Of the legend: the letters' colour; pixels to the edges, a line, and a dot's radius.
_INK = np.array([52.0, 62, 78])
_MARGIN, _LINE, _DOT = 16, 22, 5.5


@dataclass(frozen=True)
class Figure:
    """One moving figure."""

    track: np.ndarray  #: (T, nq)
    colour: RGBA | None = None  #: all of it; None leaves the model's colours
    shift: tuple[float, float] = (0.0, 0.0)  #: m: drawn so far from where it is, along x and y
    label: str = ""  #: beside its colour in the legend, if it has one
    #: Puts what stands around the figure where it is in a frame; nothing stands around one without.
    place: Callable[[mujoco.MjModel, mujoco.MjData, int], None] | None = None


def draw(
    model: mujoco.MjModel,
    figures: Sequence[Figure],
    camera: Camera,
    width: int,
    height: int,
    threads: int | None = None,
) -> Iterator[np.ndarray]:
    """Frames (H, W, 3) uint8 of `figures`, all of the same `model`, whose free joint comes first.

    Raises
    ------
    UnderstudyError
        there is no OpenGL.
    """
    scenery = Scenery(camera, float(model.vis.global_.fovy), width, height)
    scenery.prepare()
    mine = threading.local()

    def frame(index: int) -> np.ndarray:
        if not hasattr(mine, "painter"):
            mine.painter = _Painter(model, scenery, figures)
        return mine.painter.paint(index)

    count = threads or min(4, cores())
    with ThreadPoolExecutor(count) as pool:
        ahead: deque[Future[np.ndarray]] = deque()
        try:
            for index in range(len(camera.aims)):
                ahead.append(pool.submit(frame, index))
                if len(ahead) > 2 * count:
                    yield ahead.popleft().result()
            while ahead:
                yield ahead.popleft().result()
        finally:
            for future in ahead:
                future.cancel()


class _Painter:
    """Draws frames in the thread that made it."""

    def __init__(self, model: mujoco.MjModel, scenery: Scenery, figures: Sequence[Figure]) -> None:
        model = _without_floor(model)
        self._scenery, self._model, self._figures = scenery, model, figures
        self._view = mujoco.MjrRect(0, 0, _FINER * scenery.width, _FINER * scenery.height)
        model.vis.global_.offwidth, model.vis.global_.offheight = (
            self._view.width,
            self._view.height,
        )
        self._data = mujoco.MjData(model)
        self._standing = self._data.mocap_pos.copy()  # where nobody moves them
        self._scene = mujoco.MjvScene(model, 2 * model.ngeom + 100)
        for flag in ("SHADOW", "REFLECTION", "SKYBOX", "HAZE", "FOG"):
            self._scene.flags[getattr(mujoco.mjtRndFlag, f"mjRND_{flag}")] = False
        self._option, self._perturb = mujoco.MjvOption(), mujoco.MjvPerturb()
        camera = self._camera = mujoco.MjvCamera()
        seen = scenery.camera
        camera.distance, camera.azimuth, camera.elevation = (
            seen.distance, seen.azimuth, seen.elevation,
        )  # fmt: skip
        figure = model.body_rootid[model.geom_bodyid] == model.body_rootid[model.jnt_bodyid[0]]
        drawn = (model.geom_rgba[:, 3] > 0.0) & (model.geom_group < 3)
        geoms = np.flatnonzero(figure & drawn)
        planes = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
        around = np.flatnonzero(~figure & drawn & ~planes)
        self._geoms, self._shadow = geoms, FigureShadow(model, geoms)
        #: Of what is seen beside the figure, which can be anywhere.
        self._around = StillShadow(model, around) if len(around) else None
        try:
            self._gl = mujoco.GLContext(self._view.width, self._view.height)
            self._gl.make_current()
            self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_200)
        except Exception as error:  # whatever the platform's OpenGL raises
            raise no_opengl(error) from error
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._legend = self._draw_legend()

    def close(self) -> None:
        self._context.free()
        self._gl.free()

    def paint(self, frame: int) -> np.ndarray:
        """Frame (H, W, 3) uint8."""
        scenery, scene, data = self._scenery, self._scene, self._data
        aim = scenery.camera.aims[frame]
        picture = scenery.background(aim)
        self._camera.lookat = [*aim, scenery.camera.height]
        corners: list[np.ndarray] = []
        #: What casts shadows on the floor, and on what stands on it.
        floor: list[Patch] = []
        tops: list[tuple[Top, list[Patch]]] = []
        for k, figure in enumerate(self._figures):
            data.qpos[:] = figure.track[frame]
            data.qpos[:2] += figure.shift
            if figure.place is not None:
                data.mocap_pos[:] = self._standing
                figure.place(self._model, data, frame)
            else:
                data.mocap_pos[:, 2] = _AWAY
            mujoco.mj_kinematics(self._model, data)
            mujoco.mj_camlight(self._model, data)
            before = scene.ngeom if k else 0
            if k == 0:
                every = int(mujoco.mjtCatBit.mjCAT_ALL)
                mujoco.mjv_updateScene(
                    self._model, data, self._option, self._perturb, self._camera, every, scene
                )
            else:
                every = int(mujoco.mjtCatBit.mjCAT_DYNAMIC)
                mujoco.mjv_addGeoms(self._model, data, self._option, self._perturb, every, scene)
            _colour(scene, before, figure.colour, set(self._geoms.tolist()))
            corners.append(self._box(data, aim))
            casting = [self._shadow]
            if k == 0 and self._around is not None:
                corners.append(self._edges(self._around.points(data) - [*aim, 0.0]))
                tops = [(top, []) for top in self._around.tops(data)]
                casting = [self._around, self._shadow]
            for one in casting:
                floor += _one(one.cast(data))
                for top, patches in tops:
                    patches += _one(one.cast(data, float(top.centre[2])))
        self._shade_floor(picture, floor, aim)
        self._compose(picture, np.array(corners), tops, aim)
        colours, cover = self._legend
        corner = picture[: len(cover), : cover.shape[1]]
        corner += cover * (colours - corner)
        return picture.astype(np.uint8)

    def _draw_legend(self) -> tuple[np.ndarray, np.ndarray]:
        """What lies over the upper left corner: its colours (h, w, 3), and (h, w, 1) how much of them."""
        shown = [f for f in self._figures if f.label and f.colour]
        scenery = self._scenery
        height = min(_MARGIN + _LINE * len(shown), scenery.height) if shown else 0
        width = min(_MARGIN + 160, scenery.width)
        colours = np.empty((height, width, 3), np.float32)
        colours[:] = _INK
        cover = np.zeros((height, width, 1), np.float32)
        y, x = np.mgrid[:height, :width]
        for k, figure in enumerate(shown):
            row, colour = _MARGIN + _LINE * k + _LINE // 2, figure.colour or LEARNED
            dot = np.clip(_DOT + 0.5 - np.hypot(y - row, x - _MARGIN - _DOT), 0.0, 1.0)[..., None]
            colours = np.where(dot > 0, 255 * np.array(colour[:3], np.float32), colours)
            text = self._text(figure.label)[: max(height - row, 0), : width - _MARGIN - _LINE]
            top = row - len(text) // 2
            part = cover[
                top : top + len(text), _MARGIN + _LINE : _MARGIN + _LINE + text.shape[1], 0
            ]
            part[:] = text[: part.shape[0], : part.shape[1]]
            cover = np.maximum(cover, dot)
        return colours.astype(np.float32), cover.astype(np.float32)

    def _text(self, text: str) -> np.ndarray:
        """(h, w) in [0, 1]: how much of each pixel the letters cover."""
        box = mujoco.MjrRect(0, 0, min(300, self._view.width), min(80, self._view.height))
        mujoco.mjr_rectangle(box, 0.0, 0.0, 0.0, 1.0)
        place, font = mujoco.mjtGridPos.mjGRID_TOPLEFT, mujoco.mjtFont.mjFONT_NORMAL
        mujoco.mjr_overlay(font, place, box, text, "", self._context)
        pixels = np.empty((box.height, box.width, 3), np.uint8)
        mujoco.mjr_readPixels(pixels, None, box, self._context)
        letters = _coarser(pixels[::-1, :, 0].astype(np.float32)) / (255.0 * _FINER**2)
        used = letters > 0.02
        rows, columns = np.flatnonzero(used.any(axis=1)), np.flatnonzero(used.any(axis=0))
        if not len(rows):
            return np.zeros((0, 0), np.float32)
        return letters[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]

    def _box(self, data: mujoco.MjData, aim: np.ndarray) -> np.ndarray:
        """(4,): first and last column and row between which the figure is seen."""
        places = data.geom_xpos[self._geoms] - [*aim, 0.0]
        pixels, scale = self._scenery.pixels(places)
        reach = (self._model.geom_rbound[self._geoms] * scale)[:, None] + 2.0
        (left, top), (right, bottom) = (pixels - reach).min(axis=0), (pixels + reach).max(axis=0)
        return np.array([left, top, right, bottom])

    def _shade_floor(self, picture: np.ndarray, patches: Sequence[Patch], aim: np.ndarray) -> None:
        """Darken `picture` (H, W, 3) where shadows lie on the floor."""
        scenery = self._scenery
        light = np.ones(scenery.floor.shape[1:], np.float32)
        for patch in patches:
            rows, columns = self._window(patch.corners(), 0.0, aim)
            if rows.start >= rows.stop or columns.start >= columns.stop:
                continue
            inside = slice(rows.start - scenery.horizon, rows.stop - scenery.horizon)
            places = scenery.floor[:, inside, columns] + aim.astype(np.float32)[:, None, None]
            light[inside, columns] *= 1.0 - patch.at(places)
        dark = np.flatnonzero((light < 1.0).any(axis=1))
        if len(dark):
            part = slice(dark[0], dark[-1] + 1)
            picture[scenery.horizon :][part] *= 1.0 - _SHADE * (1.0 - light[part, :, None])

    def _edges(self, points: np.ndarray) -> np.ndarray:
        """(4,): first and last column and row between which the hull of `points` (P, 3), from the aim on
        the floor, is seen."""
        scenery = self._scenery
        if ((points - scenery.eye) @ scenery.forward < _NEAR).any():  # it goes on behind the camera
            return np.array([0.0, 0.0, scenery.width, scenery.height])
        seen, _ = scenery.pixels(points)
        return np.concatenate([seen.min(axis=0) - 1.0, seen.max(axis=0) + 1.0])

    def _window(self, corners: np.ndarray, height: float, aim: np.ndarray) -> tuple[slice, slice]:
        """The rows and columns in which a part of a plane is seen that has these `corners` (4, 2)."""
        scenery = self._scenery
        points = np.column_stack([corners - aim, np.full(len(corners), height)])
        left, top, right, bottom = self._edges(points)
        rows = _span(max(top, scenery.horizon), bottom, scenery.height)
        return rows, _span(left, right, scenery.width)

    def _compose(
        self,
        picture: np.ndarray,
        boxes: np.ndarray,
        tops: Sequence[tuple[Top, list[Patch]]],
        aim: np.ndarray,
    ) -> None:
        """Lay what was drawn over `picture` (H, W, 3), where `boxes` (K, 4) say that something is, with
        the shadows that fall on `tops`."""
        height, width, _ = picture.shape
        (left, top), (right, bottom) = boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)
        rows, columns = _span(top, bottom, height), _span(left, right, width)
        if rows.start >= rows.stop or columns.start >= columns.stop:
            return
        box = mujoco.MjrRect(
            _FINER * columns.start,
            _FINER * (height - rows.stop),
            _FINER * (columns.stop - columns.start),
            _FINER * (rows.stop - rows.start),
        )
        colours, depth = self._rendered(box)
        assert depth is not None
        covered = (depth < 1.0).astype(np.uint16)  # behind is nothing, and black
        scale = np.float32(1.0)
        if _show_opacity(self._scene):  # what one sees through has no depth
            opacity = self._rendered(box, depth=False)[0]
            covered, scale = np.maximum(255 * covered, opacity[..., 0]), np.float32(255.0)
        part = picture[rows, columns]
        part *= 1.0 - _coarser(covered[::-1])[..., None] / (scale * _FINER**2)
        drawn = _coarser(colours[::-1]) / np.float32(_FINER**2)
        for top, patches in tops:
            self._shade_top(drawn, depth[::-1], (rows, columns), top, patches, aim)
        part += drawn

    def _shade_top(
        self,
        drawn: np.ndarray,
        depth: np.ndarray,
        seen: tuple[slice, slice],
        top: Top,
        patches: Sequence[Patch],
        aim: np.ndarray,
    ) -> None:
        """Darken what was `drawn` (h, w, 3) in the rows and columns `seen`, at this finer `depth`, where
        `patches` lie on `top`."""
        height = float(top.centre[2])
        own = _both(seen, self._window(top.corners(), height, aim))
        first, left_of = seen[0].start, seen[1].start
        world = np.append(aim, 0.0).astype(np.float32)[:, None, None]
        for patch in patches:
            rows, columns = _both(own, self._window(patch.corners(), height, aim))
            if rows.start >= rows.stop or columns.start >= columns.stop:
                continue
            # One of the finer pixels of each: the outlines of what is in front stay smooth enough.
            down = np.arange(_FINER * rows.start, _FINER * rows.stop, _FINER)
            across = np.arange(_FINER * columns.start, _FINER * columns.stop, _FINER)
            far = depth[np.ix_(down - _FINER * first, across - _FINER * left_of)]
            places = self._places(far, down, across) + world
            on = top.seen(places)
            left = np.ones(on.shape, np.float32)
            left[on] -= _SHADE * patch.at(places[:2, on])
            part = slice(rows.start - first, rows.stop - first)
            drawn[part, columns.start - left_of : columns.stop - left_of] *= left[..., None]

    def _places(self, depth: np.ndarray, down: np.ndarray, across: np.ndarray) -> np.ndarray:
        """(3, h, w) float32, from the aim on the floor: what is seen at `depth` (h, w) in the rows `down`
        (h,) and columns `across` (w,) of the finer picture."""
        scenery, vis, extent = self._scenery, self._model.vis, self._model.stat.extent
        near, far = vis.map.znear * extent, vis.map.zfar * extent
        away = np.float32(near * far) / (np.float32(far) - np.float32(far - near) * depth)
        up = (0.5 * scenery.height - (down + 0.5) / _FINER) / scenery.focal
        right = ((across + 0.5) / _FINER - 0.5 * scenery.width) / scenery.focal
        along = scenery.forward[:, None] + scenery.up[:, None] * up  # (3, h)
        rays = along[:, :, None] + (scenery.right[:, None] * right)[:, None]
        return rays.astype(np.float32) * away + scenery.eye.astype(np.float32)[:, None, None]

    def _rendered(
        self, box: mujoco.MjrRect, *, depth: bool = True
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """The scene's colours (H, W, 3) uint8 and, if wanted, depth (H, W) in `box`, the lowest row
        first."""
        colours = np.empty((box.height, box.width, 3), np.uint8)
        away = np.empty((box.height, box.width), np.float32) if depth else None
        mujoco.mjr_render(self._view, self._scene, self._context)
        mujoco.mjr_readPixels(colours, away, box, self._context)
        return colours, away


def _without_floor(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy that draws no planes, has no buffers for what is not drawn by OpenGL, and rounds with so
    few faces that they are just not seen: without a graphics card they take most of OpenGL's time."""
    copied = copy.copy(model)
    planes = copied.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    copied.geom_matid[planes], copied.geom_rgba[planes, 3] = -1, 0.0
    quality = copied.vis.quality
    quality.offsamples, quality.shadowsize = 0, 0
    quality.numslices, quality.numstacks = _AROUND, _ALONG
    return copied


def _colour(scene: mujoco.MjvScene, first: int, colour: RGBA | None, figure: set[int]) -> None:
    """Give the geoms of the `figure`, of those from the geom `first` on, a `colour`."""
    if colour is None:
        return
    for geom in scene.geoms[first : scene.ngeom]:
        if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.objid in figure:
            geom.matid, geom.rgba[:] = -1, colour


def _show_opacity(scene: mujoco.MjvScene) -> bool:
    """Make all geoms black but those that one sees through: white, so that what is drawn is how much of
    the background they hide. False, and nothing is done, if there are none."""
    geoms = scene.geoms[: scene.ngeom]
    if not any(geom.rgba[3] < 1.0 for geom in geoms):
        return False
    for geom in geoms:
        glow = float(geom.rgba[3] < 1.0)
        geom.matid, geom.rgba[:3], geom.emission, geom.specular = -1, glow, glow, 0.0
    return True


def _both(one: tuple[slice, slice], other: tuple[slice, slice]) -> tuple[slice, slice]:
    """The rows and columns that are in both."""
    rows, columns = (
        slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in zip(one, other, strict=True)
    )
    return rows, columns


def _one(patch: Patch | None) -> list[Patch]:
    return [] if patch is None else [patch]


def _span(first: float, last: float, size: int) -> slice:
    """The pixels from `first` to `last` that there are."""
    return slice(int(np.clip(first, 0, size)), int(np.clip(np.ceil(last), 0, size)))


def _coarser(fine: np.ndarray) -> np.ndarray:
    """(H, W, …): sums over squares of ``_FINER`` × ``_FINER`` pixels; whole numbers as uint16."""
    kind = np.uint16 if fine.dtype.kind == "u" else fine.dtype
    rows = _sum([fine[i::_FINER] for i in range(_FINER)], kind)  # along memory, which is quick
    return _sum([rows[:, i::_FINER] for i in range(_FINER)], kind)


def _sum(parts: Sequence[np.ndarray], kind: np.typing.DTypeLike) -> np.ndarray:
    first, *rest = parts
    total = first.astype(kind)
    for part in rest:
        np.add(total, part, out=total)
    return total
