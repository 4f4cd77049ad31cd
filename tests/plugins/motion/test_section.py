"""The config section ``motion`` and what it tells a run's records."""

from __future__ import annotations

import hashlib
import warnings
from dataclasses import replace
from pathlib import Path

import pytest
import torch

import understudy_motion
from understudy.errors import ConfigError, FileError
from understudy.inputs import Inputs
from understudy.setup.registry import Component, Registrar, Registry
from understudy_motion.clip import Clip
from understudy_motion.readers import deepmimic
from understudy_motion.section import Motion, MotionOptions
from understudy_tensors.rotations import angle_between, from_exponential_map


def step() -> Clip:
    """A generated clip: the root moves a metre in a second."""
    rotations = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(2, 1, 1)
    position = torch.tensor([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]])
    times = torch.tensor([0.0, 1.0])
    return Clip("walk", times, position, rotations, ("root",), loop=True, licence="ours")


@pytest.fixture
def registry() -> Registry:
    registry = Registry()
    Registrar(registry, "motion").tables(understudy_motion)
    registry.components["clip", "walk"] = Component("clip", "walk", step, "test")
    return registry


def test_the_default_is_the_generated_walk(registry: Registry) -> None:
    motion = Motion(MotionOptions(), registry, Inputs())
    assert motion.clip.loop
    provenance = motion.provenance()
    assert provenance["clip"] == "walk"
    assert provenance["source"] == "generated"
    assert provenance["licence"] == "ours"
    assert provenance["seconds"] == pytest.approx(motion.clip.duration, abs=1e-4)


def leaning() -> Clip:
    """Half a second in which a figure leans over, and stays so."""
    turns = torch.linspace(0.0, 0.4, 31, dtype=torch.float64)
    lean = torch.stack((turns, torch.zeros(31), torch.zeros(31)), dim=1)
    times = torch.linspace(0.0, 0.5, 31, dtype=torch.float64)
    poses = from_exponential_map(lean)[:, None]
    return Clip("lean", times, torch.zeros(31, 3).double(), poses, ("root",), loop=True)


def test_a_clip_that_does_not_close_is_led_into_its_beginning(registry: Registry) -> None:
    registry.components["clip", "lean"] = Component("clip", "lean", leaning, "test")
    open_, closed = (
        Motion(MotionOptions(name="lean", close_loop=s), registry, Inputs()).clip
        for s in (None, 0.1)
    )
    assert angle_between(open_.rotations[0], open_.rotations[-1]).item() == pytest.approx(0.4)
    assert angle_between(closed.rotations[0], closed.rotations[-1]).item() < 1e-9
    torch.testing.assert_close(closed.rotations[6:-6], open_.rotations[6:-6])


@pytest.mark.parametrize(("away", "moved"), [((90.0, -40.0), False), ((-9e4, 3e4), True)])
def test_a_clip_far_away_begins_at_the_origin(
    registry: Registry, away: tuple[float, float], moved: bool
) -> None:
    """As in a map's coordinates, where float32 has steps of millimetres; what it does is the same."""
    offset = torch.tensor([*away, 0.5], dtype=torch.float64)
    clip = replace(leaning(), root_position=leaning().root_position + offset)
    registry.components["clip", "lean"] = Component("clip", "lean", lambda: clip, "test")
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = Motion(MotionOptions(name="lean"), registry, Inputs()).clip
    assert any("Clip lean begins 9.487e+04 m" in str(one.message) for one in said) == moved
    begins = (0.0, 0.0, 0.5) if moved else (*away, 0.5)
    assert found.root_position[0].tolist() == pytest.approx(begins)
    assert torch.equal(found.rotations, clip.rotations)
    torch.testing.assert_close(found.root_position.diff(dim=0), clip.root_position.diff(dim=0))


@pytest.mark.parametrize("seconds", [0.26, 100.0, 0.01, 1e-9])
def test_a_seam_that_the_clip_has_not_got_is_refused(registry: Registry, seconds: float) -> None:
    """More than half of the clip was taken for half of it, and less than a frame was a jump."""
    registry.components["clip", "lean"] = Component("clip", "lean", leaning, "test")
    said = r"motion\.close_loop=.* the clip lean lasts 0\.5 s, 0\.01667 s a frame\. .*: 0\.01667 to 0\.25\."
    with pytest.raises(ConfigError, match=said):
        Motion(MotionOptions(name="lean", close_loop=seconds), registry, Inputs())
    for possible in (0.25, 0.5 / 30):
        Motion(MotionOptions(name="lean", close_loop=possible), registry, Inputs())


def test_a_clip_is_not_closed_that_is_said_not_to_repeat(
    registry: Registry, tmp_path: Path
) -> None:
    row = [0.1, 0, 1, 0]
    for _, width in deepmimic.JOINTS:
        row += [1, 0, 0, 0] if width == 4 else [0]
    path = tmp_path / "still.json"
    path.write_text('{"Loop": "wrap", "Frames": %s}' % ([row] * 9))
    options = MotionOptions(file=str(path), loop=False)
    assert not Motion(options, registry, Inputs()).clip.loop
    with pytest.raises(ConfigError, match=r"close_loop=0\.1 .* beside motion\.loop=false"):
        Motion(replace(options, close_loop=0.1), registry, Inputs())


def test_more_key_frames_than_a_clip_has_are_refused(registry: Registry) -> None:
    """They would be between its frames, and nothing of it left out."""
    registry.components["clip", "lean"] = Component("clip", "lean", leaning, "test")
    assert Motion(MotionOptions(name="lean", keys=31), registry, Inputs()).clip.num_frames == 31
    with pytest.raises(ConfigError, match=r"motion\.keys=32 .* lean has 31 frames"):
        Motion(MotionOptions(name="lean", keys=32), registry, Inputs())


def test_a_file_is_recorded_with_its_digest(registry: Registry, tmp_path: Path) -> None:
    row = [0.5, 0, 1, 0]
    for _, width in deepmimic.JOINTS:
        row += [1, 0, 0, 0] if width == 4 else [0]
    path = tmp_path / "still.json"
    path.write_text('{"Loop": "none", "Frames": %s}' % [row, row])
    motion = Motion(MotionOptions(name="walk", file=str(path)), registry, Inputs())
    assert motion.provenance() == {
        "clip": "still",
        "source": str(path),
        "licence": "unknown",
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "seconds": 0.5,
    }
    assert torch.isfinite(motion.clip.rotations).all()


def test_an_unknown_name_suggests_the_generated_one(
    registry: Registry, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("UNDERSTUDY_DATA", str(tmp_path))
    with pytest.raises(FileError, match=r"No motion clip 'wolk'\. Did you mean 'walk'"):
        Motion(MotionOptions(name="wolk"), registry, Inputs())
