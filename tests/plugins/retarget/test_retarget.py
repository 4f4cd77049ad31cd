"""Motions on characters: what must not depend on how the source's skeleton is made, and real clips."""

from __future__ import annotations

import functools
import importlib.util
import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from motion_files import walker
from robots import robot_xml
from worlds import all_plugins

from understudy.errors import ConfigError, FileError
from understudy_characters.character import Character, load_character
from understudy_humanoid.character import build_spec
from understudy_motion.clip import Clip, Skeleton, cycle_transform
from understudy_motion.kinematics import forward_kinematics
from understudy_motion.readers.smpl import BODY
from understudy_motion.reading import ReadOptions, read_clip
from understudy_motion.writers.bvh import BvhWriter
from understudy_retarget.anatomy import path_up
from understudy_retarget.retarget import Options, Report, retarget
from understudy_tensors import rotations

REGISTRY = all_plugins().registry
DATA = Path(os.environ.get("UNDERSTUDY_DATA", "nowhere")) / "motions"
CMU = DATA / "cmu"
needs_data = pytest.mark.skipif(not CMU.is_dir(), reason="no real clips (UNDERSTUDY_DATA)")
SIDES = (("left", 1.0), ("right", -1.0))
FORWARD, LEFT = torch.eye(3, dtype=torch.float64)[:2]


def clip_named(name: str) -> Clip:
    return REGISTRY.find("clip", name).factory()


@pytest.fixture(scope="module")
def walk(humanoid: Character) -> Clip:
    """The generated walk on the humanoid's own skeleton, hands and toes included."""
    walk = clip_named("walk")
    return humanoid.clip(humanoid.qpos(walk), walk.times, name="walk", loop=True)


@pytest.fixture(scope="module")
def plain(walk: Clip, humanoid: Character) -> tuple[Clip, Report]:
    """That walk, retargeted."""
    return retarget(walk, humanoid)


def reposed(clip: Clip, turns: dict[str, torch.Tensor]) -> Clip:
    """The same motion, recorded on a skeleton whose zero pose has these joints turned by (4,), and
    all that hangs on them along with them."""
    skeleton = clip.skeleton
    assert skeleton is not None
    identity = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    turned: list[torch.Tensor] = []
    offsets = torch.from_numpy(skeleton.offsets.copy())
    rotation = clip.rotations.clone()
    for joint, (name, parent) in enumerate(
        zip(skeleton.joint_names, skeleton.parents, strict=True)
    ):
        above = turned[parent] if parent >= 0 else identity
        turned.append(rotations.multiply(above, turns.get(name, identity)))
        offsets[joint] = rotations.rotate(above, offsets[joint])
        undone = rotations.multiply(rotation[:, joint], rotations.conjugate(turned[joint]))
        rotation[:, joint] = rotations.multiply(above, undone)
    tips = {
        name: rotations.rotate(
            turned[skeleton.joint_names.index(name)], torch.from_numpy(tip)
        ).numpy()
        for name, tip in skeleton.tips.items()
    }
    posed = Skeleton(skeleton.joint_names, skeleton.parents, offsets.numpy(), tips)
    return replace(clip, rotations=rotation, skeleton=posed)


def about(axis: torch.Tensor, angle: float) -> torch.Tensor:
    return rotations.from_axis_angle(axis, torch.tensor(angle, dtype=torch.float64))


def furthest(one: Clip, other: Clip, joints: tuple[str, ...] = ()) -> float:
    """m: how far joints of the two are apart at most, on the same skeleton."""
    apart = forward_kinematics(one)[0] - forward_kinematics(other)[0]
    chosen = [one.joint_names.index(name) for name in joints or one.joint_names]
    return float(torch.linalg.vector_norm(apart[:, chosen], dim=-1).max())


# ---------------------------------------------------------------------- laws


def test_on_its_own_skeleton_a_sound_motion_stays(walk: Clip, plain: tuple[Clip, Report]) -> None:
    result, report = plain
    assert report.scale == pytest.approx(1.0)
    assert report.mean_error < 0.005
    assert furthest(result, walk) < 0.05
    assert result.loop
    assert result.num_frames == walk.num_frames


