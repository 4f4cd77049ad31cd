"""What films show of touch."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from understudy_dressing.body import LINKS, radii, sensors, tool_bodies
from understudy_dressing.drawing import Felt
from understudy_dressing.garment import GarmentScene
from understudy_dressing.person import PersonScene, neutral_pose


def neutral(frames: int) -> dict[str, np.ndarray]:
    """Recorded fields of the neutral person that feels nothing, and where its sensors are by MuJoCo's kinematics."""
    person = PersonScene(PersonScene.Options())
    model = person.spec().compile()
    data = mujoco.MjData(model)
    data.qpos[: model.nu] = neutral_pose(person).numpy()
    mujoco.mj_kinematics(model, data)
    bodies = [data.body(name) for name in tool_bodies()]
    places = [
        data.body(name).xpos + data.body(name).xmat.reshape(3, 3) @ np.array(point)
        for name, point in sensors()
    ]
    one = {
        "tool_position": np.array([body.xpos for body in bodies]),
        "tool_orientation": np.array([body.xquat for body in bodies]),
        "sensor_force": np.zeros((22, 3)),
        "sensor_sign": np.zeros(22),
        "fingertip": np.array([0.1, 0.2, 0.3]),
        "task_vector": np.array([0.0, 0.0, 1.0]),
        "places": np.array(places),
    }
    return {name: np.stack([value] * frames) for name, value in one.items()}


def test_a_sensor_lights_up_where_it_is_touched_by_sign_and_force() -> None:
    tracks = neutral(2)
    tracks["sensor_force"][1, 21] = (0.0, 0.0, -5.0)
    tracks["sensor_force"][1, 1] = (1.0, 0.0, 0.0)
    tracks["sensor_sign"][1, [1, 21]] = (-1.0, 1.0)
    felt = Felt(tracks)
    scene = mujoco.MjvScene(mujoco.MjModel.from_xml_string("<mujoco/>"), 8)
    felt(0, scene)
    assert scene.ngeom == 1, "nothing is touched: the task vector alone"
    scene.ngeom = 0
    felt(1, scene)
    neck, tip, arrow = (scene.geoms[number] for number in range(scene.ngeom))
    for geom, number in ((neck, 1), (tip, 21)):
        assert geom.pos == pytest.approx(tracks["places"][1, number], abs=1e-6)
        assert geom.size[0] > radii()[number], "above the skin"
    assert neck.rgba[0] > neck.rgba[1], "red from outside"
    assert tip.rgba[1] > tip.rgba[0], "green from inside"
    assert neck.rgba[3] < tip.rgba[3] == 1
    assert arrow.mat[:, 2] == pytest.approx([0, 0, 1], abs=1e-6)


def test_its_fields_are_recorded() -> None:
    assert set(GarmentScene.recorded) >= {"cloth_position", "sensor_force", "task_vector"}


def test_spheres_have_the_size_of_the_person_there() -> None:
    """Of each sensor at the end of one of the person's shapes: that shape's radius."""
    ends = {
        (link.name, place): radius
        for link in LINKS
        for ra, a, rb, b in link.shapes
        for radius, place in ((ra, a), (rb, b))
    }
    known = {place: radius for place, radius in zip(sensors(), radii(), strict=True)}
    assert len(ends.keys() & known.keys()) >= 13
    for place in ends.keys() & known.keys():
        assert known[place] == pytest.approx(ends[place])
