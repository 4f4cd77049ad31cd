"""Clips whose zero pose is no stance: the same positions in, the same pose out."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
import torch
from cases import CASES, needs_cases
from scipy.spatial.transform import Rotation

from understudy.setup.plugins import installed
from understudy_characters.character import Character, load_character
from understudy_motion import library
from understudy_motion.clip import Clip
from understudy_motion.kinematics import forward_kinematics
from understudy_motion.reading import ReadOptions, read_clip
from understudy_retarget.anatomy import find_parts
from understudy_retarget.retarget import Report, retarget
from understudy_retarget.stance import standing
from understudy_tensors import rotations

REGISTRY = installed().registry
needs_data = pytest.mark.skipif(
    library.data_folder() is None, reason="no real clips (UNDERSTUDY_DATA)"
)
LIMBS = {"legs": ("hip", "knee", "ankle"), "arms": ("shoulder", "elbow")}


@functools.cache
def humanoid() -> Character:
    return load_character("humanoid", REGISTRY)


@functools.cache
def of_the_humanoid(name: str) -> Clip:
    """The packaged clip `name` with the humanoid's own skeleton."""
    plain = library.find(name, REGISTRY)
    return humanoid().clip(humanoid().qpos(plain), plain.times, name=name, loop=plain.loop)


@functools.cache
def as_usual(name: str) -> tuple[Clip, Report]:
    """That clip, retargeted to the humanoid."""
    return retarget(of_the_humanoid(name), humanoid())


def along_bones(clip: Clip, limbs: tuple[str, ...], axis: np.ndarray, mirrored: bool) -> Clip:
    """The same motion with the joints' frames of some limbs, and all below, turned about a random angle
    and so that `axis` lies along their bones (against them on the right if `mirrored`)."""
    skeleton = clip.skeleton
    assert skeleton is not None
    names, rng = skeleton.joint_names, np.random.default_rng(3)
    fixed = [Rotation.identity()] * len(names)
    for joint, name in enumerate(names):
        if not any(name.endswith(part) for limb in limbs for part in LIMBS[limb]):
            continue
        below = [j for j, parent in enumerate(skeleton.parents) if parent == joint]
        bone = skeleton.offsets[below[0]] if below else skeleton.tips[name]
        sign = -1.0 if mirrored and name.startswith("right") else 1.0
        turn = Rotation.align_vectors(bone, sign * axis)[0]
        fixed[joint] = turn * Rotation.from_rotvec(rng.uniform(-3, 3) * axis)
    return with_frames(clip, fixed)


def with_frames(clip: Clip, fixed: list[Rotation]) -> Clip:
    """The same motion with each joint's frame turned by `fixed`, in that frame."""
    skeleton = clip.skeleton
    assert skeleton is not None
    names = skeleton.joint_names
    turned, offsets, tips = [], skeleton.offsets.copy(), dict(skeleton.tips)
    for joint, parent in enumerate(skeleton.parents):
        above = fixed[parent] if parent >= 0 else Rotation.identity()
        local = Rotation.from_quat(clip.rotations[:, joint].numpy(), scalar_first=True)
        again = above.inv() * local * fixed[joint]
        turned.append(torch.from_numpy(again.as_quat(scalar_first=True)))
        offsets[joint] = above.inv().apply(offsets[joint])
        if names[joint] in tips:
            tips[names[joint]] = fixed[joint].inv().apply(tips[names[joint]])
    own = replace(skeleton, offsets=offsets, tips=tips)
    return replace(clip, rotations=torch.stack(turned, dim=1), skeleton=own)


def apart(one: Clip, other: Clip) -> dict[str, float]:
    """By joint: degrees between the two, on average over the frames."""
    angles = rotations.angle_between(forward_kinematics(one)[1], forward_kinematics(other)[1])
    return dict(zip(one.joint_names, np.degrees(angles.mean(0).numpy()).tolist(), strict=True))


@pytest.mark.parametrize("name", ["walk", "run", "turn_left"])
@pytest.mark.parametrize(
    ("limbs", "axis", "mirrored"),
    [
        (("legs",), (1, 0, 0), False),
        (("legs", "arms"), (1, 0, 0), True),
        (("legs", "arms"), (0, 1, 0), False),
        (("legs", "arms"), (0, 0, 1), False),
        (("legs",), (0, 0, -1), False),
        (("arms",), (0, 1, 0), False),
    ],
)
def test_frames_along_the_bones_make_no_difference(
    name: str, limbs: tuple[str, ...], axis: tuple[int, ...], mirrored: bool
) -> None:
    clip = of_the_humanoid(name)
    turned = along_bones(clip, limbs, np.array(axis, dtype=float), mirrored)
    places, same = (forward_kinematics(c)[0] for c in (clip, turned))
    torch.testing.assert_close(places, same)  # every joint of every frame is where it was
    plain, usually = as_usual(name)
    found, report = retarget(turned, humanoid())
    assert usually.no_stance == ()
    assert set(report.no_stance) >= set(limbs)
    angles = apart(plain, found)
    assert max(angles.values()) < 15.0, angles