def test_a_reposed_clip_is_the_same_motion(walk: Clip) -> None:
    turns = {f"{side}_shoulder": about(FORWARD, sign * 1.57) for side, sign in SIDES}
    other = reposed(walk, turns)
    assert furthest(other, walk) < 1e-9
    assert abs(other.skeleton.offsets[other.joint_names.index("left_elbow")][1]) > 0.2


@pytest.mark.parametrize(
    "pose",
    [
        {f"{side}_shoulder": about(FORWARD, sign * 1.57) for side, sign in SIDES},
        {f"{side}_shoulder": about(FORWARD, sign * 0.8) for side, sign in SIDES},
        {f"{side}_hip": about(FORWARD, sign * 0.35) for side, sign in SIDES},
        {f"{side}_shoulder": about(LEFT, -0.5) for side, _ in SIDES},
    ],
    ids=["T-pose", "A-pose", "legs apart", "arms ahead"],
)
def test_the_zero_pose_of_the_source_does_not_matter(
    walk: Clip, plain: tuple[Clip, Report], humanoid: Character, pose: dict[str, torch.Tensor]
) -> None:
    result, _ = retarget(reposed(walk, pose), humanoid)
    assert furthest(result, plain[0]) < 0.005
    assert rotations.angle_between(result.rotations, plain[0].rotations).max() < 0.1


@functools.cache
def _walking() -> tuple[Character, Clip, Clip]:
    """The humanoid, a walk, and that walk on it."""
    humanoid = Character("humanoid", build_spec().compile())
    walk = clip_named("walk")
    return humanoid, walk, retarget(walk, humanoid)[0]


@settings(max_examples=5, deadline=None)
@given(
    st.floats(-math.pi, math.pi), st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.floats(-1.0, 1.0)
)
def test_place_heading_and_floor_do_not_matter(
    heading: float, x: float, y: float, floor: float
) -> None:
    humanoid, walk, plain = _walking()
    turn = about(torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64), heading)
    moved = replace(
        walk,
        root_position=rotations.rotate(turn, walk.root_position)
        + torch.tensor([x, y, floor], dtype=torch.float64),
        rotations=torch.cat(
            (rotations.multiply(turn, walk.rotations[:, :1]), walk.rotations[:, 1:]), dim=1
        ),
    )
    result = retarget(moved, humanoid)[0]
    shift = torch.tensor([x, y, 0.0], dtype=torch.float64)
    expected = rotations.rotate(turn, plain.root_position) + shift
    assert (result.root_position - expected).abs().max() < 0.002
    assert rotations.angle_between(result.rotations[:, 1:], plain.rotations[:, 1:]).max() < 0.02


@pytest.mark.parametrize("size", [0.5, 1.8])
def test_a_smaller_or_larger_figure_makes_the_same_poses(
    walk: Clip, plain: tuple[Clip, Report], humanoid: Character, size: float
) -> None:
    skeleton = walk.skeleton
    assert skeleton is not None
    scaled = replace(
        walk,
        root_position=size * walk.root_position,
        skeleton=Skeleton(
            skeleton.joint_names, skeleton.parents, size * skeleton.offsets,
            {name: size * tip for name, tip in skeleton.tips.items()},
        ),
    )  # fmt: skip
    result, report = retarget(scaled, humanoid)
    assert report.scale == pytest.approx(1.0 / size)
    assert furthest(result, plain[0]) < 1e-6


def test_joints_are_found_by_name_not_by_place(
    walk: Clip, plain: tuple[Clip, Report], humanoid: Character
) -> None:
    skeleton = walk.skeleton
    assert skeleton is not None
    joints = range(len(skeleton.joint_names))
    order = sorted(joints, key=lambda joint: (len(list(path_up(skeleton, joint))), -joint))
    assert order != list(joints)
    names = tuple(skeleton.joint_names[j] for j in order)
    parents = tuple(
        order.index(skeleton.parents[j]) if skeleton.parents[j] >= 0 else -1 for j in order
    )
    shuffled = replace(
        walk, joint_names=names, rotations=walk.rotations[:, order],
        skeleton=Skeleton(names, parents, skeleton.offsets[order], skeleton.tips),
    )  # fmt: skip
    assert furthest(retarget(shuffled, humanoid)[0], plain[0]) < 1e-6


