"""However the same robot is modelled, whatever its zero pose, frames, names and size, it makes the same motion."""

from __future__ import annotations

import re

import mujoco
import numpy as np
import pytest
from remodelled import remodelled
from robots import robot_xml
from scipy.spatial.transform import Rotation

from understudy.setup.plugins import installed
from understudy_characters.character import Character
from understudy_motion import library
from understudy_motion.clip import Clip
from understudy_retarget.retarget import Options, Report, retarget

REGISTRY = installed().registry
BODIES = re.findall(r'<body name="([^"]*)"', robot_xml())
FEET = ("left_foot", "right_foot")


@pytest.fixture(scope="module")
def walk() -> Clip:
    return library.find("walk", REGISTRY)


def moved(clip: Clip, text: str) -> tuple[np.ndarray, Report]:
    """(F, B, 3) m: where the bodies are while the robot makes the motion."""
    character = Character("robot", mujoco.MjModel.from_xml_string(text))
    result, report = retarget(clip, character)
    data, found = mujoco.MjData(character.model), []
    for pose in character.qpos(result).numpy():
        data.qpos[:] = pose
        mujoco.mj_kinematics(character.model, data)
        found.append(data.xpos.copy())
    return np.array(found), report


@pytest.fixture(scope="module")
def plain(walk: Clip) -> tuple[np.ndarray, Report]:
    return moved(walk, remodelled(robot_xml()))


def random_frames(*, root: bool) -> dict[str, Rotation]:
    return {
        name: Rotation.from_quat(np.random.default_rng(seed).normal(size=4))
        for seed, name in enumerate(BODIES)
        if root or name != "pelvis"
    }


@pytest.mark.parametrize(
    "frames",
    [
        *({"pelvis": Rotation.from_euler(axis, 90, degrees=True)} for axis in "xyz"),
        {"pelvis": Rotation.from_euler("xy", (30, -50), degrees=True)},
        random_frames(root=True),
        random_frames(root=False),
    ],
    ids=["x", "y", "z", "xy", "all", "all but the root"],
)
def test_frames_do_not_matter(
    walk: Clip, plain: tuple[np.ndarray, Report], frames: dict[str, Rotation]
) -> None:
    """A root whose own z is not up was turned by up to 0.4 m, and did not stand."""
    found, report = moved(walk, remodelled(robot_xml(), frames=frames))
    np.testing.assert_allclose(found, plain[0], atol=1e-3)
    assert report.fits


def test_a_robot_that_lies_in_its_model_makes_the_same_motion(
    walk: Clip, plain: tuple[np.ndarray, Report]
) -> None:
    """Its root's frame stands in the robot, and not in the world."""
    lying = remodelled(robot_xml()).replace("<worldbody>", '<worldbody><frame euler="1.5 .3 0">')
    found, report = moved(walk, lying.replace("</worldbody>", "</frame></worldbody>"))
    np.testing.assert_allclose(found, plain[0], atol=1e-3)
    assert report.fits


ZERO = {
    "elbows bent": {"left_elbow": 1.5, "right_elbow": 1.5},  # as of many robots
    "crouching": {
        f"{side}_{joint}": angle
        for side in ("left", "right")
        for joint, angle in (("knee", 1.2), ("hip_y", -0.6), ("ankle_y", -0.6))
    },
    "one leg raised": {"left_knee": 1.5, "left_hip_y": -1.0},
    "turned waist": {"waist": 1.0},
    "pointed feet": {"left_ankle_y": 0.9, "right_ankle_y": 0.9},
    "legs apart": {"left_hip_x": 0.8, "right_hip_x": -0.8},
    "legs turned out": {"left_hip_z": 0.8, "right_hip_z": -0.8},
    "arms out": {"left_shoulder_x": 1.5, "right_shoulder_x": -2.0},
}


@pytest.mark.parametrize("zero", list(ZERO))
def test_the_zero_pose_does_not_matter(
    walk: Clip, plain: tuple[np.ndarray, Report], zero: str
) -> None:
    """Where legs, feet, forearms and the chest of it were no stance, they were up to 0.34 m off."""
    found, report = moved(walk, remodelled(robot_xml(), ZERO[zero]))
    np.testing.assert_allclose(found, plain[0], atol=2e-3)
    assert report.mean_error == pytest.approx(plain[1].mean_error, rel=0.02)


def jointed(neck: bool) -> str:
    """The robot with a spine that bends and leans at two places, and perhaps with a neck."""
    waist = '<joint name="waist" axis="0 0 1"/>'
    spine = "".join(
        f'<joint name="{place}_y" axis="0 1 0"/><joint name="{place}_x" axis="1 0 0"/>{{}}'
        for place in ("low", "high")
    ).format('<geom size=".08" mass="3"/><body name="chest" pos="0 0 .08">' + waist, "")
    chest = f'<body name="chest" pos="0 0 .15">{waist}'
    text = robot_xml().replace(chest, f'<body name="abdomen" pos="0 0 .07">{spine}')
    if neck:
        head = '<body name="head" pos="0 0 .25"><joint name="neck" axis="0 1 0"/>'
        text = text.replace('<body name="head" pos="0 0 .35">', head)
    return text.replace("</body>\n</body></worldbody>", "</body></body>\n</body></worldbody>")


