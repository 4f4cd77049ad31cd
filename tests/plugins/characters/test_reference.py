"""Reference tables: consistent velocities, seamless loops, faithful to the clip."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import mujoco
import pytest
import torch
from torch import Tensor

from understudy.errors import ConfigError, FileError
from understudy.inputs import Inputs
from understudy.setup.registry import Component, Registry
from understudy.task import Context
from understudy_characters import reference as module
from understudy_characters.character import Character
from understudy_characters.initial_states import reference_states
from understudy_characters.layout import Layout, layout_of
from understudy_characters.reference import ReferenceMotion
from understudy_characters.scene import CharacterScene, reference_motion
from understudy_humanoid.character import build_spec
from understudy_humanoid.clips import generated_walk
from understudy_motion import library
from understudy_motion.clip import Clip
from understudy_motion.readers import deepmimic
from understudy_motion.section import Motion, MotionOptions
from understudy_tensors import rotations

DT = 1 / 30


@pytest.fixture(scope="module")
def character() -> Character:
    return Character("humanoid", build_spec().compile())


@pytest.fixture(scope="module")
def layout(character: Character) -> Layout:
    return layout_of(character)


def turning(turn: float) -> Clip:
    """The walk on an arc: `turn` rad further left after every cycle."""
    clip = generated_walk()
    yaw = turn * clip.times / clip.duration
    pose = clip.rotations.clone()
    pose[:, 0] = rotations.multiply(rotations.from_heading(yaw), pose[:, 0])
    radius = clip.root_position[-1, 0] / turn
    _, y, z = clip.root_position.unbind(1)
    centre = radius - y
    place = torch.stack((centre * yaw.sin(), radius - centre * yaw.cos(), z), dim=1)
    return replace(clip, rotations=pose, root_position=place)


def test_a_clip_that_is_too_long_to_be_followed_is_refused(
    character: Character, layout: Layout, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its table would have filled the memory."""
    monkeypatch.setattr(module, "MAX_ROTATIONS", 13 * 4 * 30)
    with pytest.raises(
        FileError,
        match=r"lasts 1\.05 s, and at control\.frequency=30 this figure follows at most 1\. Cut it",
    ):
        ReferenceMotion(generated_walk(), character, layout, control_dt=DT)


def somersault() -> Clip:
    """The walk with one whole turn about y: the root's quaternion ends as minus itself."""
    clip = generated_walk()
    pitch = 2.0 * math.pi * clip.times / clip.duration
    over = rotations.from_axis_angle(torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64), pitch)
    pose = clip.rotations.clone()
    pose[:, 0] = rotations.multiply(over, pose[:, 0])
    return replace(clip, rotations=pose)


CLIPS = {"walk": generated_walk, "arc": lambda: turning(0.5), "somersault": somersault}


@pytest.fixture(params=CLIPS)
def reference(
    request: pytest.FixtureRequest, character: Character, layout: Layout
) -> ReferenceMotion:
    return ReferenceMotion(CLIPS[request.param](), character, layout, control_dt=DT)


def test_the_same_content_is_tabulated_once(monkeypatch: pytest.MonkeyPatch) -> None:
    tabulated = []
    computed = ReferenceMotion._tabulate
    monkeypatch.setattr(
        ReferenceMotion, "_tabulate", lambda *given: tabulated.append(1) or computed(*given)
    )
    clip = replace(generated_walk(), name="tabulated once")
    clip.root_position[:, 2] += 0.125

    def reference(spec: mujoco.MjSpec, clip: Clip, dt: float = DT) -> ReferenceMotion:
        own = Character("humanoid", spec.compile())
        return ReferenceMotion(clip, own, layout_of(own), control_dt=dt)

    first = reference(build_spec(), clip)
    again = reference(build_spec(), replace(clip, name="another name"))
    assert len(tabulated) == 1
    assert again.height_offset == first.height_offset
    times = torch.linspace(0.0, 1.0, 9)
    for name, value in first.sample(times).items():
        torch.testing.assert_close(again.sample(times)[name], value, atol=0.0, rtol=0.0)
    thicker = build_spec()
    thicker.geoms[-1].size *= 1.5
    higher = replace(clip, root_position=clip.root_position + 0.01)
    reference(thicker, clip)
    reference(build_spec(), higher)
    reference(build_spec(), clip, dt=2 * DT)
    reference(build_spec(), replace(clip, loop=False))
    assert len(tabulated) == 5


def test_no_more_tables_are_kept_than_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_tables", {})
    own = Character("humanoid", build_spec().compile())
    layout = layout_of(own)

    def kept(dt: float) -> int:
        ReferenceMotion(generated_walk(), own, layout, control_dt=dt)
        return len(module._tables)

    assert [kept(DT), kept(2 * DT), kept(DT)] == [1, 2, 2]
    monkeypatch.setattr(module, "_MOST", 1000)
    assert kept(4 * DT) == 1