def test_a_loop_stays_one(walk: Clip, plain: tuple[Clip, Report]) -> None:
    result, _ = plain
    before, after = cycle_transform(walk), cycle_transform(result)
    torch.testing.assert_close(after.displacement, before.displacement, atol=0.005, rtol=0)
    assert after.heading == pytest.approx(before.heading, abs=0.005)
    assert torch.equal(result.rotations[0, 1:], result.rotations[-1, 1:])
    assert (result.root_position[0, 2] - result.root_position[-1, 2]).abs() < 1e-3
    up = rotations.tangent_normal(result.rotations[[0, -1], 0])[:, 5]
    assert (up[0] - up[1]).abs() < 1e-3


@pytest.mark.parametrize(
    "name", ["walk", "run", "hop", "turn_left", "sit", "cartwheel", "backflip"]
)
def test_generated_motions_on_the_jumper(name: str) -> None:
    jumper = load_character("jumper", REGISTRY)
    clip = clip_named(name)
    result, report = retarget(clip, jumper)
    assert report.mean_error < 0.02
    assert report.penetration < 0.01
    assert report.skate < 0.01
    assert report.speed[0] < 1.3 * report.source_speed[0] + 3.0
    knees = jumper.qpos(result)[:, [jumper.model.joint(f"{s}_knee").qposadr[0] for s, _ in SIDES]]
    assert knees.min() > -1e-6, "knees bend forward"


# ---------------------------------------------------------------------- other skeletons and files


def smpl_walk(path: Path, frames: int = 90) -> Path:
    """A file as AMASS has them: arms hanging from the T-pose, legs striding on the spot."""
    times = np.arange(frames) / 60.0
    poses = np.zeros((frames, len(BODY), 3))
    row = BODY.index
    stride = 0.4 * np.sin(2 * np.pi * times)
    poses[:, 0, 0] = np.pi / 2  # the body has y up, the world z
    poses[:, row("left_hip"), 0], poses[:, row("right_hip"), 0] = -stride, stride
    poses[:, row("left_knee"), 0] = poses[:, row("right_knee"), 0] = 0.5
    poses[:, row("left_shoulder"), 2], poses[:, row("right_shoulder"), 2] = -1.3, 1.3
    poses[:, row("left_elbow"), 1], poses[:, row("right_elbow"), 1] = -0.8, 0.8
    trans = np.tile([0.0, 0.0, 0.9], (frames, 1))
    np.savez(path, poses=poses.reshape(frames, -1), trans=trans, mocap_framerate=60.0)
    return path


@pytest.mark.parametrize("name", ["humanoid", "jumper"])
def test_smpl_in_its_t_pose_gets_the_right_arms(tmp_path: Path, name: str) -> None:
    clip = read_clip(smpl_walk(tmp_path / "smpl.npz"), REGISTRY)
    character = load_character(name, REGISTRY)
    result, report = retarget(clip, character)
    positions, _ = forward_kinematics(result)

    def joint(of: str) -> torch.Tensor:
        return positions[:, result.joint_names.index(of)]

    facing = rotations.rotate(result.rotations[:, 0], FORWARD)
    for side, sign in SIDES:
        upper = joint(f"{side}_elbow") - joint(f"{side}_shoulder")
        assert (upper[:, 2] < -0.85 * torch.linalg.vector_norm(upper, dim=1)).all(), "it hangs"
        across = torch.linalg.cross(torch.eye(3).double()[2].expand_as(facing), facing)
        assert (sign * (joint(f"{side}_elbow") * across).sum(-1) > 0).all()
    bent = character.qpos(result)[:, character.model.joint("left_elbow").qposadr[0]]
    assert torch.allclose(bent, torch.full_like(bent, 0.8), atol=0.1)
    assert report.mean_error < 0.02


