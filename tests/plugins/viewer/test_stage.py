"""What is drawn when, without a browser."""

# MuJoCo has no stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from understudy.errors import FileError
from understudy_characters.character import Character
from understudy_doctor.examination import examine
from understudy_doctor.summary import contacts
from understudy_motion.clip import Clip, sample
from understudy_viewer.figure import Figure, figure, intervals
from understudy_viewer.stage import Scene, Subject, build, shared_times


def placed(shown: Figure, frame: int) -> np.ndarray:
    """(V, 3) m: all vertices of the figure in the world."""
    return np.concatenate(
        [
            Rotation.from_quat(turn, scalar_first=True).apply(part.vertices) + place
            for part, place, turn in zip(
                shown.parts, shown.positions[frame], shown.rotations[frame], strict=True
            )
        ]
    )


def test_a_character_is_drawn_where_mujoco_has_its_geoms(humanoid: Character, walk: Clip) -> None:
    shown = figure(walk, humanoid, walk.times)
    qpos = humanoid.qpos(walk).numpy()
    for frame in (0, 17, 40):
        humanoid.data.qpos[:] = qpos[frame]
        mujoco.mj_kinematics(humanoid.model, humanoid.data)
        vertices = placed(shown, frame)
        for geom in humanoid.geoms:
            centre = humanoid.data.geom_xpos[geom.id]
            nearest = np.linalg.norm(vertices - centre, axis=1).min()
            assert nearest < humanoid.model.geom_rbound[geom.id]
        lowest = humanoid.clearance(torch.from_numpy(qpos[frame : frame + 1])).min().item()
        assert vertices[:, 2].min() == pytest.approx(lowest, abs=1e-6)


def test_without_a_character_the_skeleton_is_drawn(walk: Clip) -> None:
    shown = figure(walk, None, walk.times)
    assert shown.positions.shape == (walk.num_frames, len(shown.parts), 3)
    assert (shown.feet, shown.contacts.shape) == ((), (walk.num_frames, 0))
    bare = replace(walk, skeleton=None)
    with pytest.raises(FileError, match="has no skeleton"):
        figure(bare, None, bare.times)


def test_feet_in_contact_leave_a_print_each_time(humanoid: Character, walk: Clip) -> None:
    shown = figure(walk, humanoid, walk.times)
    assert shown.feet == ("right_ankle", "left_ankle")
    assert 0.4 < shown.contacts.mean() < 0.8
    times_down = sum(len(intervals(column)) for column in shown.contacts.T)
    prints = shown.footprints
    assert len(prints.faces) == len(prints.vertices) - 2 * times_down, "fans, one for each"
    assert np.ptp(prints.vertices[:, 2]) == 0.0
    corners = prints.vertices[prints.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] > 0.0).all(), "they are seen from above"
    sole = 4 * 0.0885 * 0.045
    assert normals[:, 2].sum() / 2 == pytest.approx(times_down * sole, rel=0.2)


def test_contacts_are_those_that_the_doctor_finds(humanoid: Character, walk: Clip) -> None:
    up = torch.tensor([0.0, 0.0, 0.3], dtype=torch.float64)
    for clip in (walk, replace(walk, root_position=walk.root_position + up)):
        shown, examined = figure(clip, humanoid, clip.times), examine(clip, humanoid)
        spans = contacts(examined)
        for name, column in zip(shown.feet, shown.contacts.T, strict=True):
            found = [tuple(clip.times[[a, b - 1]].tolist()) for a, b in intervals(column)]
            np.testing.assert_allclose(found, spans[name], atol=1e-3)
        assert examined.measured is not None
        level = shown.footprints.vertices[:, 2] - examined.measured.ground
        assert (np.abs(level) < 0.01).all(), "prints are on the floor that is found"


def test_a_figure_that_never_touches_leaves_none(humanoid: Character) -> None:
    times = torch.arange(16, dtype=torch.float64) / 30
    qpos = torch.tensor(humanoid.model.qpos0, dtype=torch.float64).repeat(16, 1)
    qpos[:, 2] += 3.0 - 4.905 * times**2
    falling = humanoid.clip(qpos, times, name="falling")
    shown = figure(falling, humanoid, falling.times)
    assert not shown.contacts.any()
    assert len(shown.footprints.vertices) == len(shown.footprints.faces) == 0


@given(st.lists(st.booleans(), max_size=30))
def test_intervals_are_the_stretches(on: list[bool]) -> None:
    found = intervals(np.array(on, dtype=bool))
    rebuilt = np.zeros(len(on), dtype=bool)
    for start, stop in found:
        assert start < stop
        rebuilt[start:stop] = True
    assert rebuilt.tolist() == on
    assert (found[1:, 0] > found[:-1, 1]).all()


def test_one_clip_keeps_its_own_frames(walk: Clip) -> None:
    assert torch.equal(shared_times([walk]), walk.times)


def test_two_clips_show_the_frames_of_both(walk: Clip, standing: Clip) -> None:
    times = shared_times([walk, standing])
    assert (times.diff() > 0.0).all()
    assert (times[0], times[-1]) == (0.0, standing.duration)
    for clip in (walk, standing):
        distance = (clip.times[:, None] - times).abs().amin(dim=1)
        assert distance.max() <= 1e-5
    assert len(times) <= walk.num_frames + standing.num_frames


def test_the_same_times_from_two_clips_are_one(walk: Clip) -> None:
    again = replace(walk, times=walk.times + 1e-12 * torch.arange(walk.num_frames))
    assert len(shared_times([walk, again])) == walk.num_frames


def test_beside_a_longer_one_a_loop_goes_on_and_another_clip_waits(
    humanoid: Character, walk: Clip, standing: Clip
) -> None:
    stage = build(Scene([Subject(walk, humanoid), Subject(standing, humanoid)]))
    walking, waiting = (actor.figure for actor in stage.actors)
    expected, _ = sample(walk, torch.from_numpy(stage.times))
    np.testing.assert_allclose(walking.root, expected.numpy(), atol=1e-12)
    assert walking.root[-1, 0] > 1.5 * walk.root_position[-1, 0].item()
    still = replace(walk, loop=False)
    stage = build(Scene([Subject(still, humanoid), Subject(standing, humanoid)]))
    np.testing.assert_allclose(stage.actors[0].figure.root[-1], walk.root_position[-1].numpy())
    np.testing.assert_array_equal(waiting.root, waiting.root[:1].repeat(len(stage.times), axis=0))


def test_the_focus_follows_the_figures_without_shaking(humanoid: Character, walk: Clip) -> None:
    far = torch.tensor([50.0, -20.0, 0.0], dtype=torch.float64)
    moved = replace(walk, root_position=walk.root_position + far)
    stage = build(Scene([Subject(moved, humanoid, (50.0, -20.0))]))
    away = stage.focus - walk.root_position[:, :2].numpy()
    assert np.abs(away).max() < 0.3
    sway = np.abs(np.diff(stage.focus, n=2, axis=0)).max()
    assert sway < np.abs(np.diff(walk.root_position[:, :2].numpy(), n=2, axis=0)).max()
