"""Pictures: figures where they are, in their colours, over shadows and a floor that ends in the sky."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from understudy.errors import UnderstudyError
from understudy_mujoco import studio
from understudy_mujoco.scenery import Camera, Scenery
from understudy_mujoco.shadows import StillShadow
from understudy_mujoco.studio import LEARNED, REFERENCE, Figure, draw

BALL = """
<mujoco><worldbody><geom type="plane" size="0 0 1"/>
<body pos="0 0 1"><freejoint/><geom size="0.25" mass="1" rgba="0 1 0 1"/></body>
</worldbody></mujoco>
"""
WIDTH, HEIGHT = 160, 90


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(BALL)


def track(height: float, frames: int = 1, speed: float = 0.0) -> np.ndarray:
    qpos = np.tile([0.0, 0.0, height, 1.0, 0.0, 0.0, 0.0], (frames, 1))
    qpos[:, 0] = speed * np.arange(frames)
    return qpos


def frames(model: mujoco.MjModel, *figures: Figure, threads: int = 1) -> list[np.ndarray]:
    aims = figures[0].track[:, :2]
    camera = Camera(aims, height=0.6, distance=3.0, azimuth=90.0, elevation=-8.0)
    try:
        return list(draw(model, figures, camera, WIDTH, HEIGHT, threads))
    except UnderstudyError as error:
        pytest.skip(str(error))


def coloured(frame: np.ndarray, colour: studio.RGBA) -> np.ndarray:
    """(H, W) bool: where the hue is `colour`'s."""
    shade = frame.astype(float) / np.linalg.norm(frame.astype(float), axis=2, keepdims=True)
    wanted = np.array(colour[:3]) / np.linalg.norm(colour[:3])
    return shade @ wanted > 0.985


def test_a_figure_is_where_the_camera_sees_it(model: mujoco.MjModel) -> None:
    (frame,) = frames(model, Figure(track(0.6), LEARNED))
    rows, columns = np.nonzero(coloured(frame, LEARNED))
    np.testing.assert_allclose([rows.mean(), columns.mean()], [44.5, 79.5], atol=2.0)
    focal = 0.5 * HEIGHT / np.tan(np.radians(22.5))
    assert np.ptp(columns) == pytest.approx(2 * 0.25 * focal / 3.0, rel=0.15)


def test_colours_tell_figures_apart_and_none_is_the_models(model: mujoco.MjModel) -> None:
    (frame,) = frames(model, Figure(track(0.6)), Figure(track(0.6), REFERENCE, shift=(-0.8, 0.0)))
    own = np.argwhere(coloured(frame, (0, 1, 0, 1)))
    other = np.argwhere(coloured(frame, REFERENCE))
    assert min(len(own), len(other)) > 50
    # The camera looks along y: x is to its right.
    assert other[:, 1].mean() < own[:, 1].mean() - 20


def test_a_shadow_is_sharper_and_darker_near_the_floor(model: mujoco.MjModel) -> None:
    (low,), (high,) = (frames(model, Figure(track(z), LEARNED)) for z in (0.26, 1.2))
    (none,) = frames(model, Figure(track(50.0), LEARNED))
    far, near = (int((none.astype(int) - frame).sum(axis=2)[60:].max()) for frame in (high, low))
    assert near > far > 20


def test_floor_and_sky_meet_without_an_edge(model: mujoco.MjModel) -> None:
    (frame,) = frames(model, Figure(track(50.0), LEARNED))
    down = frame[:, 5].astype(int).sum(axis=1)
    horizon = HEIGHT // 2 - int(0.5 * HEIGHT / np.tan(np.radians(22.5)) * np.tan(np.radians(8)))
    assert np.abs(np.diff(down[horizon - 8 : horizon + 8])).max() <= 9


def test_the_floor_passes_by(model: mujoco.MjModel) -> None:
    first, second, whole = frames(model, Figure(track(50.0, 3, speed=1.0), LEARNED))
    assert np.abs(first[60:].astype(int) - second[60:]).max() > 8  # squares have become the others
    np.testing.assert_allclose(first.astype(int), whole, atol=1)