def test_bvh_of_another_convention(tmp_path: Path, walk: Clip) -> None:
    """Mixamo's names, centimetres, y up, a T-pose, and a skeleton half again as tall."""
    skeleton = walk.skeleton
    assert skeleton is not None
    tall = replace(
        walk, root_position=1.5 * walk.root_position,
        skeleton=Skeleton(skeleton.joint_names, skeleton.parents, 1.5 * skeleton.offsets,
                          {name: 1.5 * tip for name, tip in skeleton.tips.items()}),
    )  # fmt: skip
    pose = {f"{side}_shoulder": about(FORWARD, sign * 1.57) for side, sign in SIDES}
    posed = reposed(tall, pose)
    words = {"root": "Hips", "chest": "Spine2", "neck": "Head", "hip": "UpLeg", "knee": "Leg",
             "ankle": "Foot", "shoulder": "Arm", "elbow": "ForeArm"}  # fmt: skip

    def renamed(name: str) -> str:
        side, _, part = name.rpartition("_")
        return f"mixamorig:{side.title()}{words[part]}"

    names = tuple(renamed(name) for name in posed.joint_names)
    assert posed.skeleton is not None
    tips = {renamed(name): tip for name, tip in posed.skeleton.tips.items()}
    BvhWriter().write(
        replace(
            posed, joint_names=names, loop=False,
            skeleton=replace(posed.skeleton, joint_names=names, tips=tips),
        ),
        tmp_path / "mixamo.bvh",
    )  # fmt: skip
    clip = read_clip(tmp_path / "mixamo.bvh", REGISTRY, ReadOptions(unit="cm", up="y"))
    for name in ("humanoid", "jumper"):
        character = load_character(name, REGISTRY)
        result, report = retarget(clip, character)
        assert report.scale == pytest.approx(1 / 1.5, rel=1e-4)
        expected, _ = retarget(replace(walk, loop=False), character)
        assert furthest(result, expected) < 0.01


def test_gymnasiums_humanoid() -> None:
    """Several hinges a body, a torso for a root, feet that are part of the shins."""
    pytest.importorskip("gymnasium")
    found = importlib.util.find_spec("gymnasium")
    assert found is not None
    assert found.origin is not None
    file = Path(found.origin).parent / "envs" / "mujoco" / "assets" / "humanoid.xml"
    robot = load_character(str(file), REGISTRY)
    source = CMU / "02_01.amc"
    clip = read_clip(source, REGISTRY) if source.is_file() else clip_named("walk")
    result, report = retarget(clip, robot)
    assert report.mean_error < 0.025
    assert report.penetration < 0.01
    assert report.skate < 0.02
    assert report.speed[0] < 1.5 * report.source_speed[0]
    qpos = robot.qpos(result)
    for joint in range(robot.model.njnt):
        if robot.model.jnt_limited[joint]:
            angle = qpos[:, robot.model.jnt_qposadr[joint]]
            low, high = robot.model.jnt_range[joint]
            assert angle.min() > low - 1e-6
            assert angle.max() < high + 1e-6


@pytest.mark.slow
@needs_data
def test_a_robot_with_meshes() -> None:
    """Unitree's G1, from the wheel of mjlab unpacked into $UNDERSTUDY_G1."""
    file = Path(os.environ.get("UNDERSTUDY_G1", "nowhere"))
    if not file.is_file():
        pytest.skip("no model of the robot: UNDERSTUDY_G1 names no g1.xml")
    _, report = retarget(
        read_clip(CMU / "02_01.amc", REGISTRY), load_character(str(file), REGISTRY)
    )
    assert report.mean_error < 0.025
    assert report.penetration < 0.01
    assert report.skate < 0.02
    assert report.speed[0] < 1.5 * report.source_speed[0]


# ---------------------------------------------------------------------- real clips