def test_matches_the_clip(reference: ReferenceMotion, character: Character, layout: Layout) -> None:
    times = torch.rand(64, generator=torch.Generator().manual_seed(0)) * 7.0 * reference.duration
    expected = character.qpos(reference.clip, times)
    expected[:, 2] += reference.height_offset
    found = reference.sample(times)
    torch.testing.assert_close(
        found["reference_root_position"].double(), expected[:, :3], atol=2e-3, rtol=0.0
    )
    error = rotations.angle_between(found["reference_root_rotation"].double(), expected[:, 3:7])
    assert error.max() < 0.01
    hinge = layout.hinge_qpos
    assert (found["reference_qpos"][:, hinge] - expected[:, hinge]).abs().max() < 0.02
    assert ((found["phase"] >= 0.0) & (found["phase"] < 1.0)).all()


def test_nothing_jumps_at_the_seam(reference: ReferenceMotion) -> None:
    gap = 1e-4
    seams = torch.arange(1, 6) * reference.duration
    before, after = reference.sample(seams - gap), reference.sample(seams + gap)
    for name in before:
        if name.endswith("rotation") or name.endswith("rotations"):
            assert rotations.angle_between(before[name], after[name]).max() < 0.01, name
        elif name not in (
            "phase",
            "motion_ended",
            "reference_qpos",
            "reference_qvel",
            "reference_root_heading",
        ):
            assert (before[name] - after[name]).abs().max() < 0.01, name
    assert (before["reference_qvel"] - after["reference_qvel"]).abs().max() < 0.3


def test_velocities_integrate_to_positions(
    reference: ReferenceMotion, character: Character, layout: Layout
) -> None:
    steps = 400
    dt = 2.0 * reference.duration / steps
    fields = reference.sample(torch.linspace(0.0, 2.0 * reference.duration, steps + 1))
    qpos, qvel = fields["reference_qpos"].double(), fields["reference_qvel"].double()
    middle: Tensor = 0.5 * (qvel[1:] + qvel[:-1])
    state = qpos[0].numpy().copy()
    for velocity in middle.numpy():
        mujoco.mj_integratePos(character.model, state, velocity, dt)
    end = torch.from_numpy(state)
    assert (end[:3] - qpos[-1, :3]).abs().max() < 0.01
    assert rotations.angle_between(end[3:7], qpos[-1, 3:7]) < 0.02
    for start in layout.ball_qpos[:, 0].tolist():
        ball = slice(start, start + 4)
        assert rotations.angle_between(end[ball], qpos[-1, ball]) < 0.03
    assert (end[layout.hinge_qpos] - qpos[-1, layout.hinge_qpos]).abs().max() < 0.03


def test_a_clip_that_does_not_loop_ends_in_its_last_pose(
    character: Character, layout: Layout
) -> None:
    clip = replace(generated_walk(), loop=False)
    reference = ReferenceMotion(clip, character, layout, control_dt=DT)
    found = reference.sample(torch.tensor([clip.duration, clip.duration + 5.0, -1.0]))
    qpos = found["reference_qpos"]
    torch.testing.assert_close(qpos[1], qpos[0])
    assert qpos[1, 0].item() == pytest.approx(clip.root_position[-1, 0].item(), abs=1e-4)
    assert qpos[2, 0].item() == pytest.approx(0.0, abs=1e-5)
    assert found["phase"].max() < 1.0
    assert found["motion_ended"].tolist() == [True, True, False]


def test_a_looping_clip_never_ends(reference: ReferenceMotion) -> None:
    assert not reference.sample(torch.linspace(0.0, 100.0, 1001))["motion_ended"].any()


def test_states_fold_back_into_the_first_cycle(reference: ReferenceMotion) -> None:
    times = torch.tensor([0.3, 0.3 + reference.duration, 0.3 + 4.0 * reference.duration])
    fields = reference.sample(times)
    qpos, qvel, local = reference.to_first_cycle(
        fields["reference_qpos"], fields["reference_qvel"], times
    )
    torch.testing.assert_close(local, torch.full((3,), 0.3), atol=1e-5, rtol=0.0)
    torch.testing.assert_close(qpos[:, :3], qpos[:1, :3].expand(3, 3), atol=1e-4, rtol=0.0)
    assert rotations.angle_between(qpos[:, 3:7], qpos[:1, 3:7]).max() < 1e-3
    torch.testing.assert_close(qvel, qvel[:1].expand(3, -1), atol=1e-3, rtol=1e-3)


def test_grounding_puts_the_lowest_point_on_the_floor(character: Character, layout: Layout) -> None:
    clip = generated_walk()
    raised = replace(clip, root_position=clip.root_position + torch.tensor([0.0, 0.0, 0.3]))
    reference = ReferenceMotion(raised, character, layout, control_dt=DT)
    assert reference.height_offset == pytest.approx(-0.3, abs=0.002)