@pytest.mark.parametrize("name", ["walk", "run", "turn_left"])
@pytest.mark.parametrize("what", ["all", "all but root", "root", "chest", "neck", "root backwards"])
def test_frames_of_the_trunk_make_no_difference(name: str, what: str) -> None:
    """Its bones were taken as the zero pose had them: heads and shoulders came out turned by up to 180 degrees."""
    clip = of_the_humanoid(name)
    pitched, back = Rotation.from_euler("y", 1.7), Rotation.from_euler("z", np.pi)
    fixed = [Rotation.identity()] * len(clip.joint_names)
    for joint, own in enumerate(clip.joint_names):
        if what.startswith("all") and (joint or what == "all"):
            fixed[joint] = Rotation.from_quat(np.random.default_rng(7 + joint).normal(size=4))
        elif own == what.split()[0] or (joint == 0 and what.startswith("root")):
            fixed[joint] = back if what == "root backwards" else pitched
    assert any(turn.magnitude() > 0 for turn in fixed)
    turned = with_frames(clip, fixed)
    torch.testing.assert_close(*(forward_kinematics(c)[0] for c in (clip, turned)))
    found, report = retarget(turned, humanoid())
    assert {"trunk", "head"} & set(report.no_stance)
    angles = apart(as_usual(name)[0], found)
    assert max(angles.values()) < 15.0, angles


@needs_cases
@pytest.mark.parametrize("case", ["x", "legs"])
def test_reported_cases(case: str) -> None:
    folder, options = CASES / f"retarget-zero-pose-is-no-stance-{case}", ReadOptions("cm", "y")
    (one, _), (other, report) = (
        retarget(read_clip(folder / f"{file}.bvh", REGISTRY, options), humanoid())
        for file in ("reference", "input")
    )
    assert max(apart(one, other).values()) < 10.0
    assert "legs" in report.no_stance


@pytest.mark.parametrize(
    "name", ["walk", "run", "hop", "turn_left", "sit", "cartwheel", "backflip"]
)
def test_a_stance_is_left_as_it_is(name: str) -> None:
    clip = library.find(name, REGISTRY)
    assert clip.skeleton is not None
    again, limbs = standing(clip, find_parts(clip.skeleton, {}, name))
    assert (again is clip, limbs) == (True, ())


@pytest.mark.parametrize("name", ["walk", "run", "turn_left"])
@pytest.mark.parametrize("pitch", [-80, -45, -30, -20, 30, 45, 60, 80])
def test_pitched_feet_make_no_difference(name: str, pitch: int) -> None:
    """Toes that point up or down in the zero pose came out so in every frame."""
    clip = of_the_humanoid(name)
    turn = Rotation.from_euler("y", pitch, degrees=True)
    turned = with_frames(
        clip, [turn if "ankle" in own else Rotation.identity() for own in clip.joint_names]
    )
    torch.testing.assert_close(*(forward_kinematics(c)[0] for c in (clip, turned)))
    found, report = retarget(turned, humanoid())
    assert {"legs", "feet"} & set(report.no_stance)
    angles = apart(as_usual(name)[0], found)
    assert max(angles.values()) < 10.0, angles


@pytest.mark.parametrize("name", ["walk", "run"])
@pytest.mark.parametrize(
    ("joints", "turn", "limb"),
    [
        (("left_ankle", "right_ankle"), (90, 0, 0), "feet"),
        (("left_ankle",), (90, 0, 0), "feet"),
        (("left_ankle",), (-60, 20, 50), "feet"),
        (("right_ankle",), (0, 0, 90), "legs"),
        (("left_elbow", "right_elbow"), (0, 0, 120), "arms"),
        (("right_elbow",), (0, -70, 0), ""),  # which may be a stance
        (("left_shoulder", "left_elbow"), (0, 0, 170), "arms"),
        (("left_hip", "left_knee", "left_ankle"), (90, 0, 90), "legs"),
        (("left_knee", "left_ankle"), (0, 0, 180), "legs"),
        (("root", "chest", "neck"), (0, 90, 0), "arms"),
    ],
)
def test_frames_of_some_joints_make_no_difference(
    name: str, joints: tuple[str, ...], turn: tuple[int, ...], limb: str
) -> None:
    """Feet were rolled by 90 degrees, and a forearm that is rolled in the zero pose turned the upper arm by up to 45."""
    clip = of_the_humanoid(name)
    own = Rotation.from_euler("xyz", turn, degrees=True)
    turned = with_frames(
        clip, [own if joint in joints else Rotation.identity() for joint in clip.joint_names]
    )
    torch.testing.assert_close(*(forward_kinematics(c)[0] for c in (clip, turned)))
    found, report = retarget(turned, humanoid())
    assert not limb or limb in report.no_stance
    angles = apart(as_usual(name)[0], found)
    assert max(angles.values()) < 15.0, angles


@needs_data
@pytest.mark.parametrize(
    "name", ["humanoid3d_roll", "humanoid3d_spinkick", "humanoid3d_crawl", "02_01"]
)
def test_recorded_stances_are_left_as_they_are(name: str) -> None:
    clip = library.find(name, REGISTRY)
    assert clip.skeleton is not None
    again, limbs = standing(clip, find_parts(clip.skeleton, {}, name))
    assert (again is clip, limbs) == (True, ())