@needs_data
def test_a_recorded_walk_on_the_humanoid(humanoid: Character) -> None:
    clip = read_clip(CMU / "02_01.amc", REGISTRY)
    result, report = retarget(clip, humanoid)
    assert report.mean_error < 0.02
    assert all(mean < 0.02 for mean, _ in report.errors.values())
    assert report.worst_error < 0.06
    assert report.penetration < 0.01
    assert report.skate < 0.01
    assert 0.5 < report.contact_share < 0.7
    assert report.speed[0] < report.source_speed[0]
    qpos = humanoid.qpos(result)
    for side, _ in SIDES:
        knee = qpos[:, humanoid.model.joint(f"{side}_knee").qposadr[0]]
        assert knee.min() > -1e-6
        assert 0.5 < knee.max() < 1.5
    travel = clip.root_position[-1, :2] - clip.root_position[0, :2]
    moved = result.root_position[-1, :2] - result.root_position[0, :2]
    assert torch.allclose(moved, report.scale * travel, atol=0.03)


@needs_data
@pytest.mark.parametrize("name", ["humanoid", "jumper"])
@pytest.mark.parametrize("file", sorted(p.name for p in CMU.glob("*.amc")))
@pytest.mark.slow
def test_every_recorded_clip(file: str, name: str) -> None:
    _, report = retarget(read_clip(CMU / file, REGISTRY), load_character(name, REGISTRY))
    assert report.mean_error < 0.02
    assert report.penetration < 0.01
    assert report.skate < 0.01


# ---------------------------------------------------------------------- errors


def test_a_missing_part_is_asked_for(
    walk: Clip, plain: tuple[Clip, Report], humanoid: Character
) -> None:
    skeleton = walk.skeleton
    assert skeleton is not None
    names = tuple(name.replace("left_elbow", "thing") for name in walk.joint_names)
    tips = {name.replace("left_elbow", "thing"): tip for name, tip in skeleton.tips.items()}
    odd = replace(
        walk, joint_names=names,
        skeleton=Skeleton(names, skeleton.parents, skeleton.offsets, tips),
    )  # fmt: skip
    result, _ = retarget(odd, humanoid, Options(map={"left_elbow": "thing"}))
    assert furthest(result, plain[0]) < 1e-6
    short = replace(odd.skeleton, offsets=np.where(np.array(names)[:, None] == "thing", 0.0, skeleton.offsets))  # fmt: skip
    with pytest.raises(ConfigError, match="left_upper_arm has no length"):
        retarget(replace(odd, skeleton=short), humanoid, Options(map={"left_elbow": "thing"}))


@pytest.mark.parametrize(
    ("names", "reason"),
    [
        ({"left_knee": "nothing"}, "no joint 'nothing'"),
        ({"left_kneee": "left_knee"}, "Did you mean 'left_knee'"),
    ],
)
def test_joints_that_do_not_exist(
    walk: Clip, humanoid: Character, names: dict[str, str], reason: str
) -> None:
    with pytest.raises(ConfigError, match=reason):
        retarget(walk, humanoid, Options(map=names))


def test_a_figure_without_arms_is_refused_by_name() -> None:
    with pytest.raises(ConfigError, match=r"recognised as the .*--map"):
        retarget(walker(), load_character("humanoid", REGISTRY))


def test_of_legs_in_part_recognised_the_missing_is_named(walk: Clip, tmp_path: Path) -> None:
    text = robot_xml()
    (tmp_path / "robot.xml").write_text(text.replace('name="left_foot"', 'name="b7"', 1))
    character = load_character(str(tmp_path / "robot.xml"), REGISTRY)
    with pytest.raises(ConfigError, match=r"legs are not recognised \(missing: left_ankle\)"):
        retarget(walk, character, Options())


def test_a_clip_without_a_skeleton(walk: Clip, humanoid: Character) -> None:
    with pytest.raises(FileError, match="has no skeleton"):
        retarget(replace(walk, skeleton=None), humanoid)


@pytest.mark.parametrize("scale", [0.0, -1.0, math.nan, math.inf])
def test_impossible_scales(scale: float) -> None:
    with pytest.raises(ConfigError, match="--scale"):
        Options(scale=scale)


def test_a_given_scale_is_the_travels(walk: Clip, humanoid: Character) -> None:
    result, report = retarget(walk, humanoid, Options(scale=0.9))
    assert report.scale == 0.9
    displacement = cycle_transform(result).displacement
    assert torch.allclose(displacement, 0.9 * cycle_transform(walk).displacement, atol=0.005)
