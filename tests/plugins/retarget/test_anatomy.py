"""Parts of the body by the names that tools, databases and robots give their joints, and by shape."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from understudy.errors import ConfigError
from understudy_characters.character import Character
from understudy_humanoid.character import build_spec
from understudy_motion.clip import Skeleton
from understudy_motion.readers.smpl import BODY, OFFSETS
from understudy_retarget.anatomy import SIDES, Parts, describe, find_parts

LIMBS = ("hip", "knee", "ankle", "toe", "shoulder", "elbow", "wrist")
#: By convention: clavicle, the parts of LIMBS, and head, with {S} the side as in "left" or "l".
CONVENTIONS = {
    "cmu": ("{s}clavicle {s}femur {s}tibia {s}foot {s}toes {s}humerus {s}radius {s}wrist", "head"),
    "mixamo": (
        "mixamorig:{Side}Shoulder mixamorig:{Side}UpLeg mixamorig:{Side}Leg mixamorig:{Side}Foot "
        "mixamorig:{Side}ToeBase mixamorig:{Side}Arm mixamorig:{Side}ForeArm mixamorig:{Side}Hand",
        "mixamorig:Head",
    ),
    "bvh": (
        "{Side}Collar {Side}Hip {Side}Knee {Side}Ankle {Side}Toe {Side}Shoulder {Side}Elbow {Side}Wrist",
        "Head",
    ),
    "biped": (
        "Bip01_{S}_Clavicle Bip01_{S}_Thigh Bip01_{S}_Calf Bip01_{S}_Foot Bip01_{S}_Toe0 "
        "Bip01_{S}_UpperArm Bip01_{S}_Forearm Bip01_{S}_Hand",
        "Bip01_Head",
    ),
    "smpl": (
        "{side}_collar {side}_hip {side}_knee {side}_ankle {side}_foot {side}_shoulder {side}_elbow "
        "{side}_wrist",
        "head",
    ),
    "mujoco": (
        "{side}_clavicle {side}_thigh {side}_shin {side}_foot {side}_toes {side}_upper_arm "
        "{side}_lower_arm {side}_hand",
        "head",
    ),
    "robot": (
        "{side}_collar_link {side}_hip_pitch_link {side}_knee_link {side}_ankle_pitch_link "
        "{side}_toe_link {side}_shoulder_pitch_link {side}_elbow_link {side}_wrist_roll_link",
        "head_link",
    ),
    "blender": (
        "clavicle.{S} thigh.{S} shin.{S} foot.{S} toe.{S} upper_arm.{S} forearm.{S} hand.{S}",
        "skull",
    ),
}


#: By clavicle and LIMBS: what it hangs on (a row of this table, or "root" or "trunk"), and how far
#: to the side and up.
PLACES = [("trunk", 0.1, 0.2), ("root", 0.1, -0.1), (1, 0, -0.4), (2, 0, -0.4), (3, 0, -0.05), (0, 0.1, 0), (5, 0.25, 0), (6, 0.25, 0)]  # fmt: skip


def words(convention: str, side: str) -> list[str]:
    sided, _ = CONVENTIONS[convention]
    return sided.format(side=side, Side=side.title(), s=side[0], S=side[0].upper()).split()


def skeleton(convention: str) -> Skeleton:
    names = ["root", "trunk", CONVENTIONS[convention][1]]
    parents, offsets = [-1, 0, 1], [[0, 0, 0], [0, 0, 0.3], [0, 0, 0.3]]
    for side, sign in (("left", 1), ("right", -1)):
        named = words(convention, side)
        for above, across, up in PLACES:
            parents.append(names.index(above if isinstance(above, str) else named[above]))
            names.append(named[(len(names) - 3) % 8])
            offsets.append([0, sign * across, up])
    return Skeleton(tuple(names), tuple(parents), np.array(offsets, dtype=float))


def joints(skeleton: Skeleton, parts: Parts) -> dict[str, str]:
    return {part: skeleton.joint_names[chain[0]] for part, chain in parts.items()}


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_parts_by_name(convention: str) -> None:
    figure = skeleton(convention)
    found = joints(figure, find_parts(figure, {}, "It"))
    for side in SIDES:
        assert [found[f"{side}_{part}"] for part in LIMBS] == words(convention, side)[1:]
    head = CONVENTIONS[convention][1]
    assert (found["head"], found["pelvis"], found["chest"]) == (head, "root", "trunk")


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_the_order_of_joints_does_not_count(convention: str) -> None:
    figure = skeleton(convention)
    order = [0, 1, *range(11, 19), *range(3, 11), 2]
    other = Skeleton(
        tuple(figure.joint_names[joint] for joint in order),
        tuple(order.index(p) if (p := figure.parents[joint]) >= 0 else -1 for joint in order),
        figure.offsets[order],
    )
    assert joints(other, find_parts(other, {}, "It")) == joints(
        figure, find_parts(figure, {}, "It")
    )


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("LHipJoint", ("left", "hip")),
        ("lfemur", ("left", "femur")),
        ("LeftUpLeg", ("left", "upleg")),
        ("mixamorig:RightToeBase", ("right", "toebase")),
        ("m_avg_R_Wrist", ("right", "wrist")),
        ("left_hip_yaw_link", ("left", "hip")),
        ("head", ("", "head")),
        ("lowerback", ("", "lowerback")),
        ("radius", ("", "radius")),
        ("Spine2", ("", "spine")),
    ],
)
def test_names_are_described(name: str, expected: tuple[str, str]) -> None:
    assert describe(name) == expected


def test_a_chain_of_hinges_is_one_part() -> None:
    names = ("pelvis", "left_hip_pitch_link", "left_hip_roll_link", "left_hip_yaw_link", "left_knee_link",
             "right_hip_pitch_link", "right_hip_roll_link", "right_hip_yaw_link", "right_knee_link")  # fmt: skip
    parents = (-1, 0, 1, 2, 3, 0, 5, 6, 7)
    offsets = np.array(
        [[0, 0, 0]] + 2 * [[0, 0.1, 0], [0, 0, 0], [0, 0, 0], [0, 0, -0.4]], dtype=float
    )
    parts = find_parts(Skeleton(names, parents, offsets), {}, "Robot")
    assert parts["left_hip"] == (1, 2, 3)
    assert parts["right_knee"] == (8,)


def test_parts_by_shape_where_names_say_nothing() -> None:
    known = Character("humanoid", build_spec().compile()).skeleton
    names = tuple(f"joint{index}" for index in range(len(known.joint_names)))
    tips = {names[known.joint_names.index(name)]: tip for name, tip in known.tips.items()}
    nameless = replace(known, joint_names=names, tips=tips)
    expected = find_parts(known, {}, "It")
    found = find_parts(nameless, {}, "It")
    for part in expected:
        if part != "head":  # which has no pair
            assert found[part] == expected[part], part


def test_smpl_by_shape() -> None:
    """A figure with clavicles and a spine of many joints."""
    parents, offsets = [-1], [np.zeros(3)]
    for name in BODY[1:]:
        side, _, part = name.rpartition("_")
        parent, (left, up, ahead) = OFFSETS[part if side else name]
        parents.append(BODY.index(f"{side}_{parent}" if f"{side}_{parent}" in BODY else parent))
        offsets.append(np.array([ahead, -left if side == "right" else left, up]))
    names = tuple(f"b{index}c" for index in range(len(BODY)))
    found = find_parts(Skeleton(names, tuple(parents), np.array(offsets)), {}, "It")
    for part in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist"):
        for side in SIDES:
            assert found[f"{side}_{part}"] == (BODY.index(f"{side}_{part}"),)


def test_what_the_user_says_counts() -> None:
    figure = skeleton("cmu")
    lfoot, ltoes = (figure.joint_names.index(name) for name in ("lfoot", "ltoes"))
    parts = find_parts(figure, {"left_ankle": ltoes}, "It")
    assert parts["left_ankle"] == (ltoes,)
    assert "left_toe" not in parts
    assert all(lfoot not in chain for chain in parts.values())


def test_an_ambiguous_part_is_asked_for() -> None:
    figure = skeleton("cmu")
    twins = Skeleton(
        (*figure.joint_names, "l_tibia"), (*figure.parents, figure.joint_names.index("lfemur")),
        np.vstack((figure.offsets, [0, 0, -0.4])),
    )  # fmt: skip
    with pytest.raises(ConfigError, match=r"left_knee may be 'ltibia' or 'l_tibia'.*--map"):
        find_parts(twins, {}, "Clip x")
    settled = find_parts(twins, {"left_knee": twins.joint_names.index("ltibia")}, "Clip x")
    assert settled["left_ankle"] == (twins.joint_names.index("lfoot"),)