@pytest.mark.parametrize("neck", [False, True], ids=["no neck", "a neck"])
@pytest.mark.parametrize(
    ("zero", "most"),
    [
        ({"high_x": 0.5}, 0.002),
        ({"high_x": -1.0}, 0.002),
        ({"high_y": 0.5}, 0.04),
        ({"high_y": 1.2}, 0.04),
        ({"low_y": 0.9}, 0.08),
        ({"low_y": 0.6, "high_y": -0.6}, 0.06),
        ({"low_x": 0.8, "high_x": 0.5, "waist": 0.7}, 0.08),
    ],
    ids=str,
)
def test_a_crooked_spine_does_not_matter(
    walk: Clip, neck: bool, zero: dict[str, float], most: float
) -> None:
    """Where it bent the shoulders were up to 0.42 m off, and the whole of a robot that leaned much to a side."""
    straight, _ = moved(walk, remodelled(jointed(neck)))
    found, report = moved(walk, remodelled(jointed(neck), zero))
    np.testing.assert_allclose(found, straight, atol=most)
    assert report.fits


@pytest.mark.parametrize("size", [0.2, 0.4, 3.0])
def test_a_small_or_a_large_robot_makes_the_same_poses(
    walk: Clip, plain: tuple[np.ndarray, Report], size: float
) -> None:
    """What is a step and a contact is of its size: a robot of 30 cm was up to 16 % of its height off."""
    found, report = moved(walk, remodelled(robot_xml(), size=size))
    np.testing.assert_allclose(found / size, plain[0], atol=0.02)
    for name, near in (("leg", 1e-6), ("scale", 1e-6), ("mean_error", 0.15), ("skate", 0.3)):
        assert getattr(report, name) / size == pytest.approx(getattr(plain[1], name), rel=near)
    assert report.contact_share == pytest.approx(plain[1].contact_share, abs=0.01)


def test_a_stated_scale_is_the_travels_of_a_small_robot(walk: Clip) -> None:
    character = Character(
        "robot", mujoco.MjModel.from_xml_string(remodelled(robot_xml(), size=0.2))
    )
    result, report = retarget(walk, character, Options(scale=0.3))
    assert report.scale == pytest.approx(0.3)
    way, theirs = (c.root_position[-1] - c.root_position[0] for c in (result, walk))
    assert float(way[0]) == pytest.approx(0.3 * float(theirs[0]), rel=0.02)


@pytest.mark.parametrize(
    ("geoms", "contact"),
    [
        ('<geom type="capsule" size=".02" fromto="-.05 0 -.02 .13 0 -.02"/>', 0.63),
        (
            "".join(
                f'<geom size=".01" pos="{x} {y} -.03"/>'
                for x in (-0.06, 0.14)
                for y in (-0.04, 0.04)
            ),
            0.63,
        ),
        ('<geom size=".03" pos="0 0 -.01"/>', 0.5),
        ("", 0.48),  # there were no contacts at all
    ],
    ids=["capsule", "spheres", "a sphere", "nothing"],
)
def test_feet_of_other_geoms(
    walk: Clip, plain: tuple[np.ndarray, Report], geoms: str, contact: float
) -> None:
    found, report = moved(walk, remodelled(robot_xml(), bare=FEET, geoms=geoms))
    np.testing.assert_allclose(found, plain[0], atol=0.08)
    assert report.contact_share == pytest.approx(contact, abs=0.03)
    assert report.skate < 0.01


def test_names_with_a_namespace(walk: Clip, plain: tuple[np.ndarray, Report]) -> None:
    """As dm_control has them; legs were found by their shape, and the arms hung still."""
    text = remodelled(robot_xml(), rename="robot/{}".format)
    found, report = moved(walk, text)
    np.testing.assert_allclose(found, plain[0], atol=1e-6)
    assert report.still == ()


def test_limbs_that_follow_nothing_are_named(walk: Clip) -> None:
    _, report = moved(
        walk, remodelled(robot_xml(), rename=lambda name: f"part {BODIES.index(name)}")
    )
    arms = [f"{side}_{bone}" for side in ("left", "right") for bone in ("upper_arm", "forearm")]
    assert set(report.still) == {f"part {BODIES.index(name)}" for name in ("chest", *arms)}


def test_a_robot_with_one_arm(walk: Clip, plain: tuple[np.ndarray, Report]) -> None:
    text = remodelled(robot_xml())
    start = text.index('<body name="left_upper_arm"')
    text = text[:start] + text[text.index('<body name="right_upper_arm"') :]
    found, report = moved(walk, text)
    np.testing.assert_allclose(found[:, -1], plain[0][:, -1], atol=0.1)  # its hand
    assert "left_elbow" not in report.mapping