def test_threads_draw_the_same_frames(model: mujoco.MjModel) -> None:
    moving = Figure(track(0.6, 12, speed=0.05), LEARNED, label="learned")
    alone, together = frames(model, moving), frames(model, moving, threads=3)
    assert len(together) == 12
    for one, other in zip(alone, together, strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_legend_names_colours(model: mujoco.MjModel) -> None:
    named = Figure(track(50.0), REFERENCE, label="reference")
    (plain,), (frame,) = frames(model, Figure(track(50.0), REFERENCE)), frames(model, named)
    changed = np.argwhere((plain != frame).any(axis=2))
    assert (changed.max(axis=0) < [45, 120]).all()
    assert len(changed) > 120
    assert coloured(frame, REFERENCE)[:45, :30].any()


def test_a_caller_that_stops_early_leaves_no_thread(model: mujoco.MjModel) -> None:
    import threading

    before = threading.active_count()
    camera = Camera(np.zeros((50, 2)), height=0.6, distance=3.0)
    drawn = draw(model, [Figure(track(0.6, 50), LEARNED)], camera, WIDTH, HEIGHT, 2)
    try:
        next(drawn)
    except UnderstudyError as error:
        pytest.skip(str(error))
    drawn.close()
    assert threading.active_count() == before


#: The ball without a gleam, and a screen between the camera, at y = -3, and it.
DULL = BALL.replace("<mujoco>", '<mujoco><visual><headlight specular="0 0 0"/></visual>')
SCREENED = DULL.replace(
    '<body pos="0 0 1">',
    '<geom type="box" size="1 0.01 0.8" pos="-1 -0.6 0.8" rgba="1 0 0 0.6" contype="0"/><body pos="0 0 1">',
)


def test_painted_floor_and_drawn_figure_are_seen_alike_through_what_is_translucent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(StillShadow, "cast", lambda *_: None)  # it would lie on that floor
    ball = Figure(track(0.6), LEARNED)
    (screened,) = frames(mujoco.MjModel.from_xml_string(SCREENED), ball)
    (empty,) = frames(mujoco.MjModel.from_xml_string(DULL), ball)
    np.testing.assert_array_equal(screened[:, 90:], empty[:, 90:])
    for seen in ((slice(66, 70), slice(30, 50)), (slice(40, 48), slice(72, 76))):  # floor, ball
        through, behind = screened[seen].astype(float), empty[seen].astype(float)
        left = (
            through[..., 2] / behind[..., 2]
        )  # no blue in the screen, both of whose sides are seen
        np.testing.assert_allclose(left, 0.4**2, atol=0.03)
        added = through[..., 0] - left * behind[..., 0]
        assert ((added > 100) & (added < 0.84 * 255)).all()


def test_what_stands_around_a_figure_stays_when_others_have_nothing_around_them() -> None:
    """What nobody moves stands where the model has it, in the second frame as in the first."""
    model = mujoco.MjModel.from_xml_string(BALL.replace(
        "</worldbody>",
        '<body mocap="true" pos="-1 0 0.3"><geom type="box" size=".3 .3 .3" rgba="1 0 0 1"/></body></worldbody>',
    ))  # fmt: skip
    stays = Figure(track(0.6, 2), LEARNED, place=lambda model, data, frame: None)
    drawn = frames(model, stays, Figure(track(0.6, 2), REFERENCE, shift=(0.8, 0.0)))
    first, second = (int(coloured(frame, (1, 0, 0, 1)).sum()) for frame in drawn)
    assert first == second > 100


#: A box on the floor whose top, a square metre, is 0.6 m high.
BOXED = DULL.replace(
    '<body pos="0 0 1">',
    '<geom name="box" type="box" size=".5 .5 .3" pos="0 .3 .3" rgba=".8 .8 .8 1" contype="0"/><body pos="0 0 1">',
)


def darkened(
    xml: str, ball: tuple[float, float, float], other: tuple[float, float, float]
) -> np.ndarray:
    """(H, W): how much darker a picture from above is with the ball at `ball` than at `other`."""
    model = mujoco.MjModel.from_xml_string(xml)
    camera = Camera(np.zeros((2, 2)), height=0.6, distance=5.0, azimuth=90.0, elevation=-40.0)
    path = np.concatenate([track(0.0), track(0.0)])
    path[0, :3], path[1, :3] = ball, other
    try:
        first, second = draw(model, [Figure(path, LEARNED)], camera, WIDTH, HEIGHT, 1)
    except UnderstudyError as error:
        pytest.skip(str(error))
    return second.astype(int).sum(axis=2) - first.astype(int).sum(axis=2)


def pixel(point: tuple[float, float, float]) -> tuple[slice, slice]:
    """Where a place is seen from that camera."""
    scenery = Scenery(
        Camera(np.zeros((1, 2)), height=0.6, distance=5.0, azimuth=90.0, elevation=-40.0),
        45.0, WIDTH, HEIGHT,
    )  # fmt: skip
    (place,), _ = scenery.pixels(np.array([point]))
    column, row = np.round(place).astype(int)
    return slice(row - 1, row + 2), slice(column - 1, column + 2)


def test_a_figures_shadow_lies_on_the_box_that_it_is_above() -> None:
    # Light goes down by 1.3 m while it goes 0.4 m along x and 0.6 m along y.
    on_the_box = darkened(BOXED, (-0.1, 0.1, 1.0), (0.0, 50.0, 1.0))
    seen = pixel((-0.1 + 0.4 * 0.4 / 1.3, 0.1 + 0.6 * 0.4 / 1.3, 0.6))
    assert on_the_box[seen].min() > 60
    # Beside the box nothing is darker than without it.
    np.testing.assert_array_less(on_the_box[pixel((0.45, -0.15, 0.6))], 12)


def test_what_stands_around_casts_a_shadow_on_the_floor_and_not_on_its_own_top() -> None:
    away = (0.0, 50.0, 1.0)
    model = mujoco.MjModel.from_xml_string(BOXED)
    bare = mujoco.MjModel.from_xml_string(DULL)
    camera = Camera(np.zeros((1, 2)), height=0.6, distance=5.0, azimuth=90.0, elevation=-40.0)
    path = track(0.0)
    path[0, :3] = away
    try:
        (frame,), (empty,) = (
            list(draw(m, [Figure(path, LEARNED)], camera, WIDTH, HEIGHT, 1)) for m in (model, bare)
        )
    except UnderstudyError as error:
        pytest.skip(str(error))
    change = empty.astype(int).sum(axis=2) - frame.astype(int).sum(axis=2)
    # The top's right edge, 0.6 m high, throws its shadow 0.18 m beside the box.
    assert change[pixel((0.58, 0.5, 0.0))].min() > 60
    np.testing.assert_array_less(np.abs(change[pixel((-1.0, 0.0, 0.0))]), 8)
    top = frame[pixel((0.0, 0.3, 0.6))].astype(int).sum(axis=2)
    assert np.ptp(top) < 12


def test_shadows_of_what_stands_still_are_worked_out_once_and_anew_when_it_moves() -> None:
    model = mujoco.MjModel.from_xml_string(BOXED)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    shadow = StillShadow(model, np.array([model.geom("box").id]))
    first = shadow.cast(data)
    assert first is not None
    assert shadow.cast(data) is first
    assert shadow.cast(data, 0.6) is None  # nothing of it is above its own top
    np.testing.assert_allclose(first.at(np.array([[0.0, 3.0], [0.3, 3.0]])), [1.0, 0.0], atol=1e-6)
    model.geom_size[model.geom("box").id] = [0.5, 0.5, 0.1]
    smaller = shadow.cast(data)
    assert smaller is not None
    assert smaller is not first
    (top,) = shadow.tops(data)
    np.testing.assert_allclose(top.centre, [0.0, 0.3, 0.4])