def test_one_deep_pose_does_not_raise_what_stands(character: Character, layout: Layout) -> None:
    """A walk of which a tenth of a second goes 10 cm into the floor."""
    clip = generated_walk()
    depth = torch.zeros_like(clip.root_position)
    depth[:, 2] = -0.1 * torch.exp(-(((clip.times - 0.5) / 0.03) ** 2))
    sunk = replace(clip, root_position=clip.root_position + depth)
    walk = ReferenceMotion(clip, character, layout, control_dt=DT)
    lowest = ReferenceMotion(sunk, character, layout, control_dt=DT)
    standing = ReferenceMotion(sunk, character, layout, control_dt=DT, floor="standing")
    assert lowest.height_offset > walk.height_offset + 0.08
    assert standing.height_offset == pytest.approx(walk.height_offset, abs=0.01)
    assert (walk.sinks, lowest.sinks, standing.sinks) == (False, False, True)

    times = torch.linspace(0.0, 1.0, 21)
    fields = standing.sample(times)
    states = reference_states(standing, times)
    moved = states["qpos"] - fields["reference_qpos"]
    depth = -fields["reference_link_clearances"].amin(1)
    torch.testing.assert_close(moved[:, 2], depth.clamp(min=0.0))
    assert moved[:, 2].max() > 0.08
    assert not moved[:, 3:].any()


def test_missing_joint_is_named(character: Character, layout: Layout) -> None:
    clip = generated_walk()
    names = tuple("right_nee" if name == "right_knee" else name for name in clip.joint_names)
    with pytest.raises(FileError, match=r"no joint 'right_knee'.*Did you mean 'right_nee'"):
        ReferenceMotion(replace(clip, joint_names=names), character, layout, control_dt=DT)


def recorded_clips() -> list[Path]:
    folder = library.data_folder()
    found = sorted(folder.glob("motions/*/*.txt")) if folder else []
    return [path for path in found if not path.stem.endswith("character")]


@pytest.mark.skipif(
    not recorded_clips(),
    reason="no recorded clips: UNDERSTUDY_DATA is not set and ../shared is absent",
)
def test_every_recorded_clip_becomes_a_finite_reference_on_the_floor(
    character: Character, layout: Layout
) -> None:
    for path in recorded_clips():
        reference = ReferenceMotion(
            deepmimic.DeepMimicReader().read(path), character, layout, control_dt=DT
        )
        assert abs(reference.height_offset) < 0.3, path
        fields = reference.sample(torch.linspace(0.0, 2.5 * reference.duration, 301))
        for name, value in fields.items():
            assert value.isfinite().all(), (path, name)
        assert ((fields["phase"] >= 0.0) & (fields["phase"] < 1.0)).all(), path
        norm = fields["reference_joint_rotations"].norm(dim=-1)
        assert (norm - 1.0).abs().max() < 1e-5, path
        balls = fields["reference_qpos"][:, layout.ball_qpos.flatten()].view(301, -1, 4)
        assert (balls.norm(dim=-1) - 1.0).abs().max() < 1e-5, path
        back = reference.to_first_cycle(
            fields["reference_qpos"],
            fields["reference_qvel"],
            torch.linspace(0.0, 2.5 * reference.duration, 301),
        )
        if reference.loop:
            assert (back[2] <= reference.duration).all(), path
            again = reference.sample(back[2])
            place = (back[0][:, :3] - again["reference_root_position"]).abs().amax(1)
            assert (place < 0.02).float().mean() > 0.98, path  # but at the seam itself


def unclosed() -> Clip:
    """The walk whose last frame leans by 0.1 rad, which its first does not."""
    clip = generated_walk()
    pose = clip.rotations.clone()
    lean = rotations.from_axis_angle(
        torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64), torch.tensor(0.1, dtype=torch.float64)
    )
    pose[-1, 0] = rotations.multiply(lean, pose[-1, 0])
    return replace(clip, rotations=pose)


def test_a_seam_that_does_not_close_has_no_velocity_of_its_own(
    character: Character, layout: Layout
) -> None:
    """Its first pose is not reached from its last one: 0.1 rad within 1/60 s would be 6 rad/s."""

    def rolling(clip: Clip) -> Tensor:
        reference = ReferenceMotion(clip, character, layout, control_dt=DT)
        start = reference.sample(torch.linspace(0.0, 0.02, 9))
        return start["reference_qvel"][:, 3]

    assert (rolling(unclosed()) - rolling(generated_walk())).abs().max() < 0.05


@pytest.mark.parametrize("loop", [True, False])
@pytest.mark.parametrize("seconds", [0.008, 0.03])
def test_a_clip_that_is_over_before_it_is_compared_is_refused(loop: bool, seconds: float) -> None:
    """As of two frames at 120 Hz; a training of it ended with a report, and meant nothing."""
    walk = generated_walk()
    short = replace(walk, name="short", times=walk.times * seconds / walk.duration, loop=loop)
    registry = Registry()
    registry.components["clip", "short"] = Component("clip", "short", lambda: short, "test")
    motion = Motion(MotionOptions(name="short"), registry, Inputs())

    def of(period: float) -> ReferenceMotion:
        scene = CharacterScene(CharacterScene.Options("humanoid"))
        sections = {"motion": motion}
        return reference_motion(
            Context(0, torch.device("cpu"), 1, control_dt=period, substeps=1, scene=scene, sections=sections)
        )  # fmt: skip

    with pytest.raises(
        ConfigError, match=r"Clip short lasts .* less than a control period \(0\.0333"
    ):
        of(1 / 30)
    assert of(seconds).duration == pytest.approx(seconds)
